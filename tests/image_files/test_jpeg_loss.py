from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from pv_inspect.image_files.jpeg_loss import jpeg_error_variance, rounding_error
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.sequence.sequence import FrameSequence
from tests.sequence.test_sequence import make_frames

LIMITS = ReadLimits()


def picture(level: float, sigma: float) -> np.ndarray[tuple[int, int], np.dtype[np.uint8]]:
    """Cells with busbars, grain and noise before a dark background."""
    rng = np.random.default_rng(7)
    y, x = np.mgrid[:256, :320]
    scene = level * (1 + 0.1 * np.sin(x / 31) * np.cos(y / 23))
    scene[(y % 21 < 2) | (x % 60 < 2)] *= 0.4
    scene *= 1 - 0.2 * (cv2.GaussianBlur(rng.random(scene.shape), (0, 0), 1.5) > 0.53)
    scene[:20] = scene[-20:] = 4
    return np.clip(np.rint(scene + rng.normal(0, sigma, scene.shape)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("level", "sigma"), [(90, 1.2), (160, 2.0), (200, 0.5)])
@pytest.mark.parametrize("quality", [80, 90, 95, 99])
@pytest.mark.parametrize("colour", [False, True])
def test_the_error_of_compression_is_told_from_what_is_left(
    tmp_path: Path, level: float, sigma: float, quality: int, colour: bool
) -> None:
    image, path = picture(level, sigma), tmp_path / "x.jpg"
    stored = np.dstack([image] * 3) if colour else image
    cv2.imwrite(str(path), stored, [cv2.IMWRITE_JPEG_QUALITY, quality])
    left = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE).astype(float)
    error = float(np.sqrt(np.mean(np.square(left - image)[24:-24])))
    assert jpeg_error_variance(path, LIMITS) ** 0.5 == pytest.approx(error, rel=0.3)


def test_the_error_of_rounding_is_that_of_random_numbers() -> None:
    rng = np.random.default_rng(0)
    for spread in (0.2, 1.0, 5.0):
        values = rng.laplace(0, spread, 400_000)
        for step in (0.5, 2.0, 9.0):
            error = np.mean(np.square(values - step * np.rint(values / step)))
            assert rounding_error(np.array(spread), np.array(step)) == pytest.approx(
                error, rel=0.03
            )


def test_other_files_have_lost_nothing(tmp_path: Path) -> None:
    for content in (b"", b"\xff\xd8\xff\xd9", b"BM" + bytes(60)):
        (tmp_path / "x.jpg").write_bytes(content)
        assert jpeg_error_variance(tmp_path / "x.jpg", LIMITS) == 0
    cv2.imwrite(str(tmp_path / "flat.jpg"), np.full((64, 64), 90, np.uint8))
    assert jpeg_error_variance(tmp_path / "flat.jpg", LIMITS) < 2
    assert jpeg_error_variance(tmp_path / "none.jpg", LIMITS) == 0


def test_what_jpeg_has_taken_is_noise_of_a_sequence(tmp_path: Path) -> None:
    for quality in (70, 95):
        folder = tmp_path / str(quality)
        folder.mkdir()
        for k, frame in enumerate(make_frames()):
            how = [cv2.IMWRITE_JPEG_QUALITY, quality]
            cv2.imwrite(str(folder / f"f_{k}.jpg"), frame >> 4, how)
    strong, weak = (FrameSequence.open(tmp_path / str(q)).noise for q in (70, 95))
    assert strong.grain_px == weak.grain_px == 8
    assert strong.read_variance > 2 * weak.read_variance
    for k, frame in enumerate(make_frames()):
        cv2.imwrite(str(tmp_path / f"f_{k}.png"), frame)
    assert FrameSequence.open(tmp_path).noise.grain_px == 1
