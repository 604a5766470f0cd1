from __future__ import annotations

from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pv_inspect.detection import single_frame
from pv_inspect.detection.outline import OutlineError
from pv_inspect.detection.single_frame import find_module
from pv_inspect.detection.wide_gaps import gaps_in_frame
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose
from pv_inspect.simulate import SimulatedSequence, SimulationSettings, simulated

HALF_CUT = {"rows": 4, "cols": 12, "cell_aspect": 0.5}
MINI = {"rows": 2, "cols": 2, "width": 256, "height": 256}


def _settings(**values: Any) -> SimulationSettings:
    small = {"n_frames": 1, "width": 400, "height": 320, "pixels_per_unit": 100, "seed": 3}
    return SimulationSettings(supersampling=3, **{**small, **values})


@cache
def _made(settings: SimulationSettings) -> SimulatedSequence:
    return simulated(settings)


def _frame(settings: SimulationSettings) -> NDArray[np.float32]:
    return (_made(settings).frames[0].astype(np.float32) - 64) / 4031


@pytest.mark.parametrize("gap", [0.05, 0.1, 0.2, 0.4])
def test_the_gap_of_a_half_cut_module_is_found_without_being_told(gap: float) -> None:
    settings = _settings(**HALF_CUT, col_gap=gap)
    found = gaps_in_frame(_frame(settings), settings.layout.plain)
    assert found is not None
    assert [after for after, _ in found.col_gaps] == [6]
    # From one frame: a quarter of a pixel. A sequence takes the median of several.
    assert found.col_gaps[0][1] == pytest.approx(gap, abs=0.008)
    assert found.row_gaps == ()
    assert found.cell_gap == (0.0, 0.0)


@pytest.mark.parametrize("cell", [(0, 0), (3, 8)])
def test_a_dark_corner_cell_hides_no_gaps_between_all_cells(cell: tuple[int, int]) -> None:
    # Without its corner the grid fitted with wider gaps after row 2 and column 6, or not at all.
    settings = _settings(
        rows=4, cols=9, cell_gap=0.1, width=320, height=256, pixels_per_unit=70, seed=4,
        dark_cell_share=0.0,
    )  # fmt: skip
    corners = _made(settings).crossings_px(0).reshape(5, 10, 2)
    (row, col), dark = cell, np.zeros((256, 320), np.float32)
    around = corners[row : row + 2, col : col + 2].reshape(4, 2)[[0, 1, 3, 2]]
    cv2.fillPoly(dark, [around.round().astype(np.int32)], 0.85)
    found = gaps_in_frame(_frame(settings) * (1 - dark), settings.layout.plain)
    assert found is not None
    assert (found.row_gaps, found.col_gaps) == ((), ())
    assert found.cell_gap == pytest.approx((0.1, 0.1), abs=0.01)


def test_a_narrow_gap_is_found_where_it_is_clear() -> None:
    settings = _settings(rows=12, cols=4, cell_aspect=2.0, row_gap=0.019, width=320, height=400)
    found = gaps_in_frame(_frame(settings), settings.layout.plain)
    assert found is not None
    assert found.row_gaps == ((6, pytest.approx(0.019, abs=0.004)),)
    assert found.col_gaps == ()


@pytest.mark.parametrize("told", [0.17, 0.21])
def test_a_gap_told_a_little_wrong_does_not_move_the_grid(told: float) -> None:
    settings = _settings(**MINI, cell_gap=0.19, dark_cell_share=0.0)
    found = find_module(_frame(settings), ModuleLayout(2, 2, cell_gap=(told, told)))
    true = _made(settings).crossings_px(0)
    points = found.pose.project(settings.layout.crossings())
    turns = [np.rot90(np.arange(9).reshape(3, 3), k).ravel() for k in range(4)]
    assert min(np.abs(points[turn] - true).max() for turn in turns) < 0.5


@pytest.mark.parametrize(
    "values", [HALF_CUT, {"rows": 4, "cols": 6}, {"rows": 5, "cols": 8, "seed": 5}, MINI]
)
def test_no_gap_is_found_where_all_are_alike(values: dict[str, Any]) -> None:
    settings = _settings(**values)
    assert gaps_in_frame(_frame(settings), settings.layout) == settings.layout


@pytest.mark.parametrize("gap", [0.06, 0.12, 0.2])
@pytest.mark.parametrize("module", [MINI, {"rows": 3, "cols": 5}])
def test_gaps_between_all_cells_are_measured(module: dict[str, Any], gap: float) -> None:
    settings = _settings(**module, cell_gap=gap, dark_cell_share=0.0)
    found = gaps_in_frame(_frame(settings), settings.layout.plain)
    assert found is not None
    assert found.cell_gap == pytest.approx((gap, gap), abs=0.01)
    assert found.row_gaps == found.col_gaps == ()


def test_a_layout_that_says_its_gap_is_found_where_an_even_one_is_not() -> None:
    settings = _settings(**HALF_CUT, col_gap=0.25)
    frame = _frame(settings)
    assert find_module(frame, settings.layout).share > 0.95
    with pytest.raises(OutlineError):
        find_module(frame, settings.layout.plain)


def test_wrong_rows_are_not_explained_by_a_gap() -> None:
    settings = _settings(rows=5, cols=6)
    assert gaps_in_frame(_frame(settings), ModuleLayout(4, 6)) is None


def test_cells_that_fit_with_an_impossible_lens_only_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    settings = _settings(**MINI, cell_gap=0.06, dark_cell_share=0.0)

    def bent(pose: Pose, *_: object) -> Pose:
        return Pose(Camera(pose.camera.K, 207.0), pose.homography)

    monkeypatch.setattr(single_frame, "refined_pose", bent)
    with pytest.raises(OutlineError, match="kappa \\+207, which no lens has"):
        find_module(_frame(settings), settings.layout)
