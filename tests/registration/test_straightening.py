from __future__ import annotations

import cv2
import numpy as np
import pytest

from pv_inspect.detection.edges import cell_edges
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose
from pv_inspect.registration.straightening import _basis, sharpened, shown_points, straighten

LAYOUT = ModuleLayout(5, 7)
CAMERA = Camera(np.array([[600.0, 0, 322], [0, 600, 250], [0, 0, 1]]), -0.2)
SHAPE = (500, 645)
SCALE = 60.0
FINER = 4


def _poses() -> np.ndarray:
    """Return three slightly different views, about 60 LR px per cell."""
    poses = []
    for tilt in (0.05, 0.08, 0.11):
        rotation, _ = cv2.Rodrigues(np.array([tilt, -0.1, 0.02]))
        poses.append(np.column_stack([rotation[:, 0], rotation[:, 1], [-3.4, -2.6, 10.0]]))
    return np.array(poses)


def _drawn(grid: HrGrid, appears_at: np.ndarray, gap: float = 0.02) -> np.ndarray:
    """Draw cells of unequal brightness, blurred; `appears_at` is what each pixel's centre shows.

    Every pixel is the mean of FINER x FINER samples, whose places lie between those of the centres.
    """
    places = appears_at.astype(np.float32)
    x, y = cv2.split(cv2.resize(places, None, fx=FINER, fy=FINER, interpolation=cv2.INTER_LINEAR))
    inside = (x > 0) & (x < 7) & (y > 0) & (y < 5)
    levels = np.random.default_rng(2).uniform(0.4, 0.8, (5, 7)).astype(np.float32)
    cells = levels[np.clip(y, 0, 4).astype(int), np.clip(x, 0, 6).astype(int)]
    dark = np.minimum(np.abs(x - np.round(x)), np.abs(y - np.round(y))) < gap / 2
    image = np.where(inside & ~dark, cells, np.float32(0.05))
    pixels = cv2.resize(image, grid.shape[::-1], interpolation=cv2.INTER_AREA)
    return cv2.GaussianBlur(pixels, (0, 0), 0.55 * grid.magnification)


def _pixel_points(grid: HrGrid) -> np.ndarray:
    """Module coordinates of the centres of all pixels."""
    rows, cols = np.mgrid[: grid.shape[0], : grid.shape[1]]
    return grid.to_module(np.stack([cols, rows], axis=-1))


def test_a_common_bend_and_a_wrong_kappa_are_found_from_the_gaps() -> None:
    poses = _poses()
    wrong = Camera(CAMERA.K + np.array([[0, 0, 0.8], [0, 0, -0.6], [0, 0, 0]]), -0.17)
    grid = HrGrid.covering(LAYOUT, SCALE, 3.0)
    # What the wrong camera makes of the module, seen by the middle frame.
    points = _pixel_points(grid)
    pixels = wrong.project(poses[1], points.reshape(-1, 2))
    truth = CAMERA.unproject(poses[1], pixels).reshape(*points.shape)
    result = straighten(_drawn(grid, truth), grid, wrong, poses, SHAPE, 0.1)
    assert result is not None
    camera, fitted = result.camera, result.homographies
    crossings = LAYOUT.crossings()
    before = wrong.project(poses[1], crossings) - CAMERA.project(poses[1], crossings)
    after = camera.project(fitted[1], crossings) - CAMERA.project(poses[1], crossings)
    assert np.sqrt((before**2).sum(axis=1).mean()) > 0.8
    assert np.sqrt((after**2).sum(axis=1).mean()) < 0.04
    assert camera.kappa == pytest.approx(-0.2, abs=0.003)


