from __future__ import annotations

import sys
from collections.abc import Callable
from types import FrameType

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pv_inspect.errors import InspectionError
from pv_inspect.geometry.camera import Camera

EPS = np.finfo(float).eps
K = np.array([[820.0, 0.0, 313.5], [0.0, 815.0, 260.5], [0.0, 0.0, 1.0]])
H = np.array([[0.0659, 0.0073, -0.366], [-0.0054, 0.0651, -0.1387], [-0.00945, 0.01337, 1.037]])
KAPPAS = [s * k for k in (1e-9, 1e-7, 1e-5, 1e-3, 0.02, 0.1, 0.3, 0.5) for s in (1.0, -1.0)]

kappas = st.floats(-0.5, 0.5, allow_nan=False)
coordinates = st.floats(-0.7, 0.7, allow_nan=False)


def module_points(n: int = 200) -> np.ndarray:
    rng = np.random.default_rng(1)
    return rng.uniform([-0.2, -0.2], [10.2, 6.2], (n, 2))


def exact_undistorted_radius(r_d: float, kappa: float) -> mpmath.mpf:
    """Root of kappa r^3 + r - r_d on the branch through 0, by Newton in 60 digits."""
    with mpmath.workdps(60):
        k, target = mpmath.mpf(kappa), mpmath.mpf(r_d)
        if k < 0:
            fold = mpmath.sqrt(-1 / (3 * k))
            low, high = mpmath.mpf(0), fold
        else:
            low, high = mpmath.mpf(0), target
        for _ in range(190):
            middle = (low + high) / 2
            if middle + k * middle**3 < target:
                low = middle
            else:
                high = middle
        return (low + high) / 2


@pytest.mark.parametrize("kappa", KAPPAS)
def test_undistort_agrees_with_60_digits_to_its_conditioning(kappa: float) -> None:
    camera = Camera(np.eye(3), kappa)
    fold = camera.fold_radius[1]
    largest = min(fold, 2.0)
    radii = np.concatenate([[1e-12, 1e-6], np.linspace(0.01, 0.999, 12) * largest])
    if largest == fold:
        radii = np.concatenate([radii, fold * (1 - np.array([1e-4, 1e-7, 1e-10, 1e-13]))])
    for r_d in radii:
        got = camera.undistort([r_d, 0.0])[0]
        exact = exact_undistorted_radius(r_d, kappa)
        # Rounding r_d by one ulp moves r_u by this much: no algorithm does better than a few.
        slope = abs(1 + 3 * kappa * float(exact) ** 2)
        tolerance = 4 * EPS * (float(exact) + r_d / slope)
        assert abs(float(mpmath.mpf(float(got)) - exact)) <= tolerance


def test_undistort_well_inside_the_fold_is_good_to_four_ulp() -> None:
    for kappa in KAPPAS:
        for r_d in np.linspace(1e-3, 0.5, 7):
            got = Camera(np.eye(3), kappa).undistort([0.0, r_d])[1]
            exact = exact_undistorted_radius(r_d, kappa)
            slope = abs(1 + 3 * kappa * float(exact) ** 2)
            assert abs(float(mpmath.mpf(float(got)) / exact - 1)) <= 4 * EPS / min(slope, 1.0)


@given(kappas, coordinates, coordinates)
def test_distort_after_undistort_is_the_identity(kappa: float, x: float, y: float) -> None:
    camera = Camera(np.eye(3), kappa)
    back = camera.distort(camera.undistort([x, y]))
    if np.hypot(x, y) <= camera.fold_radius[1] * (1 - 1e-12):
        np.testing.assert_allclose(back, [x, y], rtol=0, atol=1e-12)


@given(kappas, coordinates, coordinates)
def test_undistort_after_distort_is_the_identity_to_its_conditioning(
    kappa: float, x: float, y: float
) -> None:
    camera = Camera(np.eye(3), kappa)
    slope = 1 + 3 * kappa * (x * x + y * y)
    if slope > 1e-2:
        back = camera.undistort(camera.distort([x, y]))
        np.testing.assert_allclose(back, [x, y], rtol=0, atol=1e-13 / min(slope, 1.0))


