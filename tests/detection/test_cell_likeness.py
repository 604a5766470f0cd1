"""Cells are told from what lies between busbars by where their brightness changes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pv_inspect.detection.cell_likeness import CellLikeness, cell_likeness
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose

CELL_PX, ROWS, COLS = 32, 10, 12
PLANE = ModuleLayout(ROWS + 2, COLS + 2)


def _module(cell_to_cell: float) -> NDArray[np.float32]:
    """Cells of different brightness with dark borders and four level busbars as dark as these."""
    levels = np.random.default_rng(2).normal(1, cell_to_cell, (ROWS, COLS))
    image = np.kron(levels, np.ones((CELL_PX, CELL_PX)))
    image[:, ::CELL_PX] *= 0.7
    image[::CELL_PX] *= 0.7
    image[CELL_PX // 8 :: CELL_PX // 4] *= 0.7
    return np.asarray(image, np.float32)


def _likeness(
    image: NDArray[np.float32], beside: tuple[float, float] = (0, 0), side: float = 1.0
) -> CellLikeness:
    """See the module through a grid whose lines lie so many cells beside the borders."""
    scale = side * CELL_PX
    at = (np.array(beside) - side) * CELL_PX
    H = np.array([[scale, 0, at[0]], [0, scale, at[1]], [0, 0, 1]])
    looks = cell_likeness(image, np.ones(image.shape, bool), Pose(Camera(np.eye(3), 0.0), H), PLANE)
    assert looks is not None
    return looks


def test_brightness_changes_at_borders() -> None:
    looks = _likeness(_module(0.05))
    assert min(looks.own) > 0.5
    assert looks.ends == (0, 0)


@pytest.mark.parametrize("beside", [-0.375, -0.125, 0.125, 0.375])
def test_a_grid_on_busbars_says_where_cells_end(beside: float) -> None:
    image = _module(0.05)
    looks = _likeness(image, (0, beside))
    assert looks.own[0] > 0.5
    assert looks.own[1] < -0.5
    assert looks.ends[0] == 0
    assert looks.ends[1] == pytest.approx(-beside, abs=0.04)
    assert looks.score < _likeness(image).score - 1


def test_meshes_of_two_by_two_cells_are_less_like_cells() -> None:
    image = _module(0.05)
    assert min(_likeness(image, side=2.0).own) < 0.35
    assert _likeness(image, side=2.0).score < _likeness(image).score


def test_cells_of_the_same_brightness_do_not_say_where_they_end() -> None:
    looks = _likeness(_module(0.0), (0, 0.125))
    assert looks.own == pytest.approx((0, 0), abs=0.2)


def test_too_few_cells_say_nothing() -> None:
    image = np.ones((CELL_PX + 8, CELL_PX + 8), np.float32)
    pose = Pose(Camera(np.eye(3), 0.0), np.diag([CELL_PX, CELL_PX, 1.0]))
    assert cell_likeness(image, np.ones(image.shape, bool), pose, PLANE) is None
