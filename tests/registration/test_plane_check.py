from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.registration.plane_check import MARGIN, check_lines
from pv_inspect.registration.seen_lines import seen_lines

LR_PX = 30.0
USUAL = 0.02
HALF_CUT = ModuleLayout(4, 12, 0.5, col_gaps=((6, 0.1),))
MINI = ModuleLayout(4, 9, cell_gap=(0.1, 0.1))


def _drawn(
    layout: ModuleLayout, grid: HrGrid, moved: NDArray[np.float64] | None = None, blur: float = 1.2
) -> NDArray[np.float32]:
    """Draw the cells of a layout, each with a busbar, blurred; `moved` shifts columns."""
    rng = np.random.default_rng(3)
    image = np.full(grid.shape, 0.06, np.float32)
    y, x = (np.arange(n, dtype=np.float64) for n in grid.shape)
    moved = np.zeros(layout.cols) if moved is None else moved
    for row, col in np.ndindex(layout.rows, layout.cols):
        corners = layout.cell_corners(row, col) + np.array([moved[col], 0])
        half = np.maximum(USUAL - np.array(layout.cell_gap), 0) / 2
        low, high = grid.to_pixels(corners[0] + half), grid.to_pixels(corners[2] - half)
        # Share of each pixel that the cell covers.
        across = np.clip(np.minimum(x - low[0], high[0] - x) + 0.5, 0, 1)
        down = np.clip(np.minimum(y - low[1], high[1] - y) + 0.5, 0, 1)
        inside = down[:, None] * across
        busbar = np.where(np.abs(x - (low[0] + high[0]) / 2) < 1, 0.4, 1.0)
        image = np.where(inside > 0, 0.06 + inside * (rng.uniform(0.5, 0.9) * busbar - 0.06), image)
    image = image.astype(np.float32)
    image = cv2.GaussianBlur(image, (0, 0), blur)
    return image + rng.normal(0, 0.005, image.shape).astype(np.float32)


def _said(told: ModuleLayout, true: ModuleLayout, moved: NDArray[np.float64] | None = None) -> str:
    """Check a layout that is told on the image of a true one, both with the same middle."""
    grid = HrGrid.covering(told, LR_PX, 2.0, MARGIN)
    off = (np.array(told.size) - np.array(true.size)) / 2 * grid.pixels_per_unit
    origin = (grid.origin_px[0] + float(off[0]), grid.origin_px[1] + float(off[1]))
    module = _drawn(true, replace(grid, layout=true, origin_px=origin), moved)
    return check_lines(told, *seen_lines(module, grid))


@pytest.mark.parametrize("layout", [ModuleLayout(3, 5), HALF_CUT, MINI, ModuleLayout(2, 2)])
def test_nothing_is_said_of_a_layout_that_is_right(layout: ModuleLayout) -> None:
    assert _said(layout, layout) == ""


@pytest.mark.parametrize("blur_lr_px", [0.9, 1.4, 2.0])
def test_blur_is_not_taken_for_wide_gaps(blur_lr_px: float) -> None:
    layout = ModuleLayout(3, 5)
    grid = HrGrid.covering(layout, LR_PX, 2.0, MARGIN)
    module = _drawn(layout, grid, blur=blur_lr_px * 2.0)
    assert check_lines(layout, *seen_lines(module, grid)) == ""


@pytest.mark.parametrize("gap", [0.05, 0.15])
def test_a_wide_gap_of_another_width_is_said(gap: float) -> None:
    said = _said(replace(HALF_CUT, col_gaps=((6, gap),)), HALF_CUT)
    assert "column 6" in said
    assert len(said) < 400


def test_a_wide_gap_that_nobody_told_is_said() -> None:
    assert "column" in _said(HALF_CUT.plain, HALF_CUT)


@pytest.mark.parametrize("gap", [0.0, 0.05, 0.15])
def test_gaps_between_all_cells_of_another_width_are_said(gap: float) -> None:
    told = replace(MINI, cell_gap=(gap, gap))
    assert "between all columns a gap of 0.1 cell" in _said(told, MINI)


def test_lines_that_lie_off_more_and_more_are_said() -> None:
    bent = 0.5 / LR_PX * np.linspace(0, 1, 9) ** 3
    said = _said(MINI, MINI, moved=bent)
    assert "the lines between columns lie up to 0." in said
    assert "most near column 8" in said


def test_a_line_of_few_that_lies_elsewhere_is_said() -> None:
    said = _said(ModuleLayout(3, 3), ModuleLayout(3, 3), moved=np.array([0, 0.06, 0.0]))
    assert "column" in said


def test_a_module_that_ends_elsewhere_is_said() -> None:
    true = ModuleLayout(4, 6)
    grid = HrGrid.covering(true, LR_PX, 2.0, MARGIN)
    module = _drawn(true, grid)
    x = grid.to_pixels(np.array([[5.9, 0.0]]))[0, 0]
    module[:, int(x) :] = 0.06
    assert "the last column ends 0." in check_lines(true, *seen_lines(module, grid))
