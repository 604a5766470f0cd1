from __future__ import annotations

import cv2
import numpy as np
import pytest

from pv_inspect.detection.outline import (
    OutlineError,
    conventional_camera,
    find_outline,
    find_outlines,
    fit_pose,
    solver_errors_as_reasons,
)
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose

SHAPE = (216, 288)
LAYOUT = ModuleLayout(4, 6)


def _bright_rectangle(kappa: float) -> tuple[np.ndarray, Pose]:
    """Draw a module without gaps through a known camera, 4 x 4 samples per pixel."""
    camera = Camera(conventional_camera(SHAPE).K, kappa)
    tilt, _ = cv2.Rodrigues(np.array([0.15, -0.2, 0.1]))
    H = np.column_stack([tilt[:, 0], tilt[:, 1], [-2.9, -1.9, 7.2]])
    pose = Pose(camera, H)
    rows, cols = np.mgrid[0 : SHAPE[0] * 4, 0 : SHAPE[1] * 4]
    pixels = np.stack([cols, rows], -1).reshape(-1, 2) / 4 - 0.375
    points = pose.unproject(pixels)
    inside = np.all((points > 0) & (points < LAYOUT.size), axis=1)
    image = inside.reshape(SHAPE[0], 4, SHAPE[1], 4).mean(axis=(1, 3)) * 0.5 + 0.02
    noise = np.random.default_rng(1).normal(0, 0.01, SHAPE)
    return (image + noise).astype(np.float32), pose


@pytest.mark.parametrize("kappa", [-0.3, 0.0, 0.15])
def test_the_outline_gives_pose_and_distortion_to_half_a_pixel(kappa: float) -> None:
    image, truth = _bright_rectangle(kappa)
    outline = find_outline(image)
    pose, distance = fit_pose(outline, LAYOUT, SHAPE, 0)
    error = pose.project(LAYOUT.crossings()) - truth.project(LAYOUT.crossings())
    assert not outline.cut
    assert distance < 0.6
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.6
    assert abs(pose.camera.kappa - kappa) < 0.03


def test_quarter_turns_turn_the_module_without_mirroring_it() -> None:
    image, truth = _bright_rectangle(0.0)
    outline = find_outline(image)
    pose, _ = fit_pose(outline, LAYOUT, SHAPE, 2)
    turned = truth.project(LAYOUT.crossings())[::-1]
    assert np.abs(pose.project(LAYOUT.crossings()) - turned).max() < 2


def test_frames_without_a_module_say_why() -> None:
    noise = np.random.default_rng(0).normal(0.02, 0.005, SHAPE).astype(np.float32)
    with pytest.raises(OutlineError, match="black"):
        find_outline(noise)
    with pytest.raises(OutlineError, match="saturated"):
        find_outline(np.ones(SHAPE, np.float32))
    spot = noise.copy()
    spot[100:108, 100:108] = 0.5
    with pytest.raises(OutlineError, match=r"black|no module"):
        find_outline(spot)
    module = np.full(SHAPE, 0.5, np.float32)
    module[100:104] = 0.02
    module[:, 140:144] = 0.02
    with pytest.raises(OutlineError, match="fills the frame"):
        find_outline(module)


def test_a_module_cut_by_the_border_is_noticed() -> None:
    image, _ = _bright_rectangle(0.0)
    assert find_outline(np.ascontiguousarray(image[:, 60:])).cut


def _string_of_three(gap: int) -> np.ndarray:
    """Draw three modules below each other; the frame cuts the upper and the lower one."""
    image = np.full((320, 300), 0.02, np.float32)
    for top in (-110, 60 + gap, 230 + 2 * gap):
        image[max(top, 0) : top + 170, 40:260] = 0.5
    return image


@pytest.mark.parametrize("gap", [5, 7, 12])
def test_modules_of_one_string_are_told_apart_and_the_complete_one_comes_first(gap: int) -> None:
    outline = find_outline(_string_of_three(gap))
    assert not outline.cut
    corners = [[40, 60 + gap], [259, 60 + gap], [259, 229 + gap], [40, 229 + gap]]
    assert np.abs(outline.corners_px - corners).max() < 3


def test_a_point_inside_chooses_the_module() -> None:
    image = np.full((240, 400), 0.02, np.float32)
    image[40:200, 20:180] = image[40:200, 220:380] = 0.5
    for x in (100, 300):
        centre = next(find_outlines(image, (x, 120))).corners_px.mean(axis=0)
        assert np.abs(centre - [x, 120]).max() < 2


@pytest.mark.parametrize("turns", range(4))
def test_a_turned_pose_begins_at_another_corner_of_the_same_rectangle(turns: int) -> None:
    image, _ = _bright_rectangle(0.0)
    pose, _ = fit_pose(find_outline(image), LAYOUT, SHAPE, 0)
    width, height = LAYOUT.size
    new_size = (height, width) if turns % 2 else (width, height)
    turned = pose.turned(LAYOUT.size, new_size, turns)

    def corners(which: Pose, size: tuple[float, float]) -> np.ndarray:
        return which.project(np.array([[0, 0], [size[0], 0], size, [0, size[1]]]))

    expected = np.roll(corners(pose, LAYOUT.size), -turns, axis=0)
    np.testing.assert_allclose(corners(turned, new_size), expected, atol=1e-6)


def test_the_perspective_tells_the_aspect_of_the_module() -> None:
    image, _ = _bright_rectangle(0.1)
    square = ModuleLayout(1, 1)
    pose, _ = fit_pose(find_outline(image), square, SHAPE, 0)
    assert pose.aspect == pytest.approx(6 / 4, rel=0.03)


def test_an_error_of_a_solver_is_a_reason_of_the_frame() -> None:
    with pytest.raises(OutlineError, match="no pose"), solver_errors_as_reasons():
        np.linalg.inv(np.zeros((3, 3)))
