"""W against closed forms: adjointness, positions, moments, and the normal equations."""

from __future__ import annotations

import numpy as np
import pytest

from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.observation.model import ObservationModel
from pv_inspect.observation.normal_equations import NormalEquations
from pv_inspect.observation.psf import Blur, footprint_variance_lr_px2, kernel_of_variance

SHAPE = (72, 96)
CAMERA = Camera(np.array([[200.0, 0, 48.3], [0, 200.0, 35.1], [0, 0, 1]]), -0.2)
SIGMA = 0.45


def pose(shift: float = 0.0, tilt: float = 0.15, roll: float = 0.1) -> np.ndarray:
    """A module of 3 x 2 cells that nearly fills the frame."""
    c, s = np.cos(roll), np.sin(roll)
    rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    H = np.array([[1.0, 0, -1.5 + shift], [0, 1.0, -1.0 - shift], [tilt, 0.5 * tilt, 8.0]])
    return rotation @ H


def model_of(magnification: float = 3.0, sigma: float = SIGMA) -> ObservationModel:
    grid = HrGrid.covering(ModuleLayout(2, 3), 25.0, magnification)
    rays = SensorRays.of(CAMERA, SHAPE)
    return ObservationModel.build(rays, CAMERA, np.array([pose()]), grid, sigma)


@pytest.mark.parametrize(("dtype", "bound"), [(np.float32, 1e-6), (np.float64, 1e-12)])
def test_adjoint_satisfies_the_dot_test(dtype: type, bound: float) -> None:
    model = model_of()
    W = model.frame(pose())
    rng = np.random.default_rng(1)
    # Positive images: <Wx, y> is then no small difference of large numbers.
    x = rng.uniform(0.5, 1.5, model.grid.shape).astype(dtype)
    y = rng.uniform(0.5, 1.5, SHAPE).astype(dtype)
    left = np.vdot(W.forward(x).astype(np.float64), y.astype(np.float64))
    right = np.vdot(x.astype(np.float64), W.adjoint(y).astype(np.float64))
    assert W.forward(x).dtype == dtype
    assert left == pytest.approx(right, rel=bound)


def test_a_ramp_keeps_its_value_at_the_position_of_every_lr_pixel() -> None:
    model = model_of()
    W = model.frame(pose())
    y, x = np.mgrid[: model.grid.shape[0], : model.grid.shape[1]].astype(np.float64)
    frame = W.forward(0.3 * x - 0.7 * y)
    rows, cols = np.nonzero(W.inside)
    assert rows.size > 2000
    px = np.column_stack([cols, rows]).astype(np.float64)
    at = model.grid.to_pixels(CAMERA.unproject(pose(), px))
    np.testing.assert_allclose(frame[rows, cols], 0.3 * at[:, 0] - 0.7 * at[:, 1], atol=1e-9)


def test_positions_are_those_of_the_camera() -> None:
    model = model_of()
    W = model.frame(pose())
    at = W.positions()[30, 40]
    back = CAMERA.project(pose(), model.grid.to_module(at)[None])[0]
    np.testing.assert_allclose(back, [40.0, 30.0], atol=1e-9)


def test_a_single_bright_point_has_the_position_and_the_moments_of_the_psf() -> None:
    H = np.array([[1.0, 0, -1.5], [0, 1.0, -1.0], [0, 0, 8.0]])
    camera = Camera(CAMERA.K, 0.0)
    grid = HrGrid.covering(ModuleLayout(2, 3), 25.0, 4.0)
    model = ObservationModel.build(SensorRays.of(camera, SHAPE), camera, H[None], grid, SIGMA)
    moments = []
    # One frame samples a point at a few places only: the mean over sub-pixel shifts sees it all.
    for row in range(100, 104):
        for col in range(140, 144):
            point = np.zeros(grid.shape)
            point[row, col] = 1.0
            frame = model.frame(H).forward(point)
            y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
            place = camera.project(H, grid.to_module(np.array([[col, row]], dtype=np.float64)))[0]
            w = frame.ravel()
            dx, dy = x.ravel() - place[0], y.ravel() - place[1]
            moments.append([w.sum(), w @ dx, w @ dy, w @ dx**2, w @ dy**2, w @ (dx * dy)])
    total, mx, my, vx, vy, vxy = np.mean(moments, axis=0)
    assert total == pytest.approx(1.0 / 16.0, rel=1e-6)
    assert abs(mx) / total < 1e-6
    assert abs(my) / total < 1e-6
    # An HR pixel stands for its area: 1/12 HR px^2 of the footprint is in its value already.
    expected = footprint_variance_lr_px2(SIGMA) - 1.0 / 12.0 / 16.0
    assert vx / total == pytest.approx(expected, rel=1e-6)
    assert vy / total == pytest.approx(expected, rel=1e-6)
    assert abs(vxy) / total < 1e-6


def test_pixels_beyond_the_fold_and_off_the_module_see_nothing() -> None:
    camera = Camera(CAMERA.K, -0.9)
    rays = SensorRays.of(Camera(np.array([[40.0, 0, 48], [0, 40.0, 36], [0, 0, 1]]), -0.9), SHAPE)
    assert np.isnan(rays.xy).any()
    grid = HrGrid.covering(ModuleLayout(2, 3), 25.0, 2.0)
    model = ObservationModel.build(rays, camera, np.array([pose()]), grid, SIGMA)
    frame = model.frame(pose()).forward(np.ones(grid.shape))
    assert np.isfinite(frame).all()
    assert (frame[np.isnan(rays.xy[..., 0])] == 0).all()


