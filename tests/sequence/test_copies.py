from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile

from pv_inspect.detection.detect import detect
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.registration.register import LEFT_OUT, left_out
from pv_inspect.sequence.copies import FrameContents, copies_sentence, copy_reasons, likeness
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from pv_inspect.simulate import SimulatedSequence, SimulationSettings, simulated

STILL = {"jitter_px": 0.0, "jitter_deg": 0.0, "motion_blur_px": 0.0}
EIGHT_BITS = {"bit_depth": 8, "black_level_dn": 4}


def exposures(**changes: Any) -> list[Any]:
    """Two frames of 4 x 6 cells."""
    numbers: dict[str, Any] = {"rows": 4, "cols": 6, "n_frames": 2, "width": 320, "height": 256}
    numbers |= {"pixels_per_unit": 100, "supersampling": 2, "seed": 4}
    return list(simulated(SimulationSettings(**(numbers | changes))).frames)


@pytest.fixture(scope="module")
def still() -> list[Any]:
    return exposures(**STILL)


def jpeg(frame: Any, quality: int) -> Any:
    """A 12-bit frame as 8-bit JPEG and back."""
    kept = cv2.imencode(".jpg", (frame >> 4).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return cv2.imdecode(kept[1], cv2.IMREAD_UNCHANGED).astype(frame.dtype) << 4


def dithered(frame: Any, seed: int = 0) -> Any:
    noise = np.random.default_rng(seed).integers(-2, 3, frame.shape)
    return np.clip(frame.astype(int) + noise, 0, 4095).astype(frame.dtype)


def with_clock(frame: Any) -> Any:
    text = cv2.putText(
        np.zeros(frame.shape, np.uint8), "12:03:59", (8, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.6, 255, 1
    )
    return np.where(text > 0, 4095, frame).astype(frame.dtype)


@pytest.mark.parametrize(
    "again",
    [
        lambda frame: jpeg(frame, 95),
        lambda frame: jpeg(frame, 90),
        lambda frame: frame >> 4 << 4,
        lambda frame: np.round(0.9 * frame + 20).astype(frame.dtype),
        dithered,
        with_clock,
    ],
    ids=["JPEG 95", "JPEG 90", "8 bit", "darker", "dither", "clock"],
)
def test_an_exposure_that_was_processed_is_still_the_same_exposure(still: list[Any], again: Any):
    assert likeness(still[0], again(still[0])).same
    assert likeness(again(still[0]), still[0]).same


@pytest.mark.parametrize(
    "changes",
    [
        STILL,
        STILL | EIGHT_BITS,
        STILL | {"read_noise_e": 5, "full_well_e": 1e6},
        STILL | EIGHT_BITS | {"read_noise_e": 5, "full_well_e": 1e6},
        STILL | {"prnu": 0.02},
        {"jitter_px": 0.1, "jitter_deg": 0.0, "motion_blur_px": 0.0, "wafer": "mono"},
    ],
    ids=["12 bit", "8 bit", "low noise", "8 bit and low noise", "fixed pattern", "0.1 px"],
)
def test_two_exposures_of_a_still_camera_are_two(changes: dict[str, Any]) -> None:
    first, second = exposures(**changes)
    assert not likeness(first, second).same


def test_sharpened_exposures_are_two(still: list[Any]) -> None:
    sharp = [
        np.clip(2.0 * f - cv2.GaussianBlur(f.astype(np.float32), (0, 0), 1.0), 0, 4095)
        for f in still
    ]
    assert not likeness(*(f.round().astype(np.uint16) for f in sharp)).same


def test_noise_of_its_own_makes_half_of_the_difference(still: list[Any]) -> None:
    independent, copied = likeness(*still), likeness(still[0], dithered(still[0]))
    assert 0.3 < independent.ratio < 1.1
    assert copied.share == pytest.approx(0.0, abs=4 * copied.share_error)


def test_saturated_frames_are_not_compared() -> None:
    white = np.full((64, 64), 255, np.uint8)
    assert not likeness(white, white).same


def test_copies_point_to_the_first_frame_of_their_content(still: list[Any]) -> None:
    moved = np.roll(still[0], 3, axis=1)
    frames = [still[0], still[1], still[0], moved, jpeg(still[0], 95), still[1], moved, moved]
    contents = FrameContents()
    for frame in frames:
        contents.add(frame)
    assert contents.copies(lambda k: frames[k]) == {2: 0, 4: 0, 5: 1, 6: 3, 7: 3}


def test_frames_that_do_not_look_alike_are_not_read_again(still: list[Any]) -> None:
    contents = FrameContents()
    for shift in range(0, 40, 8):
        contents.add(np.roll(still[0], shift, axis=1))

    def read(_: int) -> Any:
        raise AssertionError

    assert contents.copies(read) == {}


@pytest.fixture(scope="module")
def repeated(small_sequence: tuple[SimulatedSequence, Path], tmp_path_factory: Any) -> Any:
    """The sequence as it is, and with every frame three times, the third time requantised."""
    frames = list(small_sequence[0].frames)
    folder = tmp_path_factory.mktemp("copies")
    stacks = {
        "once": frames,
        "thrice": [copy for f in frames for copy in (f, f, f >> 2 << 2)],
        "one": [frames[0]] * 8,
    }
    opened = {}
    for name, stack in stacks.items():
        path = folder / f"{name}.tif"
        tifffile.imwrite(path, np.stack(stack), photometric="minisblack")
        opened[name] = FrameSequence.open(path)
    return opened


def test_the_sensor_is_estimated_from_distinct_frames(repeated: Any) -> None:
    once, thrice = repeated["once"], repeated["thrice"]
    assert once.copies == {}
    assert sorted(thrice.copies) == [k for k in range(24) if k % 3]
    assert thrice.noise == once.noise
    assert thrice.black_level == once.black_level
    assert np.array_equal(thrice.defects, once.defects)


def test_the_module_is_looked_for_in_distinct_frames(repeated: Any) -> None:
    layout = ModuleLayout(4, 6)
    found = {}
    for name in ("once", "thrice"):
        steps = detect(repeated[name], layout)
        while True:
            try:
                next(steps)
            except StopIteration as end:
                found[name] = end.value
                break
    for k, frame in enumerate(found["thrice"].frames):
        assert bool(frame.why) == bool(k % 3)
        if not frame.why:
            assert np.array_equal(frame.points_px, found["once"].frames[k // 3].points_px)
    assert found["thrice"].frames[4].why == "it is a copy of thrice.tif[3]: counted once"


def test_a_copy_that_is_to_be_kept_stays_a_copy(repeated: Any) -> None:
    sequence = repeated["thrice"]
    settings = Settings(keep_frames=("thrice.tif[1]",), skip_frames=("thrice.tif[6]",))
    reasons = left_out(sequence, settings)
    assert reasons[1] == "it is a copy of thrice.tif[0]: counted once"
    assert reasons[6] == LEFT_OUT
    assert len(reasons) == 17


def test_one_frame_under_eight_names_is_one_frame(repeated: Any) -> None:
    sequence = repeated["one"]
    assert sequence.copies == dict.fromkeys(range(1, 8), 0)
    assert copies_sentence(sequence.copies, sequence.names) == (
        "7 of 8 frames are copies of others and are counted once (one.tif[1] is a copy of "
        "one.tif[0]): the result is that of 1 frame."
    )


def test_a_single_copy_is_named() -> None:
    names = ("a.tif", "b.tif", "c.tif")
    assert copies_sentence({2: 0}, names) == (
        "c.tif is a copy of a.tif and is counted once: the result is that of 2 frames."
    )
    assert copies_sentence({}, names) == ""
    assert copy_reasons({2: 0}, names) == {2: "it is a copy of a.tif: counted once"}
