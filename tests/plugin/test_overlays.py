from __future__ import annotations

import numpy as np
import pytest

from napari_pv_inspect.coordinates import in_frame, segments_in_frame, to_world
from napari_pv_inspect.layers.overlays import (
    SEGMENTS_PER_CELL,
    crossing_marks,
    frame_grid,
    grid_of_frames,
    grid_segments,
)
from napari_pv_inspect.layers.placement import cell_box, module_placement
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.inspection.inspection import Inspection


def test_x_y_of_the_core_becomes_row_col_of_napari() -> None:
    np.testing.assert_array_equal(to_world(np.array([[3.0, 7.0]])), [[7.0, 3.0]])
    np.testing.assert_array_equal(in_frame(np.array([[3.0, 7.0]]), 5), [[5.0, 7.0, 3.0]])


def test_a_segment_is_its_start_and_the_way_to_its_end() -> None:
    vectors = segments_in_frame(np.array([[1.0, 2.0]]), np.array([[4.0, 8.0]]), 3)
    np.testing.assert_array_equal(vectors, [[[3.0, 2.0, 1.0], [0.0, 6.0, 3.0]]])


@pytest.mark.parametrize(("rows", "cols", "aspect"), [(1, 1, 1.0), (3, 4, 1.0), (20, 6, 2.0)])
def test_grid_lines_have_the_length_of_all_cell_borders(
    rows: int, cols: int, aspect: float
) -> None:
    layout = ModuleLayout(rows, cols, aspect)
    start, end = grid_segments(layout)
    width, height = layout.size
    length = np.linalg.norm(end - start, axis=1).sum()
    assert length == pytest.approx((rows + 1) * width + (cols + 1) * height)
    assert len(start) == SEGMENTS_PER_CELL * ((rows + 1) * cols + (cols + 1) * rows)


def test_segments_beyond_the_fold_of_the_lens_are_left_out() -> None:
    layout = ModuleLayout(2, 2)
    K = np.array([[100.0, 0, 50], [0, 100.0, 50], [0, 0, 1]])
    H = np.diag([1.0, 1.0, 1.0])
    whole = frame_grid(layout, Camera(K, 0.0), H, 0)
    cut = frame_grid(layout, Camera(K, -0.2), H, 0)
    assert 0 < len(cut) < len(whole)
    assert np.isfinite(cut).all()


def test_grid_lines_meet_at_the_fitted_crossing_points(tiny_inspection: Inspection) -> None:
    geometry = tiny_inspection.registration
    assert geometry is not None
    for i, segments in enumerate(grid_of_frames(tiny_inspection)):
        corners = in_frame(geometry.crossings_px(i), i)
        distance = np.linalg.norm(segments[:, None, 0] - corners[None, :], axis=2)
        # Every crossing point but the last of a line starts a segment.
        assert (distance.min(axis=0)[:-1].reshape(-1) < 1e-9).sum() >= 0.8 * len(corners)


def test_every_known_crossing_point_is_drawn_once_in_its_frame(tiny_inspection: Inspection) -> None:
    marks = crossing_marks(tiny_inspection.crossings)
    layout = tiny_inspection.layout
    assert len(marks.points) == len(tiny_inspection.sequence) * layout.n_crossings
    assert set(marks.points[:, 0]) == {float(i) for i in range(len(tiny_inspection.sequence))}
    assert marks.measured.any()


def test_the_module_lies_right_of_the_frame_at_the_same_scale() -> None:
    grid = HrGrid.covering(ModuleLayout(6, 10), 50.0, 4.0)
    place = module_placement(grid, grid.shape, (512, 640))
    top, left, height, _width = place.box(grid.shape)
    assert left > 640
    assert top + height / 2 == pytest.approx(256)
    _, _, cell_height, cell_width = cell_box(grid, place, 0, 0)
    assert (cell_height, cell_width) == pytest.approx((50.0, 50.0))


def test_a_coarse_preview_fills_the_place_of_the_module() -> None:
    grid = HrGrid.covering(ModuleLayout(6, 10), 50.0, 4.0)
    fine = module_placement(grid, grid.shape, (512, 640))
    half = (grid.shape[0] // 2, grid.shape[1] // 2)
    coarse = module_placement(grid, half, (512, 640))
    assert coarse.box(half) == pytest.approx(fine.box(grid.shape))