@pytest.mark.parametrize("kappa", [-1e-9, -0.04, -0.3, -0.5])
def test_there_is_nothing_beyond_the_fold(kappa: float) -> None:
    camera = Camera(np.eye(3), kappa)
    r_u, r_d = camera.fold_radius
    assert r_d**2 == pytest.approx(-4 / (27 * kappa), rel=1e-14)
    assert np.isnan(camera.undistort([r_d * (1 + 1e-12), 0.0])).all()
    assert np.isnan(camera.distort([r_u * (1 + 1e-12), 0.0])).all()
    assert camera.undistort([r_d, 0.0])[0] == pytest.approx(r_u, rel=1e-7)
    assert camera.distort([r_u, 0.0])[0] == pytest.approx(r_d, rel=1e-14)


def test_undistorting_what_lies_on_the_fold_gives_no_nan() -> None:
    angles = np.linspace(0, 2 * np.pi, 400)
    for kappa in np.linspace(-0.5, -0.01, 30):
        camera = Camera(np.eye(3), kappa)
        fold = camera.fold_radius[0] * (1 - 1e-15)
        ring = fold * np.column_stack([np.cos(angles), np.sin(angles)])
        assert np.isfinite(camera.undistort(camera.distort(ring))).all()


def test_without_distortion_nothing_is_touched() -> None:
    points = module_points()
    camera = Camera(np.eye(3), 0.0)
    assert np.array_equal(camera.distort(points), points)
    assert np.array_equal(camera.undistort(points), points)


def test_the_centre_and_subnormal_kappa_are_harmless() -> None:
    for kappa in (5e-324, -5e-324, 0.3, -0.3):
        xy = Camera(np.eye(3), kappa).undistort([[0.0, 0.0], [1e-200, 0.0], [0.1, 0.0]])
        assert np.array_equal(xy[0], [0.0, 0.0])
        assert xy[1, 0] == 1e-200
        assert np.isfinite(xy[2]).all()


@given(st.floats(1e-6, 0.5), coordinates, coordinates)
def test_undistort_is_continuous_at_kappa_zero(kappa: float, x: float, y: float) -> None:
    r2 = x * x + y * y
    for sign in (1.0, -1.0):
        got = Camera(np.eye(3), 1e-6 * sign * kappa).undistort([x, y])
        first_order = np.array([x, y]) * (1 - 1e-6 * sign * kappa * r2)
        np.testing.assert_allclose(got, first_order, rtol=0, atol=1e-11)


def test_project_is_the_formula_of_the_paper() -> None:
    camera = Camera(K, -0.2)
    for point, px in zip(module_points(20), camera.project(H, module_points(20)), strict=True):
        y = H @ [*point, 1.0]
        y = y[:2] / y[2]
        r_u = np.hypot(*y)
        r_d = r_u - 0.2 * r_u**3
        expected = K @ [*(y * r_d / r_u), 1.0]
        np.testing.assert_allclose(px, expected[:2], rtol=0, atol=1e-11)


@pytest.mark.parametrize("kappa", [-0.3, -1e-9, 0.0, 0.11])
def test_unproject_inverts_project(kappa: float) -> None:
    camera = Camera(K, kappa)
    points = module_points()
    back = camera.unproject(H, camera.project(H, points))
    np.testing.assert_allclose(back, points, rtol=0, atol=1e-11)


def test_points_behind_the_camera_have_no_image() -> None:
    H_tilted = H.copy()
    H_tilted[2] = [-0.2, 0.0, 1.0]
    px = Camera(K, 0.1).project(H_tilted, [[1.0, 1.0], [5.0, 1.0], [9.0, 1.0]])
    assert np.isfinite(px[0]).all()
    assert np.isnan(px[1:]).all()


def test_pixels_beyond_the_horizon_have_no_module_point() -> None:
    H_tilted = H.copy()
    H_tilted[2] = [-0.2, 0.0, 1.0]
    camera = Camera(K, 0.0)
    behind = H_tilted @ [9.0, 1.0, 1.0]
    px = camera.to_pixels(behind[:2] / behind[2])
    assert np.isnan(camera.unproject(H_tilted, px)).all()


