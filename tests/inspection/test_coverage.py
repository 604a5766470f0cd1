"""Cells that no frame shows are named, and put the result in doubt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.inspection.coverage import unseen_sentence
from pv_inspect.registration.registration import Registration

CAMERA = Camera(np.array([[100.0, 0, 0], [0, 100.0, 0], [0, 0, 1]]), 0.0)
LAYOUT = ModuleLayout(2, 4)


def _frames(*lefts: float, used: tuple[bool, ...]) -> Registration:
    """Frames of 260 x 200 px, 100 px per cell, that begin so many cells right of the module's."""
    n = len(lefts)
    homographies = np.array([[[1.0, 0, -x], [0, 1, 0], [0, 0, 1]] for x in lefts])
    return Registration(
        LAYOUT, CAMERA, homographies, np.array(used), ("",) * n, np.ones(n), np.zeros(n), np.ones(n)
    )


def test_frames_that_together_show_all_leave_nothing_out() -> None:
    assert unseen_sentence(_frames(0.0, 1.45, used=(True, True)), (201, 260)) == ""


def test_cells_that_no_frame_in_use_shows_are_named() -> None:
    said = unseen_sentence(_frames(0.0, 1.45, used=(True, False)), (201, 260))
    assert said.startswith("4 cells are in no frame")
    assert "row 1, column 3, row 1, column 4, row 2, column 3 and 1 more" in said


def test_a_module_that_runs_a_little_over_the_edge_is_seen() -> None:
    assert unseen_sentence(_frames(0.05, 1.45, used=(True, True)), (197, 260)) == ""


def test_a_missing_corner_of_a_cell_is_named() -> None:
    frames = _frames(0.0, 0.0, used=(True, True))
    turned = frames.homographies.copy()
    turned[:, 0, 1] = [0.0, 0.06]
    one = replace(frames, homographies=turned[1:], used=np.array([True]), why=("",))
    assert unseen_sentence(one, (201, 401)).startswith("1 cell is in no frame")
    both = replace(frames, homographies=turned)
    assert unseen_sentence(both, (201, 401)) == ""
