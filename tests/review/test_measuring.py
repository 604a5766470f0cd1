from __future__ import annotations

import cv2
import numpy as np
import pytest

from pv_inspect.cells import CellTiles
from pv_inspect.cracks.isolation import Busbars
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.review import Measure, measured

N = 200
TILE = np.full((N, N), 0.5, np.float32)
NOTHING = np.zeros((N, N), np.float32)
LINES = np.zeros(N, bool)
LINES[[60, 61, 140, 141]] = True
MEASURE = Measure(0.5, float(N), 0.5, {(N, N): Busbars(True, LINES)}, 156.0)


def line(start: tuple[int, int], end: tuple[int, int]) -> np.ndarray:
    mask = np.zeros((N, N), np.uint8)
    cv2.line(mask, start, end, 1, 3)
    return mask > 0


def test_busbars_are_those_of_cells_of_the_same_size() -> None:
    grid = HrGrid.covering(ModuleLayout(3, 3, col_widths=((3, 0.5),)), 25.0, 4.0)
    image = np.full(grid.shape, 0.4, np.float32)
    for row, col in np.ndindex(3, 3):
        y, x = grid.cell_slices(row, col)
        for across in (25, 75) if col < 2 else (25,):
            image[y, x.start + across - 2 : x.start + across + 2] = 0.15
    measure = Measure.of_cells(CellTiles(image, grid), 0.5, None, None)
    whole, cut = measure.busbars[100, 100], measure.busbars[100, 50]
    assert whole is not None
    assert cut is not None
    for bars, places in ((whole, (25, 75)), (cut, (25,))):
        assert not bars.horizontal
        near = np.any([abs(np.arange(bars.lines.size) - at) < 6 for at in places], axis=0)
        assert not bars.lines[~near].any()
        assert all(bars.lines[at - 5 : at + 5].any() for at in places)


def test_the_length_follows_the_brush() -> None:
    short, long = (line((20, 100), (end, 100)) for end in (60, 140))
    a, b = (measured(m, TILE, NOTHING, MEASURE, row=0, col=0) for m in (short, long))
    assert a.crack_length_cells == pytest.approx(40 / N, abs=5 / N)
    assert b.crack_length_cells == pytest.approx(120 / N, abs=5 / N)
    assert b.crack_length_mm == pytest.approx(156 * b.crack_length_cells)


def test_the_isolated_area_follows_the_brush() -> None:
    """A line below the last busbar cuts off what is below it, over its own width."""
    found = measured(line((50, 170), (149, 170)), TILE, NOTHING, MEASURE, row=0, col=0)
    assert found.isolated_area_share == pytest.approx(102 / N * 29.5 / N, rel=0.05)
    between = measured(line((50, 100), (149, 100)), TILE, NOTHING, MEASURE, row=0, col=0)
    assert between.isolated_area_share == 0


def test_the_eraser_takes_everything_away() -> None:
    found = measured(NOTHING > 0, TILE, NOTHING + 1, MEASURE, row=0, col=0)
    assert (found.crack_length_cells, found.crack_instances) == (0, 0)
    assert found.isolated_area_share == 0
    assert found.crack_score == 1  # the detector's, as it was


def test_what_a_person_draws_counts_however_small_and_in_a_dark_cell() -> None:
    small = line((100, 100), (108, 100))
    found = measured(small, TILE, NOTHING, MEASURE, row=0, col=0)
    assert found.crack_instances == 1
    dark = measured(small, TILE * 0, NOTHING, MEASURE, row=0, col=0)
    assert dark.dark
    assert dark.crack_length_cells == found.crack_length_cells > 0


def test_a_mask_of_another_result_is_refused() -> None:
    with pytest.raises(
        InspectionError, match=r"row 1, column 2 is 90 x 80 px, the cell is 200 x 2"
    ):
        measured(np.zeros((80, 90), bool), TILE, NOTHING, MEASURE, row=0, col=1)
