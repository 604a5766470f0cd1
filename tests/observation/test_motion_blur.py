"""Motion blur in W against closed forms: adjointness, moments, and the normal equations."""

from __future__ import annotations

import numpy as np
import pytest

from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.observation.model import ObservationModel
from pv_inspect.observation.motion_blur import (
    STILL,
    detail_left,
    length_and_angle,
    motion_of,
    samples_of,
)
from pv_inspect.observation.normal_equations import NormalEquations
from pv_inspect.observation.psf import footprint_variance_lr_px2

SHAPE = (72, 96)
CAMERA = Camera(np.array([[200.0, 0, 48.3], [0, 200.0, 35.1], [0, 0, 1]]), -0.2)
SIGMA = 0.45
MOTION = motion_of(4.2, 33.0)


def pose(shift: float = 0.0, tilt: float = 0.15) -> np.ndarray:
    """A module of 3 x 2 cells that nearly fills the frame, rolled a little."""
    c, s = np.cos(0.1), np.sin(0.1)
    rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    return rotation @ np.array(
        [[1.0, 0, -1.5 + shift], [0, 1.0, -1.0 - shift], [tilt, 0.5 * tilt, 8.0]]
    )


def model_of(magnification: float = 4.0, camera: Camera = CAMERA) -> ObservationModel:
    grid = HrGrid.covering(ModuleLayout(2, 3), 25.0, magnification)
    rays = SensorRays.of(camera, SHAPE)
    return ObservationModel.build(rays, camera, np.array([pose()]), grid, SIGMA)


@pytest.mark.parametrize(("dtype", "bound"), [(np.float32, 1e-6), (np.float64, 1e-12)])
def test_adjoint_satisfies_the_dot_test(dtype: type, bound: float) -> None:
    model = model_of()
    W = model.frame(pose(), MOTION)
    rng = np.random.default_rng(1)
    x = rng.uniform(0.5, 1.5, model.grid.shape).astype(dtype)
    y = rng.uniform(0.5, 1.5, SHAPE).astype(dtype)
    left = np.vdot(W.forward(x).astype(np.float64), y.astype(np.float64))
    right = np.vdot(x.astype(np.float64), W.adjoint(y).astype(np.float64))
    assert left == pytest.approx(right, rel=bound)


def test_a_constant_stays_and_a_ramp_keeps_its_value_in_the_middle_of_the_path() -> None:
    model = model_of()
    W = model.frame(pose(), MOTION)
    np.testing.assert_allclose(W.forward(np.ones(model.grid.shape))[W.inside], 1.0, atol=1e-12)
    y, x = np.mgrid[: model.grid.shape[0], : model.grid.shape[1]].astype(np.float64)
    frame = W.forward(0.3 * x - 0.7 * y)
    rows, cols = np.nonzero(W.inside)
    assert rows.size > 1500
    px = np.column_stack([cols, rows]).astype(np.float64)
    at = model.grid.to_pixels(CAMERA.unproject(pose(), px))
    np.testing.assert_allclose(frame[rows, cols], 0.3 * at[:, 0] - 0.7 * at[:, 1], atol=1e-9)


