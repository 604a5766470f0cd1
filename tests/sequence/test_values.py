from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.sequence.sequence import FrameSequence
from tests.sequence.test_sequence import make_frames

Values = NDArray[np.generic]
Change = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def opened(
    folder: Path, change: Change, dtype: str, frames: list[NDArray[np.uint16]] | None = None
) -> FrameSequence:
    folder.mkdir(exist_ok=True)
    for k, frame in enumerate(frames or FRAMES):
        values = np.clip(change(frame.astype(np.float64)), *_range(dtype)).astype(dtype)
        tifffile.imwrite(folder / f"f_{k}.tif", values)
    return FrameSequence.open(folder)


def _range(dtype: str) -> tuple[float, float]:
    kind = np.dtype(dtype)
    limits = np.finfo(kind) if kind.kind == "f" else np.iinfo(kind)
    return float(limits.min), float(limits.max)


def _frames() -> list[NDArray[np.uint16]]:
    frames = make_frames()
    for frame in frames:
        frame[40:44, 60:64] = 4095  # saturated
    return frames


FRAMES = _frames()


@pytest.fixture(scope="module")
def counts(tmp_path_factory: pytest.TempPathFactory) -> FrameSequence:
    return opened(tmp_path_factory.mktemp("counts"), lambda v: v, "uint16")


def same(one: FrameSequence, other: FrameSequence) -> None:
    for k in range(len(one)):
        np.testing.assert_array_equal(one.frame(k).image, other.frame(k).image)
        np.testing.assert_array_equal(one.frame(k).valid, other.frame(k).valid)
    assert one.noise == other.noise


@pytest.mark.parametrize("dtype", ["int16", "uint32", "int32", "float32", "float64"])
def test_whole_numbers_are_counts_whatever_their_type(
    tmp_path: Path, counts: FrameSequence, dtype: str
) -> None:
    sequence = opened(tmp_path, lambda v: v, dtype)
    assert (sequence.bit_depth, sequence.full_scale) == (12, 4095.0)
    assert sequence.warnings == ()
    same(sequence, counts)


@pytest.mark.parametrize(
    ("change", "dtype", "full_scale"),
    [
        (lambda v: v / 65535, "float32", 4095 / 65535),
        (lambda v: v / 4095, "float64", 1.0),
        (lambda v: v / 4095 * 1.2, "float32", 1.2),
        (lambda v: v - 64.5, "float32", 4095.0),
        (lambda v: v - 100, "int16", 4095.0),
        (lambda v: 20 * v, "uint32", 20 * 4095.0),
        (lambda v: v * 1e-9, "float32", 4095e-9),
        (lambda v: v * 1e12, "float32", 4095e12),
    ],
)
def test_computed_values_are_the_same_frames_but_for_their_scale(
    tmp_path: Path, counts: FrameSequence, change: Change, dtype: str, full_scale: float
) -> None:
    sequence = opened(tmp_path, change, dtype)
    assert sequence.bit_depth is None
    assert sequence.full_scale == pytest.approx(full_scale, rel=1e-6)
    said = " ".join(sequence.warnings)
    assert "computed values" in said
    assert "where the camera was saturated is not known" in said
    for k in range(len(sequence)):
        expected, found = counts.frame(k), sequence.frame(k)
        gain, offset = np.polyfit(expected.image.ravel(), found.image.ravel(), 1)
        away = found.image - gain * expected.image - offset
        assert np.abs(away).max() < 2e-5
        # What is cut off at the largest value is seen.
        assert not found.valid[40:44, 60:64].any()
        np.testing.assert_array_equal(found.valid, expected.valid)
    assert sequence.noise.shot_gain == pytest.approx(gain * counts.noise.shot_gain, rel=0.02)


@pytest.mark.parametrize("filler", [np.nan, np.inf, -np.inf, -9999.0, 3.4e38, -3.4e38])
def test_pixels_without_a_number_are_not_used(
    tmp_path: Path, counts: FrameSequence, filler: float
) -> None:
    def with_gaps(values: NDArray[np.float64]) -> NDArray[np.float64]:
        values = values.copy()
        values[10:14, 20:26] = filler
        values[:, -30:] = filler
        return values

    folder = tmp_path / "frames"
    folder.mkdir()
    for k, frame in enumerate(FRAMES):
        tifffile.imwrite(folder / f"f_{k}.tif", with_gaps(frame * 1.0).astype(np.float32))
    sequence = FrameSequence.open(folder)
    frame = sequence.frame(2)
    assert np.isfinite(frame.image).all()
    assert not frame.valid[10:14, 20:26].any()
    assert not frame.valid[:, -30:].any()
    near = counts.frame(2)
    assert frame.valid[:, :-30].sum() >= near.valid[:, :-30].sum() - 24
    gain, offset = np.polyfit(near.image[frame.valid], frame.image[frame.valid], 1)
    away = np.abs(frame.image - gain * near.image - offset)
    assert away[10:14, 20:26].max() < 0.02
    assert "hold no usable number" in " ".join(sequence.warnings)


