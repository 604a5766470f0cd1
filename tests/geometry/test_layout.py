from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pv_inspect.errors import InspectionError
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout


def test_crossings_are_row_major_and_in_units_of_the_cell_width() -> None:
    points = ModuleLayout(2, 3, 2.0).crossings().reshape(3, 4, 2)
    assert points[0, 3].tolist() == [3.0, 0.0]
    assert points[2, 1].tolist() == [1.0, 1.0]


@pytest.mark.parametrize(("rows", "cols", "aspect"), [(0, 3, 1.0), (3, -1, 1.0), (3, 3, np.nan)])
def test_a_module_without_cells_is_refused(rows: int, cols: int, aspect: float) -> None:
    with pytest.raises(InspectionError, match="cell"):
        ModuleLayout(rows, cols, aspect)


@given(
    st.integers(1, 20),
    st.integers(1, 20),
    st.sampled_from([0.5, 1.0, 1.03, 2.0]),
    st.floats(5, 90),
    st.floats(1, 6),
)
def test_grid_maps_there_and_back_and_holds_every_cell(
    rows: int, cols: int, aspect: float, scale: float, magnification: float
) -> None:
    layout = ModuleLayout(rows, cols, aspect)
    grid = HrGrid.covering(layout, scale, magnification)
    points = layout.crossings()
    np.testing.assert_allclose(grid.to_module(grid.to_pixels(points)), points, atol=1e-9)
    homogeneous = np.column_stack([grid.to_pixels(points), np.ones(len(points))]) @ grid.matrix.T
    np.testing.assert_allclose(homogeneous[:, :2], points, atol=1e-9)
    shapes = set()
    for row in range(rows):
        for col in range(cols):
            down, across = grid.cell_slices(row, col)
            assert down.start >= 0
            assert down.stop <= grid.shape[0]
            assert across.start >= 0
            assert across.stop <= grid.shape[1]
            shapes.add((down.stop - down.start, across.stop - across.start))
    assert len(shapes) == 1
    assert abs(grid.magnification / magnification - 1) <= 0.5 / (scale * magnification) + 1e-9


def test_a_tile_begins_at_its_crossing() -> None:
    grid = HrGrid.covering(ModuleLayout(2, 3), 30.2, 4)
    down, across = grid.cell_slices(1, 2)
    x, y = grid.to_pixels(np.array([2.0, 1.0]))
    assert across.start == x + 0.5
    assert down.start == y + 0.5
