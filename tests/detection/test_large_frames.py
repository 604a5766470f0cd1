from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pv_inspect.common.work import result_of
from pv_inspect.detection.detect import detect
from pv_inspect.detection.large_frames import ReducedFrames, enlarged, reduction
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.simulate import SimulationSettings, simulated
from tests.detection.test_detect import _in_memory

LAYOUT = ModuleLayout(3, 4)


@pytest.fixture(scope="module")
def large() -> tuple[Any, Any]:
    """A frame of 1280 x 1000 px with cells of about 270 px."""
    numbers: dict[str, Any] = {"rows": 3, "cols": 4, "n_frames": 1, "width": 1280, "height": 1000}
    simulation = simulated(
        SimulationSettings(supersampling=2, pixels_per_unit=300, seed=2, **numbers)
    )
    frames = [(frame.astype(np.float32) - 64) / 4031 for frame in simulation.frames]
    return simulation, _in_memory(frames)


def test_crossings_of_cells_with_many_pixels_are_found(large: tuple[Any, Any]) -> None:
    simulation, sequence = large
    assert reduction(sequence, LAYOUT) == 2
    (found,) = result_of(detect(sequence, LAYOUT)).frames
    away = np.linalg.norm(found.points_px - simulation.crossings_px(0), axis=1)
    assert found.measured.mean() > 0.8
    assert np.median(away[found.measured]) < 0.5


def test_frames_of_usual_size_and_reduced_ones_stay_as_they_are(large: tuple[Any, Any]) -> None:
    reduced = ReducedFrames(large[1], 2).as_sequence()
    assert reduced.shape == (500, 640)
    assert reduced.frame(0).image.shape == (500, 640)
    assert reduction(reduced, LAYOUT) == 1
    assert reduction(_in_memory([np.zeros((512, 640), np.float32)]), LAYOUT) == 1


def test_a_reduced_pixel_lies_in_the_middle_of_those_it_is_made_of() -> None:
    sequence = _in_memory([np.arange(16.0, dtype=np.float32).reshape(1, 16).repeat(16, axis=0)])
    reduced = ReducedFrames(sequence, 4)
    assert reduced.frame(0).image[0].tolist() == [1.5, 5.5, 9.5, 13.5]
    assert reduced.point((5.5, 1.5)) == (1.0, 0.0)


def test_places_in_sentences_are_those_of_the_frames() -> None:
    def search() -> Any:
        yield 0.5
        raise InspectionError("There is no module at (10, 20.5) px.")

    with pytest.raises(InspectionError, match=r"at \(42, 84\) px") as said:
        result_of(enlarged(search(), 4))
    assert "10" not in str(said.value)