def test_values_that_wrapped_round_are_not_used(tmp_path: Path) -> None:
    black, rng = 82.0, np.random.default_rng(3)
    frames = [np.clip(f + rng.normal(18, 6, f.shape), 0, 4095).astype(np.uint16) for f in FRAMES]
    wrapped = opened(tmp_path / "a", lambda v: ((v - black) % 65536) / 4013, "float32", frames)
    right = opened(tmp_path / "b", lambda v: (v - black) / 4013, "float32", frames)
    assert wrapped.full_scale == pytest.approx(right.full_scale, rel=1e-3)
    assert "have wrapped round" in " ".join(wrapped.warnings)
    assert "have wrapped round" not in " ".join(right.warnings)
    for k in range(len(frames)):
        below = frames[k] < black
        assert below.sum() > 100
        assert not wrapped.frame(k).valid[below].any()
        use = wrapped.frame(k).valid & right.frame(k).valid
        # The darkest pixels are missing, so that the black level is found a little higher.
        found, expected = wrapped.frame(k).image[use], right.frame(k).image[use]
        gain, offset = np.polyfit(expected, found, 1)
        assert (gain, offset) == (pytest.approx(1, abs=3e-3), pytest.approx(0, abs=3e-3))
        assert np.abs(found - gain * expected - offset).max() < 2e-5


def test_a_saturated_module_has_not_wrapped_round(tmp_path: Path) -> None:
    frames = [np.where(frame > 900, 4095, frame // 8).astype(np.uint16) for frame in FRAMES]
    for dtype in ("float32", "uint32"):
        sequence = opened(tmp_path / dtype, lambda v: v + 0.5 * (v < 0), dtype, frames)
        assert "wrapped" not in " ".join(sequence.warnings)


@pytest.mark.parametrize(
    ("value", "said"), [(np.nan, "hold no number at all"), (-3.0, "hold no value above zero")]
)
def test_frames_without_light_are_refused(tmp_path: Path, value: float, said: str) -> None:
    tifffile.imwrite(tmp_path / "f.tif", np.full((60, 80), value, np.float32))
    with pytest.raises(InspectionError, match=said):
        FrameSequence.open(tmp_path)


def test_a_dark_frame_of_averages_is_taken_from_counts(tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    opened(folder, lambda v: v, "float32")
    tifffile.imwrite(tmp_path / "dark.tif", np.full(FRAMES[0].shape, 64.25, np.float32))
    sequence = FrameSequence.open(folder, tmp_path / "dark.tif")
    assert (sequence.bit_depth, sequence.black_level) == (12, 64.25)


def test_computed_frames_take_their_own_dark_and_flat_frames(tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    opened(folder, lambda v: v / 4095, "float32")
    tifffile.imwrite(tmp_path / "dark.tif", np.full(FRAMES[0].shape, 64 / 4095, np.float32))
    flat = np.random.default_rng(0).normal(0.7, 0.01, FRAMES[0].shape).astype(np.float32)
    tifffile.imwrite(tmp_path / "flat.tif", flat)
    sequence = FrameSequence.open(folder, tmp_path / "dark.tif", tmp_path / "flat.tif")
    assert sequence.black_level == pytest.approx(64 / 4095)
    response = (flat - 64 / 4095) / np.median(flat - 64 / 4095)
    expected = (FRAMES[1] / 4095 - 64 / 4095) / (1 - 64 / 4095) / response
    use = sequence.frame(1).valid
    np.testing.assert_allclose(sequence.frame(1).image[use], expected[use], atol=2e-4)


def test_repeated_computed_frames_count_once(tmp_path: Path) -> None:
    sequence = opened(tmp_path, lambda v: v / 4095, "float32", [*FRAMES, FRAMES[1]])
    assert sequence.copies == {5: 1}


def test_jpeg_frames_are_read_with_a_warning(tmp_path: Path) -> None:
    for k, frame in enumerate(make_frames()):
        cv2.imwrite(str(tmp_path / f"f_{k}.jpg"), frame >> 3, [cv2.IMWRITE_JPEG_QUALITY, 95])
    sequence = FrameSequence.open(tmp_path)
    assert (len(sequence), sequence.bit_depth, sequence.full_scale) == (5, 8, 255.0)
    assert any("are JPEG, compressed with loss" in text for text in sequence.warnings)


def test_nearly_saturated_levels_of_jpeg_are_saturated(tmp_path: Path) -> None:
    for k, frame in enumerate(make_frames()):
        bright = np.clip(frame.astype(np.float64) / 5, 0, 255)
        cv2.imwrite(str(tmp_path / f"f_{k}.jpg"), bright.astype(np.uint8))
    frame = FrameSequence.open(tmp_path).frame(2)
    inside = np.zeros(frame.valid.shape, bool)
    inside[30:66, 45:83] = True
    assert not frame.valid[inside].any()
    assert frame.valid[:15].all()


def test_a_tinted_png_is_read_as_grey_with_a_warning(tmp_path: Path) -> None:
    for k, frame in enumerate(make_frames()):
        grey = (frame >> 4).astype(np.float64)
        tinted = np.dstack([grey * 0.97, grey, grey * 0.98]).astype(np.uint8)
        cv2.imwrite(str(tmp_path / f"f_{k}.png"), tinted)
    sequence = FrameSequence.open(tmp_path)
    assert sequence.warnings == (
        "The frames have colours with a slight tint: the mean of the channels is taken as grey.",
    )
