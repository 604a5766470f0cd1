from __future__ import annotations

from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from numpy.typing import NDArray

from pv_inspect.common.work import result_of
from pv_inspect.detection.detect import detect
from pv_inspect.detection.outline import OutlineError
from pv_inspect.detection.overlapping_view import poses_in_other_frame
from pv_inspect.detection.single_frame import find_module
from pv_inspect.simulate import SimulationSettings, simulated

Image = NDArray[np.float32]
SETTINGS = SimulationSettings(
    seed=4, rows=4, cols=6, n_frames=2, width=640, height=512, fill=0.45, kappa=0.0,
    jitter_px=3.0, pixels_per_unit=100, supersampling=3,
)  # fmt: skip
WHOLE = (slice(128, 384), slice(160, 480))
SHIFT = 115


@pytest.fixture(scope="module")
def frames() -> tuple[Image, Image]:
    """One that shows the whole module, and one taken beside it that cuts off its left part."""
    first, second = ((f.astype(np.float32) - 64) / 4031 for f in simulated(SETTINGS).frames)
    beside = (WHOLE[0], slice(WHOLE[1].start + SHIFT, WHOLE[1].stop + SHIFT))
    return first[WHOLE], second[beside]


def _in_memory(frames: tuple[Image, ...]) -> Any:
    class Frames:
        names = tuple(f"frame_{i}.tif" for i in range(len(frames)))
        shape = frames[0].shape
        no_measurements: ClassVar[dict[int, str]] = {}
        lock_in = None
        measured = tuple(range(len(frames)))

        def __len__(self) -> int:
            return len(frames)

        def frame(self, index: int) -> Any:
            return SimpleNamespace(image=frames[index])

    return Frames()


def test_the_module_is_carried_over_into_a_frame_that_cuts_it(frames: tuple[Image, Image]) -> None:
    whole, part = frames
    pose = find_module(whole, SETTINGS.layout).pose
    carried = next(poses_in_other_frame(whole, part, pose))
    points = SETTINGS.layout.crossings()
    moved = carried.project(points) - pose.project(points) + [SHIFT, 0]
    # The frames differ by a jitter of some pixels besides.
    assert np.abs(moved).max() < 15
    assert np.ptp(moved, axis=0).max() < 5


def test_crossing_points_are_found_in_a_frame_that_cuts_the_module(
    frames: tuple[Image, Image],
) -> None:
    crossings = result_of(detect(_in_memory(frames), SETTINGS.layout))
    assert [frame.why for frame in crossings.frames] == ["", ""]
    part = crossings.frames[1]
    seen = part.points_px[:, 0] > 0
    assert 0.5 < seen.mean() < 0.9
    assert part.measured[seen].mean() > 0.8
    truth = simulated(SETTINGS).crossings_px(1) - [WHOLE[1].start + SHIFT, WHOLE[0].start]
    error = min(
        np.abs(part.points_px - points)[part.measured].max() for points in (truth, truth[::-1])
    )
    assert error < 0.6


def test_a_frame_that_shows_something_else_is_refused(frames: tuple[Image, Image]) -> None:
    whole, _ = frames
    rng = np.random.default_rng(0)
    other = np.asarray(rng.normal(0.3, 0.05, whole.shape), np.float32)
    pose = find_module(whole, SETTINGS.layout).pose
    with pytest.raises(OutlineError, match="does not look like its neighbours"):
        list(poses_in_other_frame(whole, other, pose))
