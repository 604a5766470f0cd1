"""A grid that is not that of the module is told from one frame, also where cells are dead."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pv_inspect.detection.grid_check import cell_levels, grid_fault, is_lit
from pv_inspect.detection.outline import OutlineError
from pv_inspect.detection.single_frame import detect_in_frame, find_module
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose
from pv_inspect.simulate import SimulatedSequence

TRUE = ModuleLayout(4, 6)
Module = tuple[np.ndarray, Pose]


@pytest.fixture(scope="module")
def module(small_sequence: tuple[SimulatedSequence, Path]) -> Module:
    image = (small_sequence[0].frames[0].astype(np.float32) - 64) / 4031
    return image, find_module(image, TRUE).pose


def shifted(pose: Pose, columns: float, rows: float) -> Pose:
    shift = np.array([[1.0, 0, columns], [0, 1, rows], [0, 0, 1]])
    return Pose(pose.camera, pose.homography @ shift)


def module_points(image: np.ndarray, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
    """Module coordinates x and y of every pixel."""
    height, width = image.shape
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2)
    x, y = pose.unproject(pixels.astype(np.float64)).T
    return x.reshape(height, width), y.reshape(height, width)


def test_nothing_speaks_against_the_true_grid(module: Module) -> None:
    assert grid_fault(module[0], TRUE, module[1], whole=True) == ""


@pytest.mark.parametrize(
    ("rows", "cols", "at", "fault"),
    [
        (3, 6, (0, 0), "goes on beyond the last row"),
        (3, 6, (0, 1), "goes on beyond the first row"),
        (4, 4, (1, 0), "goes on beyond the first column"),
        (5, 6, (0, 0), "all of the last row is as dark"),
        (4, 7, (-1, 0), "all of the first column is as dark"),
        (4, 8, (-1, 0), "all of the first column is as dark"),
    ],
)
def test_a_grid_on_the_lines_of_the_module_but_too_small_or_too_large_is_told(
    module: Module, rows: int, cols: int, at: tuple[int, int], fault: str
) -> None:
    image, pose = module
    assert fault in grid_fault(image, ModuleLayout(rows, cols), shifted(pose, *at))


def test_a_grid_that_ends_at_no_border_is_told(module: Module) -> None:
    image, pose = module
    x, y = module_points(image, pose)
    beyond = (x > 0) & (x < 6) & ((y < 0.2) | (y > 3.8))
    endless = np.where(beyond, np.float32(np.percentile(image, 90)), image)
    assert detect_in_frame(image, TRUE, pose, whole=True).share > 0.9
    with pytest.raises(OutlineError, match="begin and end at no border"):
        detect_in_frame(endless, TRUE, pose, whole=True)


def test_half_as_many_rows_and_columns_are_told_by_the_borders_within(module: Module) -> None:
    image, pose = module
    doubled = Pose(pose.camera, pose.homography @ np.diag([2.0, 2, 1]))
    assert "in the middle" in grid_fault(image, ModuleLayout(2, 3), doubled)


def test_halves_are_told_where_most_of_the_lines_of_one_direction_are_hidden(
    module: Module,
) -> None:
    image, pose = module
    x, y = module_points(image, pose)
    hidden = (x > 0) & (x < 4) & (y > 0.5) & (y < 3.5) & (np.abs(y - np.round(y)) < 0.2)
    smeared = np.where(hidden, np.float32(np.percentile(image, 90)), image)
    doubled = Pose(pose.camera, pose.homography @ np.diag([2.0, 2, 1]))
    assert "in the middle" in grid_fault(smeared, ModuleLayout(2, 3), doubled)
    assert "in the middle" not in grid_fault(smeared, TRUE, pose)


def test_a_line_that_is_no_gap_is_told(module: Module) -> None:
    image, pose = module
    # The third line of columns is moved into the middle of a cell by closing its gap.
    closed = image.copy()
    middle = pose.project(np.column_stack([np.full(200, 3.0), np.linspace(0.05, 3.95, 200)]))
    for x, y in np.round(middle).astype(int):
        closed[y, x - 3 : x + 4] = np.linspace(closed[y, x - 4], closed[y, x + 4], 7)
    assert "no border between column 3 and 4" in grid_fault(closed, TRUE, pose)


def test_a_dim_outer_row_belongs_to_the_module(module: Module) -> None:
    image, pose = module
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    at = pose.unproject(np.column_stack([x.ravel(), y.ravel()]).astype(float))
    in_row = (at[:, 1] < 1) & (at[:, 1] > 0) & (at[:, 0] > 0) & (at[:, 0] < 6)
    dim = np.where(in_row.reshape(image.shape), 0.2 * image, image).astype(np.float32)
    assert not is_lit(cell_levels(dim, TRUE, pose)[0]).any()
    assert grid_fault(dim, TRUE, pose, whole=True) == ""
