from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.pipeline import inspect_steps
from pv_inspect.sequence.differences import Pair, fitted
from pv_inspect.sequence.frame import Frame
from pv_inspect.sequence.frame_motion import motion_between
from pv_inspect.sequence.lock_in import NEVER_NEAREST, NOT_BETWEEN, lock_in_sentence
from pv_inspect.sequence.modulation import LevelPictures, Modulation, find_modulation
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from pv_inspect.simulate import SimulationSettings, simulated
from pv_inspect.simulate.daylight import Daylight, SimulatedDaylight, simulate_daylight

CASE = Path(__file__).resolve().parents[3] / "shared" / "cases" / "10-daylight-lock-in"
SETTINGS = SimulationSettings(
    seed=4,
    rows=3,
    cols=4,
    width=192,
    height=160,
    kappa=-0.1,
    fill=0.75,
    jitter_px=1.0,
    jitter_deg=0.2,
    pixels_per_unit=60,
    supersampling=2,
    exposure=0.7,
    hot_share=0.0,
    dead_share=0.0,
)


def made(current: str, settings: SimulationSettings = SETTINGS, **day: float) -> SimulatedDaylight:
    values = {"1": 1.0, "0": 0.0, "h": 0.5}
    return simulate_daylight(settings, Daylight(tuple(values[c] for c in current), **day))


def asked(frames: NDArray[np.uint16], wanted: bool = False) -> Modulation | None:
    pictures = LevelPictures()
    for frame in frames:
        pictures.add(frame)
    return find_modulation(pictures.of(range(len(frames))), wanted)


def written(frames: NDArray[np.uint16], folder: Path) -> Path:
    folder.mkdir()
    for k, frame in enumerate(frames):
        tifffile.imwrite(folder / f"f_{k:02d}.tif", frame)
    return folder


def states(found: Modulation | None) -> str:
    assert found is not None
    return "".join("?" if s is None else str(int(s)) for s in found.current)


@pytest.mark.parametrize("pattern", ["10101010", "1100110011", "1101001011"])
def test_a_switched_current_is_found_whatever_its_pattern(pattern: str) -> None:
    found = asked(made(pattern).frames)
    assert states(found) == pattern
    assert found is not None
    assert found.certain
    assert found.share == pytest.approx(0.1, rel=0.4)


def test_it_is_found_under_clouds_and_with_a_gain_that_keeps_the_mean() -> None:
    frames = made("1010101010", drift=0.3, clouds=0.03, auto_gain=1.0, el_share=0.2).frames
    levels = frames.mean(axis=(1, 2))
    assert np.ptp(levels) < 0.05 * levels.mean()
    assert states(asked(frames)) == "1010101010"


def test_a_frame_that_was_taken_while_the_current_changed_is_neither() -> None:
    assert states(asked(made("1010h01010", el_share=0.2).frames)) == "1010?01010"


@pytest.mark.parametrize("kind", ["night", "bracketed", "own gain", "day"])
def test_frames_without_a_switched_current_are_left_alone(kind: str) -> None:
    if kind == "day":
        frames = made("0" * 8, clouds=0.03).frames
    else:
        flicker = 0.2 if kind == "own gain" else 0.01
        frames = simulated(replace(SETTINGS, n_frames=8, flicker=flicker)).frames
    if kind == "bracketed":
        frames = frames.copy()
        frames[1::2] = 64 + (frames[1::2].astype(np.int64) - 64) // 10
    found = asked(frames)
    assert found is None or not found.certain


@pytest.fixture(scope="module")
def day() -> SimulatedDaylight:
    return made("0110100h1", el_share=0.2)


