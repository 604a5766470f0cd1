from __future__ import annotations

import numpy as np
import pytest

from pv_inspect.geometry.camera import Camera
from pv_inspect.photometry.residual_sums import ResidualSums
from pv_inspect.photometry.vignetting import Vignetting, estimate_vignetting

SHAPE = (128, 160)
CAMERA = Camera(np.array([[300.0, 0, 80.0], [0, 300.0, 64.0], [0, 0, 1]]), -0.1)
N, NOISE, LIGHT = 10, 0.01, 0.4


def poses(reach: float) -> np.ndarray:
    """Module plane -> rays for shifts of up to ``reach`` LR px; unit = 15 px."""
    shifts = np.random.default_rng(2).uniform(-reach / 300, reach / 300, (N, 2))
    return np.array([[[0.05, 0, -0.25 + a], [0, 0.05, -0.2 + b], [0, 0, 1]] for a, b in shifts])


def sums_of(homographies: np.ndarray, truth: Vignetting) -> ResidualSums:
    """Residuals against the mean over the frames, which has the mean vignetting in it."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    v = np.array(truth.coefficients)

    def log_v(px: np.ndarray) -> np.ndarray:
        q = ((px - [80.0, 64.0]) ** 2).sum(-1) / (0.25 * (SHAPE[0] ** 2 + SHAPE[1] ** 2))
        return sum((c * q ** (k + 1) for k, c in enumerate(v)), np.zeros(px.shape[:-1]))

    px = np.stack([x, y], axis=-1)
    sums = ResidualSums.empty(N, SHAPE)
    for i, H in enumerate(homographies):
        module = CAMERA.unproject(H, px)
        mean = np.mean([log_v(CAMERA.project(other, module)) for other in homographies], axis=0)
        r = LIGHT * (np.exp(log_v(px) - mean) - 1.0) + rng.normal(0, NOISE, SHAPE)
        sums.add(
            i,
            False,
            np.full(SHAPE, LIGHT, np.float32),
            r.astype(np.float32),
            np.full(SHAPE, NOISE**-2, np.float32),
        )
    return sums


def test_the_fall_off_is_found_within_its_deviation() -> None:
    homographies = poses(6.0)
    found = estimate_vignetting(
        sums_of(homographies, Vignetting((-0.25,))), CAMERA, homographies, SHAPE
    )
    assert len(found.coefficients) == 1
    assert found.deviations[0] < 0.03
    assert found.coefficients[0] == pytest.approx(-0.25, abs=3.5 * found.deviations[0])


def test_wide_motion_shows_the_fourth_order_too() -> None:
    homographies = poses(40.0)
    truth = (-0.4, 0.2)
    found = estimate_vignetting(
        sums_of(homographies, Vignetting(truth)), CAMERA, homographies, SHAPE
    )
    for x, deviation, expected in zip(found.coefficients, found.deviations, truth, strict=True):
        assert x == pytest.approx(expected, abs=4 * deviation + 0.01)


@pytest.mark.parametrize("reach", [6.0, 0.01])
def test_without_fall_off_or_without_motion_there_is_none(reach: float) -> None:
    fall = () if reach > 1.0 else (-0.3,)
    homographies = poses(reach)
    found = estimate_vignetting(
        sums_of(homographies, Vignetting(fall)), CAMERA, homographies, SHAPE
    )
    assert found == Vignetting()
    np.testing.assert_array_equal(found.illumination(CAMERA, SHAPE), np.ones(SHAPE))


def test_too_few_frames_tell_nothing() -> None:
    homographies = poses(6.0)
    sums = sums_of(homographies, Vignetting((-0.25,)))
    few = ResidualSums(sums.bands[:4], sums.pixels)
    assert estimate_vignetting(few, CAMERA, homographies[:4], SHAPE) == Vignetting()


def test_illumination_is_one_at_the_principal_point_and_falls_to_the_corner() -> None:
    v = Vignetting((-0.2,), (0.01,)).illumination(CAMERA, SHAPE)
    assert v[64, 80] == 1.0
    assert v[0, 0] == pytest.approx(np.exp(-0.2))
