from __future__ import annotations

from typing import Any

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


def test_a_wide_gap_moves_what_lies_beyond_it_and_its_crossing_points_are_in_its_middle() -> None:
    layout = ModuleLayout(2, 4, 0.5, row_gaps=((1, 0.3),), col_gaps=((2, 0.2),))
    assert layout.col_lines.tolist() == pytest.approx([0, 1, 2.1, 3.2, 4.2])
    assert layout.row_lines.tolist() == pytest.approx([0, 2.15, 4.3])
    assert layout.size == pytest.approx((4.2, 4.3))
    assert layout.cell_corners(1, 2).tolist() == pytest.approx(
        np.array([[2.2, 2.3], [3.2, 2.3], [3.2, 4.3], [2.2, 4.3]])
    )


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"col_gaps": ((4, 0.2),)}, "from 1 to 3"),
        ({"col_gaps": ((2, 0.2), (1, 0.2))}, "in order"),
        ({"row_gaps": ((1, -0.1),)}, "above 0"),
        ({"cell_gap": (0.6, 0.1)}, "half of a cell"),
    ],
)
def test_gaps_that_are_none_are_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InspectionError, match=words):
        ModuleLayout(3, 4, **changes)


gapped = st.builds(
    lambda rows, cols, aspect, row, col, between: ModuleLayout(
        rows,
        cols,
        aspect,
        ((rows // 2, row),) if rows > 1 and row else (),
        ((cols // 2, col),) if cols > 1 and col else (),
        (between, between / aspect),
    ),
    st.integers(1, 12),
    st.integers(1, 12),
    st.sampled_from([0.5, 1.0, 2.0]),
    st.sampled_from([0.0, 0.1, 0.4]),
    st.sampled_from([0.0, 0.1, 0.4]),
    st.sampled_from([0.0, 0.05, 0.2]),
)


@given(gapped, st.floats(20, 90))
def test_the_tiles_of_a_module_with_gaps_are_alike_and_lie_where_its_cells_are(
    layout: ModuleLayout, scale: float
) -> None:
    grid = HrGrid.covering(layout, scale, 2.0)
    shapes = set()
    for row, col in np.ndindex(layout.rows, layout.cols):
        down, across = grid.cell_slices(row, col)
        corners = grid.to_pixels(layout.cell_corners(row, col))
        # Pixels are whole: a tile may lie a pixel off where the gap is no whole number of them.
        np.testing.assert_allclose([across.start - 0.5, down.start - 0.5], corners[0], atol=1.01)
        np.testing.assert_allclose([across.stop - 0.5, down.stop - 0.5], corners[2], atol=1.51)
        shapes.add((down.stop - down.start, across.stop - across.start))
    assert len(shapes) == 1


uneven = st.builds(
    lambda layout, row, col, width: ModuleLayout(
        layout.rows + 1,
        layout.cols + 1,
        layout.cell_aspect,
        layout.row_gaps,
        layout.col_gaps,
        layout.cell_gap,
        ((row % layout.rows + 1, 1.3 * width / layout.cell_aspect),),
        ((col % layout.cols + 1, width),),
    ),
    gapped,
    st.integers(0, 11),
    st.integers(0, 11),
    st.sampled_from([0.5, 0.73, 1.4]),
)


def test_a_narrow_column_moves_what_lies_beyond_it() -> None:
    layout = ModuleLayout(2, 4, 0.5, col_gaps=((2, 0.2),), col_widths=((2, 0.4),))
    assert layout.col_lines.tolist() == pytest.approx([0, 1, 1.5, 2.6, 3.6])
    assert layout.col_starts.tolist() == pytest.approx([0, 1, 1.6, 2.6])
    assert layout.size == pytest.approx((3.6, 4.0))
    assert layout.cell_corners(0, 1)[[0, 2]].ravel().tolist() == pytest.approx([1, 0, 1.4, 2])
    assert layout.cell_centres()[1].tolist() == pytest.approx([1.2, 1.0])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"col_widths": ((5, 0.5),)}, "from 1 to 4"),
        ({"col_widths": ((2, 0.5), (1, 0.5))}, "in order"),
        ({"col_widths": ((2, 0.05),)}, "Column 2 is said to be 0.05 .* 0.1 to 2"),
        ({"row_heights": ((1, 5.0),)}, "Row 1 is said to be 5"),
        ({"row_heights": ((1, 0.5), (2, 0.5), (3, 0.5))}, "All 3 rows are said to differ"),
        ({"col_widths": ((2, 0.2),), "cell_gap": (0.15, 0.15)}, "half of a cell"),
    ],
)
def test_widths_that_are_none_are_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InspectionError, match=words):
        ModuleLayout(3, 4, **changes)


@given(uneven, st.floats(30, 90))
def test_tiles_of_uneven_cells_lie_where_the_cells_are_and_are_alike_in_a_column(
    layout: ModuleLayout, scale: float
) -> None:
    grid = HrGrid.covering(layout, scale, 2.0)
    widths: dict[float, set[int]] = {}
    for row, col in np.ndindex(layout.rows, layout.cols):
        down, across = grid.cell_slices(row, col)
        corners = grid.to_pixels(layout.cell_corners(row, col))
        np.testing.assert_allclose([across.start - 0.5, down.start - 0.5], corners[0], atol=1.01)
        np.testing.assert_allclose([across.stop - 0.5, down.stop - 0.5], corners[2], atol=1.51)
        assert across.stop <= grid.shape[1]
        assert down.stop <= grid.shape[0]
        widths.setdefault(float(layout.widths[col]), set()).add(across.stop - across.start)
    assert all(len(pixels) == 1 for pixels in widths.values())


@given(gapped | uneven)
def test_the_cells_cut_in_four_lie_on_the_lines_of_the_module(layout: ModuleLayout) -> None:
    finer = layout.halved()
    np.testing.assert_allclose(finer.col_lines[::2], 2 * layout.col_lines, atol=1e-9)
    np.testing.assert_allclose(finer.row_lines[::2], 2 * layout.row_lines, atol=1e-9)


@given(gapped | uneven, st.integers(1, 3))
def test_rows_and_columns_around_leave_the_module_as_it_is(layout: ModuleLayout, n: int) -> None:
    around = layout.with_rows_around(n)
    inside = around.col_lines[n:-n] - around.col_lines[n]
    np.testing.assert_allclose(inside, layout.col_lines, atol=1e-9)


def test_a_module_is_turned_only_where_its_lines_fall_onto_each_other() -> None:
    assert ModuleLayout(3, 3).turns == (0, 1, 2, 3)
    assert ModuleLayout(3, 4).turns == (0, 2)
    assert ModuleLayout(4, 4, col_gaps=((2, 0.1),)).turns == (0, 2)
    assert ModuleLayout(4, 4, col_gaps=((1, 0.1),)).turns == (0,)
    assert ModuleLayout(4, 4, col_widths=((4, 0.5),)).turns == (0,)
    assert ModuleLayout(4, 4, col_widths=((1, 0.5), (4, 0.5))).turns == (0, 2)
