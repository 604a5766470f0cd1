from __future__ import annotations

import numpy as np
import pytest

from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.reconstruction.single_frame import best_frame
from pv_inspect.registration.registration import Registration

SHAPE = (100, 120)
LAYOUT = ModuleLayout(2, 3)


def registration(*views: tuple[float, float, float]) -> Registration:
    """Frames that see the module straight: scale (px per cell), x and y of its corner (px)."""
    n = len(views)
    camera = Camera(np.diag([100.0, 100.0, 1.0]), 0.0)
    homographies = np.array(
        [[[s / 100, 0, x / 100], [0, s / 100, y / 100], [0, 0, 1]] for s, x, y in views]
    )
    ones = np.ones(n)
    return Registration(
        LAYOUT, camera, homographies, np.ones(n, bool), ("",) * n, ones, 0 * ones, ones
    )


def test_the_best_frame_shows_the_cell_largest() -> None:
    poses = registration((20, 5, 5), (30, 5, 5), (25, 5, 5))
    assert best_frame(poses, SHAPE, (0, 0)) == 1


def test_a_frame_that_cuts_the_cell_is_never_the_best() -> None:
    """The largest frame shows the first cell whole and the last one not."""
    poses = registration((20, 5, 5), (45, 5, 5))
    assert best_frame(poses, SHAPE, (0, 0)) == 1
    assert best_frame(poses, SHAPE, (1, 2)) == 0
    assert best_frame(registration((45, 5, 5)), SHAPE, (1, 2)) is None


def test_motion_counts_as_pixels_that_are_larger() -> None:
    poses = registration((30, 5, 5), (25, 5, 5))
    assert best_frame(poses, SHAPE, (0, 0), [(0.0, 0.0), (0.0, 0.0)]) == 0
    assert best_frame(poses, SHAPE, (0, 0), [(6.0, 30.0), (0.0, 0.0)]) == 1


@pytest.mark.parametrize("used", [[False, True], [True, False]])
def test_frames_that_are_left_out_do_not_count(used: list[bool]) -> None:
    poses = registration((30, 5, 5), (25, 5, 5))
    chosen = Registration(**{**vars(poses), "used": np.array(used)})
    assert best_frame(chosen, SHAPE, (0, 0)) == used.index(True)