def test_what_a_frame_does_not_show_does_not_count() -> None:
    rotation, _ = cv2.Rodrigues(np.array([0.08, -0.1, 0.02]))
    true = Pose(CAMERA, np.column_stack([rotation[:, :2], [2.0, -2.6, 10.0]]))
    crossings = LAYOUT.crossings()
    shown = shown_points(true, crossings, SHAPE)
    assert shown.mean() < 0.7
    wrong = Pose(Camera(CAMERA.K, -0.17), true.homography)
    grid = HrGrid.covering(LAYOUT, SCALE, 3.0)
    points = _pixel_points(grid).reshape(-1, 2)
    seen = true.unproject(wrong.project(points)).reshape(*grid.shape, 2)
    module = _drawn(grid, np.nan_to_num(seen, nan=-1.0))
    module[~wrong.shows(points, SHAPE).reshape(grid.shape)] = 0
    result = straighten(module, grid, wrong.camera, wrong.homography[None], SHAPE, 0.1)
    assert result is not None
    off = result.camera.project(result.homographies[0], crossings) - true.project(crossings)
    assert np.sqrt((off[shown] ** 2).sum(axis=1).mean()) < 0.035


def test_a_camera_that_is_given_stays() -> None:
    poses = _poses()
    grid = HrGrid.covering(LAYOUT, SCALE, 3.0)
    shifted = _pixel_points(grid) - [0.01, -0.006]
    result = straighten(_drawn(grid, shifted), grid, CAMERA, poses, SHAPE, 0.0)
    assert result is not None
    camera, fitted = result.camera, result.homographies
    assert camera.kappa == pytest.approx(CAMERA.kappa, abs=1e-9)
    np.testing.assert_allclose(camera.K, CAMERA.K, atol=1e-6)
    moved = CAMERA.unproject(poses[0], camera.project(fitted[0], LAYOUT.crossings()))
    np.testing.assert_allclose(moved - LAYOUT.crossings(), [[0.01, -0.006]] * 48, atol=5e-4)


def test_gaps_a_little_wider_than_the_layout_has_them_are_measured_in_their_middle() -> None:
    grid = HrGrid.covering(LAYOUT, SCALE, 3.0)
    noise = np.random.default_rng(0).normal(0, 0.004, grid.shape).astype(np.float32)
    module = _drawn(grid, _pixel_points(grid), gap=0.05) + noise
    result = straighten(module, grid, CAMERA, _poses(), SHAPE, 0.004)
    assert result is not None
    camera, fitted = result.camera, result.homographies
    points = camera.project(fitted[1], LAYOUT.crossings())
    off = points - CAMERA.project(_poses()[1], LAYOUT.crossings())
    # With the usual shape 0.9 px.
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.02


def test_a_picture_without_gaps_changes_nothing() -> None:
    grid = HrGrid.covering(LAYOUT, SCALE, 2.0)
    flat = np.full(grid.shape, 0.5, np.float32)
    assert straighten(flat, grid, CAMERA, _poses(), SHAPE, 0.1) is None


def test_the_basis_is_the_derivative_of_what_a_pixel_shows() -> None:
    H = _poses()[:1]
    points = LAYOUT.crossings()
    edges = cell_edges(LAYOUT)
    basis = _basis(points, [Pose(CAMERA, H[0])], SHAPE, edges)
    pixels = CAMERA.project(H[0], points)
    for column, (step, change) in enumerate(
        [(1e-5, (0, 0)), (1e-3, (0, 2)), (1e-3, (1, 2))], start=8
    ):
        K = CAMERA.K.copy()
        if column > 8:
            K[change] += step
        other = Camera(K, CAMERA.kappa + (step if column == 8 else 0.0))
        numeric = (other.unproject(H[0], pixels) - points) / step
        np.testing.assert_allclose(basis[:, :, column], numeric, rtol=2e-3, atol=1e-5)


def test_sharpening_takes_the_blur_out_and_moves_nothing() -> None:
    rng = np.random.default_rng(0)
    smooth = cv2.GaussianBlur(rng.normal(0.5, 1, (120, 150)).astype(np.float32), (0, 0), 3.0)
    blurred = cv2.GaussianBlur(smooth, (0, 0), 1.5)
    inside = np.s_[20:-20, 20:-20]
    before = np.abs(blurred - smooth)[inside].max()
    after = np.abs(sharpened(blurred, 1.5) - smooth)[inside].max()
    assert after < 0.25 * before
