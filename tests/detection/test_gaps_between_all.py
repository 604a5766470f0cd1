from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pv_inspect.detection.gaps_between_all import cell_gap_if_wide, seen_cell_gap
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose
from pv_inspect.simulate import SimulationSettings, simulated
from pv_inspect.simulate.exposure import camera_matrix

SEARCH = 0.04


@cache
def _seen(gap: float) -> tuple[NDArray[np.float32], Pose]:
    settings = SimulationSettings(
        rows=3, cols=4, cell_gap=gap, n_frames=1, width=320, height=256, seed=4,
        pixels_per_unit=100, supersampling=3, dark_cell_share=0.0,
    )  # fmt: skip
    made = simulated(settings)
    pose = Pose(Camera(camera_matrix(settings), settings.kappa), made.poses[0].H)
    return (made.frames[0].astype(np.float32) - 64) / 4031, pose


def _layout(gap: float) -> ModuleLayout:
    return ModuleLayout(3, 4, cell_gap=(gap, gap))


@pytest.mark.parametrize("off", [0.0, 0.03, -0.03])
def test_the_gap_is_seen_where_the_grid_lies_a_little_off(off: float) -> None:
    frame, pose = _seen(0.09)
    moved = Pose(pose.camera, pose.homography @ np.array([[1, 0, off], [0, 1, off], [0, 0, 1]]))
    seen = seen_cell_gap(frame, _layout(0.0), moved, SEARCH)
    assert seen == pytest.approx((0.09, 0.09), abs=0.012)


@pytest.mark.parametrize("off", [0.0, 0.02])
@pytest.mark.parametrize("blurred_px", [0.0, 1.2])
def test_only_gaps_that_are_wider_than_blur_makes_them_are_wide(
    off: float, blurred_px: float
) -> None:
    for gap in (0.0, 0.09):
        frame, pose = _seen(gap)
        frame = cv2.GaussianBlur(frame, (0, 0), blurred_px) if blurred_px else frame
        moved = Pose(pose.camera, pose.homography @ np.array([[1, 0, off], [0, 1, off], [0, 0, 1]]))
        seen = cell_gap_if_wide(frame, _layout(0.0), moved, SEARCH)
        assert seen == pytest.approx((gap, gap), abs=0.012)