@given(st.floats(-0.35, 0.35), st.integers(0, 1000))
@settings(max_examples=25, deadline=None)
def test_analytic_derivatives_agree_with_numerical_ones(kappa: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = module_points(12)
    pose = H * (1 + 0.02 * rng.standard_normal((3, 3)))
    step = 1e-6

    def numerical(px_of) -> np.ndarray:
        return (px_of(step) - px_of(-step)) / (2 * step)

    got = Camera(K, kappa).derivatives(pose, points)
    np.testing.assert_allclose(got.px, Camera(K, kappa).project(pose, points), rtol=0, atol=1e-10)
    for axis in range(2):
        shift = np.eye(2)[axis]
        expected = numerical(
            lambda h, shift=shift: Camera(K, kappa).project(pose, points + h * shift)
        )
        np.testing.assert_allclose(got.d_module[:, :, axis], expected, rtol=1e-6, atol=1e-5)
    for index in range(8):
        unit = np.eye(9)[index].reshape(3, 3)
        expected = numerical(lambda h, unit=unit: Camera(K, kappa).project(pose + h * unit, points))
        np.testing.assert_allclose(got.d_homography[:, :, index], expected, rtol=1e-5, atol=1e-3)
    expected = numerical(lambda h: Camera(K, kappa + h).project(pose, points))
    np.testing.assert_allclose(got.d_kappa, expected, rtol=1e-6, atol=1e-5)
    for index, (row, col) in enumerate([(0, 0), (1, 1), (0, 2), (1, 2)]):
        unit = np.zeros((3, 3))
        unit[row, col] = 1.0
        expected = numerical(lambda h, unit=unit: Camera(K + h * unit, kappa).project(pose, points))
        np.testing.assert_allclose(got.d_intrinsics[:, :, index], expected, rtol=1e-6, atol=1e-5)


def test_derivatives_are_nan_where_there_is_no_image() -> None:
    camera = Camera(K, -0.5)
    got = camera.derivatives(10 * np.diag([1.0, 1.0, 0.1]), [[0.0, 0.0], [5.0, 0.0]])
    for name in ("px", "d_module", "d_homography", "d_kappa", "d_intrinsics"):
        values = getattr(got, name)
        assert np.isfinite(values[0]).all(), name
        assert np.isnan(values[1]).all(), name


def test_shapes_follow_the_points() -> None:
    camera = Camera(K, -0.1)
    grid = np.stack(np.meshgrid(np.arange(5.0), np.arange(4.0)), axis=-1)
    assert camera.project(H, grid).shape == (4, 5, 2)
    assert camera.unproject(H, camera.project(H, grid)).shape == (4, 5, 2)
    assert camera.jacobian(H, grid.reshape(-1, 2)).shape == (20, 2, 2)
    assert camera.project(H, np.empty((0, 2))).shape == (0, 2)


def lines_run(work: Callable[[], object]) -> int:
    """Count the lines of Python that something runs: its cost, however fast the machine is."""
    count = 0

    def trace(frame: FrameType, event: str, arg: object) -> Callable[..., object]:
        nonlocal count
        count += event == "line"
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        work()
    finally:
        sys.settrace(before)
    return count


@pytest.mark.parametrize("kappa", [-0.2, 0.0, 0.2])
def test_unprojecting_a_whole_frame_takes_as_few_steps_as_one_point(kappa: float) -> None:
    """Neither a loop over the points nor an iteration over the frame."""
    y, x = np.mgrid[0:512, 0:640]
    px = np.stack([x, y], axis=-1).reshape(-1, 2).astype(np.float64)
    camera = Camera(K, kappa)
    frame = lines_run(lambda: camera.unproject(H, px))
    assert frame == lines_run(lambda: camera.unproject(H, px[:1]))
    # 128 to 141 lines, those of NumPy among them.
    assert frame < 200


def test_the_camera_can_not_be_changed_from_outside() -> None:
    mutable = K.copy()
    camera = Camera(mutable, 0.0)
    mutable[0, 0] = 1.0
    assert camera.K[0, 0] == 820.0
    with pytest.raises(ValueError, match="read-only"):
        camera.K[0, 0] = 1.0


@pytest.mark.parametrize(
    ("matrix", "kappa", "text"),
    [
        (np.eye(2), 0.0, "must be 3 x 3"),
        (np.diag([1.0, 1.0, 2.0]), 0.0, "last row 0 0 1"),
        (np.diag([0.0, 1.0, 1.0]), 0.0, "must be positive"),
        (np.full((3, 3), np.nan), 0.0, "finite"),
        (np.eye(3), np.inf, "kappa is inf"),
    ],
)
def test_an_impossible_camera_is_refused_in_one_sentence(matrix, kappa, text) -> None:
    with pytest.raises(InspectionError, match=text):
        Camera(matrix, kappa)