def test_normal_equations_are_the_sum_of_the_frame_operators() -> None:
    model = model_of()
    rng = np.random.default_rng(2)
    x = rng.normal(size=model.grid.shape)
    equations = NormalEquations.empty(model, np.float64)
    applied, side = np.zeros_like(x), np.zeros_like(x)
    for shift in (0.0, 0.011, 0.033):
        H, g = pose(shift), rng.normal(size=SHAPE)
        weights = rng.uniform(0.0, 2.0, SHAPE) * (rng.random(SHAPE) > 0.1)
        equations.add(H, g, weights)
        W = model.frame(H)
        applied += W.adjoint(weights * W.forward(x))
        side += W.adjoint(weights * g)
    np.testing.assert_allclose(equations.apply(x), applied, rtol=0, atol=1e-10)
    np.testing.assert_allclose(equations.right_hand_side, side, rtol=0, atol=1e-10)


def test_normal_operator_is_symmetric_and_positive() -> None:
    model = model_of()
    equations = NormalEquations.empty(model)
    weights = np.ones(SHAPE, np.float32)
    equations.add(pose(), weights, weights)
    rng = np.random.default_rng(3)
    a, b = rng.uniform(0.5, 1.5, (2, *model.grid.shape)).astype(np.float32)
    ab = np.vdot(equations.apply(a).astype(np.float64), b.astype(np.float64))
    ba = np.vdot(equations.apply(b).astype(np.float64), a.astype(np.float64))
    assert ab == pytest.approx(ba, rel=1e-6)
    assert np.vdot(equations.apply(a), a) > 0
    assert equations.diagonal.min() >= 0


def test_the_order_of_frames_does_not_matter() -> None:
    model = model_of()
    rng = np.random.default_rng(4)
    frames = [(pose(s), rng.normal(size=SHAPE), np.ones(SHAPE)) for s in (0.0, 0.01, 0.02)]
    forward, backward = (NormalEquations.empty(model, np.float64) for _ in range(2))
    for frame in frames:
        forward.add(*frame)
    for frame in reversed(frames):
        backward.add(*frame)
    np.testing.assert_allclose(forward.stencil.planes, backward.stencil.planes, atol=1e-12)
    assert forward.n_pixels == backward.n_pixels
    assert forward.energy == pytest.approx(backward.energy, rel=1e-12)


@pytest.mark.parametrize("variance", [0.0, 0.05, 0.3, 0.7, 2.0, 3.8, 12.0])
@pytest.mark.parametrize("box", [1.0, 2.6, 4.0])
def test_kernels_are_symmetric_with_exact_moments(variance: float, box: float) -> None:
    kernel = kernel_of_variance(variance, box)
    n = np.arange(len(kernel)) - len(kernel) // 2
    assert len(kernel) % 2 == 1
    np.testing.assert_array_equal(kernel, kernel[::-1])
    assert kernel.sum() == pytest.approx(1.0, abs=1e-12)
    assert (kernel * n**2).sum() == pytest.approx(variance, abs=1e-9)


def test_blur_keeps_a_constant_and_is_its_own_adjoint_at_the_border() -> None:
    blur = Blur(kernel_of_variance(3.0, 4.0), kernel_of_variance(2.0, 3.0))
    np.testing.assert_allclose(blur.apply(np.full((12, 9), 2.0)), 2.0, atol=1e-12)
    rng = np.random.default_rng(5)
    a, b = rng.normal(size=(2, 12, 9))
    assert np.vdot(blur.apply(a), b) == pytest.approx(np.vdot(a, blur.apply(b)), rel=1e-11)


@pytest.mark.parametrize("kappa", [-0.9, -0.1, 0.0, 0.2])
def test_rays_of_a_part_of_the_sensor_are_those_of_the_whole(kappa: float) -> None:
    camera = Camera(np.array([[60.0, 0.4, 48], [0, 62.0, 36], [0, 0, 1]]), kappa)
    window = (slice(7, 33), slice(0, 41))
    part, whole = SensorRays.of(camera, SHAPE, window), SensorRays.of(camera, SHAPE).cut(window)
    np.testing.assert_allclose(part.xy, whole.xy, rtol=1e-14, atol=0)
    np.testing.assert_allclose(part.per_px, whole.per_px, rtol=1e-12, atol=0)


def test_rays_change_from_pixel_to_pixel_as_they_say() -> None:
    camera = Camera(np.array([[60.0, 0.4, 48], [0, 62.0, 36], [0, 0, 1]]), -0.1)
    rays = SensorRays.of(camera, SHAPE)
    across = (rays.xy[1:-1, 2:] - rays.xy[1:-1, :-2]) / 2
    down = (rays.xy[2:, 1:-1] - rays.xy[:-2, 1:-1]) / 2
    numerical = np.stack([across, down], axis=-1)
    np.testing.assert_allclose(numerical, rays.per_px[1:-1, 1:-1], atol=2e-5)