@pytest.fixture(scope="module")
def folder(day: SimulatedDaylight, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(day.frames, tmp_path_factory.mktemp("daylight") / "frames")


@pytest.fixture(scope="module")
def sequence(folder: Path) -> FrameSequence:
    return FrameSequence.open(folder)


def test_every_frame_with_current_gets_one_without_of_its_own(sequence: FrameSequence) -> None:
    """What two differences share of the noise would pass for detail of the module."""
    lock_in = sequence.lock_in
    assert lock_in is not None
    subtracted = {k: pair.dark for k, pair in lock_in.pairs.items()}
    assert subtracted == {1: 0, 2: 3, 4: 5, 8: 6}
    assert lock_in.unused == {7: NOT_BETWEEN}
    assert lock_in.dark[5] == "without current: subtracted from f_04.tif"
    assert set(lock_in.dark) == {0, 3, 5, 6}
    assert sequence.measured == [1, 2, 4, 8]
    assert "4 differences" in lock_in_sentence(lock_in, confirm=True)
    assert "please confirm" in lock_in_sentence(lock_in, confirm=True)
    assert "confirm" not in lock_in_sentence(lock_in, confirm=False)


def test_a_frame_without_current_that_no_other_needs_says_so(tmp_path: Path) -> None:
    opened = FrameSequence.open(written(made("10001010").frames, tmp_path / "f"), lock_in=True)
    assert opened.lock_in is not None
    assert opened.lock_in.dark[2] == NEVER_NEAREST


def test_a_difference_shows_the_glow_with_the_noise_of_all_its_frames(tmp_path: Path) -> None:
    # Without any motion the glow itself is known to the pixel.
    still = replace(SETTINGS.without_motion(), prnu=0.0, column_offset_e=0.0, column_gain=0.0)
    made_still = made("101010", replace(still, flicker=0.0, full_well_e=8000.0), drift=0.0)
    opened = FrameSequence.open(written(made_still.frames, tmp_path / "f"), lock_in=True)
    ideal = simulate_daylight(replace(still.without_noise(), vignetting=still.vignetting),
                              replace(made_still.daylight, current=(1.0,)))  # fmt: skip
    truth = (ideal.night[0].astype(np.float64) - 64) / ideal.settings.max_dn
    frame = opened.frame(2)
    assert frame.added_variance is not None
    sigma = opened.noise.sigma(np.maximum(truth, 0), frame.added_variance)
    z = (frame.image - truth)[8:-8, 8:-8] / sigma[8:-8, 8:-8]
    detail = z - np.median(z)
    assert 0.85 < 1.4826 * np.median(np.abs(detail)) < 1.15
    alone = opened.noise.sigma(frame.image)
    assert np.median(sigma / alone) > 1.5


def test_differences_of_a_moving_camera_lose_the_background(
    day: SimulatedDaylight, sequence: FrameSequence
) -> None:
    assert sequence.lock_in is not None
    night = day.night[4].astype(np.float64)
    glow = (night - 64) / day.settings.max_dn
    off = day.frames[3].astype(np.float64)
    raw = (day.frames[4] - off) / day.settings.max_dn
    image = sequence.frame(4).image
    inside = (slice(20, -20), slice(20, -20))

    def away(picture: NDArray[np.floating]) -> float:
        rest = (picture - glow)[inside]
        return float(np.std(rest - rest.mean()))

    assert away(image) < 0.5 * away(raw)


def test_the_motion_between_frames_of_different_light_is_found() -> None:
    made_day = made("10", el_share=0.2)
    first, second = made_day.frames.astype(np.float32)
    motion = motion_between(first, second)
    assert motion is not None
    map_x, map_y = motion.maps(first.shape)
    before, after = (made_day.crossings_px(k) for k in (0, 1))
    x, y = np.rint(before).astype(int).T
    found = np.stack([map_x[y, x] - x, map_y[y, x] - y], axis=1)
    assert np.sqrt(np.mean(np.square(found - (after - before)))) < 0.15
    assert motion_between(first, first) is None


def test_a_stack_is_taken_as_a_folder_is(
    day: SimulatedDaylight, sequence: FrameSequence, tmp_path: Path
) -> None:
    tifffile.imwrite(tmp_path / "stack.tif", day.frames)
    opened = FrameSequence.open(tmp_path / "stack.tif")
    assert opened.measured == sequence.measured
    np.testing.assert_array_equal(opened.frame(4).image, sequence.frame(4).image)


def test_frames_stay_as_they_are_where_lock_in_is_not_wanted(folder: Path) -> None:
    opened = FrameSequence.open(folder, lock_in=False)
    assert opened.lock_in is None
    assert opened.measured == list(range(9))
    assert opened.frame(4).added_variance is None


def test_lock_in_of_frames_in_which_nothing_is_switched_is_one_sentence(tmp_path: Path) -> None:
    frames = simulated(replace(SETTINGS, n_frames=5)).frames
    with pytest.raises(InspectionError, match="no part gets brighter and darker") as error:
        FrameSequence.open(written(frames, tmp_path / "f"), lock_in=True)
    assert len(str(error.value)) < 400


def test_a_frame_in_a_passing_shadow_is_left_out_and_says_why(tmp_path: Path) -> None:
    frames = made("10101010").frames.copy()
    frames[4] = np.clip(frames[4] * np.linspace(0.85, 1.15, frames.shape[2]), 0, 4095)
    opened = FrameSequence.open(written(frames, tmp_path / "f"), lock_in=True)
    assert opened.lock_in is not None
    assert set(opened.lock_in.pairs) == {0, 2, 6}
    assert set(opened.lock_in.unused) == {4}


def test_daylight_that_does_not_fit_leaves_more_than_the_glow() -> None:
    day = made("10", SETTINGS.without_motion(), el_share=0.2)
    on, off = (Frame(frame / np.float32(4095), np.ones(frame.shape, bool)) for frame in day.frames)
    region = cv2.resize(day.night[0], on.image.shape[::-1]) > 200
    upside_down = Frame(off.image[::-1].copy(), off.valid)
    left = [fitted(on, Pair(1), dark, region)[1] for dark in (off, upside_down)]
    assert left[0] < 0.1
    assert left[1] > 0.5


def test_a_run_names_the_frames_and_takes_the_differences_alone(folder: Path) -> None:
    steps = inspect_steps(FrameSequence.open(folder), Settings(rows=3, cols=4))
    found = next(step.partial for step in steps if hasattr(step.partial, "frames"))
    steps.close()
    why = [frame.why for frame in found.frames]  # type: ignore[union-attr]
    assert [not text for text in why] == [k in (1, 2, 4, 8) for k in range(9)]
    assert why[0].startswith("without current: subtracted from")
    assert why[7] == NOT_BETWEEN


def test_settings_that_want_it_otherwise_than_the_frames_were_opened_are_refused(
    sequence: FrameSequence,
) -> None:
    with pytest.raises(InspectionError, match="lock_in = False"):
        next(inspect_steps(sequence, Settings(rows=3, cols=4, lock_in=False)))


def test_what_is_not_clear_is_said_not_to_be(sequence: FrameSequence) -> None:
    assert sequence.lock_in is not None
    said = lock_in_sentence(replace(sequence.lock_in, certain=False), confirm=False)
    assert "not clear" in said


def test_a_pixel_that_is_hot_with_current_only_is_no_part_of_a_difference(tmp_path: Path) -> None:
    frames = made("10101010").frames.copy()
    frames[::2, 50, 60] = 4000
    opened = FrameSequence.open(written(frames, tmp_path / "f"))
    assert opened.defects[50, 60]
    assert not opened.frame(2).valid[50, 60]
    assert opened.frame(2).image[50, 60] < 0.1


@pytest.mark.skipif(not CASE.is_dir(), reason="the cases in ../shared are not on this machine")
def test_the_synthetic_case_is_found_without_being_told() -> None:
    opened = FrameSequence.open(CASE)
    assert opened.lock_in is not None
    assert opened.measured == [0, 2, 4, 6, 8]