@pytest.mark.parametrize("length", [0.7, 2.0, 4.2, 7.0])
@pytest.mark.parametrize("angle", [0.0, 33.0, 90.0, 140.0])
def test_the_psf_has_the_second_moments_of_optics_pixel_and_path(
    length: float, angle: float
) -> None:
    H = np.array([[1.0, 0, -1.5], [0, 1.0, -1.0], [0, 0, 8.0]])
    camera = Camera(CAMERA.K, 0.0)
    grid = HrGrid.covering(ModuleLayout(2, 3), 25.0, 4.0)
    model = ObservationModel.build(SensorRays.of(camera, SHAPE), camera, H[None], grid, SIGMA)
    path = motion_of(length, angle)
    y, x = np.mgrid[: grid.shape[0], : grid.shape[1]].astype(np.float64)
    W = model.frame(H, path)
    row, col = 36, 48
    assert W.inside[row, col]
    x0, y0 = W.positions()[row, col]
    x, y = x - x0, y - y0
    still = 16.0 * footprint_variance_lr_px2(SIGMA) - 1.0 / 12.0
    moved = 16.0 * np.outer(path, path) / 12.0
    found = [W.forward(f)[row, col] for f in (x * x, y * y, x * y)]
    expected = [still + moved[0, 0], still + moved[1, 1], moved[0, 1]]
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_normal_equations_hold_still_and_moving_frames() -> None:
    model = model_of(3.0)
    rng = np.random.default_rng(2)
    x = rng.normal(size=model.grid.shape)
    equations = NormalEquations.empty(model, np.float64)
    applied, side, cover, energy = np.zeros_like(x), np.zeros_like(x), np.zeros_like(x), 0.0
    for shift, motion in ((0.0, STILL), (0.011, MOTION), (0.02, motion_of(0.5, 80.0))):
        H, g = pose(shift), rng.normal(size=SHAPE)
        weights = rng.uniform(0.0, 2.0, SHAPE) * (rng.random(SHAPE) > 0.1)
        equations.add(H, g, weights, motion)
        W = model.frame(H, motion)
        applied += W.adjoint(weights * W.forward(x))
        side += W.adjoint(weights * g)
        cover += W.adjoint(weights)
        energy += float((weights * g**2)[W.inside].sum())
    assert len(equations.moving) == 1
    np.testing.assert_allclose(equations.apply(x), applied, rtol=0, atol=1e-10)
    np.testing.assert_allclose(equations.right_hand_side, side, rtol=0, atol=1e-10)
    np.testing.assert_allclose(model.blur.apply(equations.coverage), cover, rtol=0, atol=1e-10)
    assert equations.energy == pytest.approx(energy, rel=1e-9)


def test_the_normal_operator_of_moving_frames_is_symmetric_and_its_diagonal_near() -> None:
    model = model_of()
    equations = NormalEquations.empty(model)
    weights = np.ones(SHAPE, np.float32)
    rng = np.random.default_rng(3)
    for angle in np.arange(0.0, 180.0, 22.5):
        equations.add(pose(rng.uniform(-0.03, 0.03)), weights, weights, motion_of(3.5, angle))
    a, b = rng.uniform(0.5, 1.5, (2, *model.grid.shape)).astype(np.float32)
    ab = np.vdot(equations.apply(a).astype(np.float64), b.astype(np.float64))
    ba = np.vdot(equations.apply(b).astype(np.float64), a.astype(np.float64))
    assert ab == pytest.approx(ba, rel=1e-6)
    assert np.vdot(equations.apply(a), a) > 0
    diagonal = equations.diagonal
    assert diagonal.min() >= 0
    ratios = []
    for y, x in ((95, 120), (101, 163), (133, 207)):
        unit = np.zeros(model.grid.shape, np.float32)
        unit[y, x] = 1.0
        ratios.append(diagonal[y, x] / equations.apply(unit)[y, x])
    assert min(ratios) > 0.5
    assert max(ratios) < 3.0


def test_the_same_sums_come_out_twice() -> None:
    model = model_of(3.0)
    rng = np.random.default_rng(4)
    g, weights = rng.random((2, *SHAPE)).astype(np.float32)
    x = rng.random(model.grid.shape).astype(np.float32)
    results = []
    for _ in range(2):
        equations = NormalEquations.empty(model)
        equations.add(pose(), g, weights, MOTION)
        results.append((equations.apply(x), equations.right_hand_side))
    np.testing.assert_array_equal(results[0], results[1])


def test_a_motion_is_said_by_length_and_angle_without_a_sign() -> None:
    assert length_and_angle(motion_of(2.5, 70.0)) == pytest.approx((2.5, 70.0))
    assert length_and_angle(-motion_of(2.5, 70.0)) == pytest.approx((2.5, 70.0))
    assert length_and_angle(STILL) == (0.0, 0.0)


def test_short_motions_stay_in_the_stencil_and_long_ones_take_more_samples() -> None:
    assert samples_of(STILL, 4.0) == 1
    assert samples_of(motion_of(0.9, 10.0), 4.0) == 1
    assert samples_of(motion_of(4.5, 10.0), 4.0) == 4
    assert samples_of(motion_of(4.5, 10.0), 1.0) == 4


def test_motion_leaves_less_detail_the_longer_it_is() -> None:
    assert detail_left(np.zeros((3, 2))) == pytest.approx(1.0)
    shares = [detail_left(motion_of(length, 20.0)[None]) for length in (0.5, 1.5, 3.0, 5.0)]
    assert shares == sorted(shares, reverse=True)
    assert shares[-1] > 0
