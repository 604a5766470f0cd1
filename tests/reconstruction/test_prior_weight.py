"""The prior weight that held-out pixels ask for, against the one that the truth asks for."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pv_inspect.common.work import result_of
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.observation.model import ObservationModel
from pv_inspect.observation.normal_equations import NormalEquations
from pv_inspect.reconstruction.held_out import View, equations_of, model_of
from pv_inspect.reconstruction.prior import DEFAULT_PRIOR
from pv_inspect.reconstruction.prior_weight import (
    CANDIDATES,
    Trial,
    choose_prior_weight,
    typical_prior_weight,
    windows_of,
)
from pv_inspect.reconstruction.solver import Problem, first_guess, minimise

SHAPE = (56, 56)
CAMERA = Camera(np.array([[200.0, 0, 27.5], [0, 200.0, 27.5], [0, 0, 1]]), 0.0)
LAYOUT = ModuleLayout(2, 2)
SIGMA, MAGNIFICATION = 0.45, 3.0


def cells_on(grid: HrGrid) -> np.ndarray:
    """Smooth shading with a few fine lines and dark gaps."""
    rng = np.random.default_rng(4)
    y, x = np.mgrid[: grid.shape[0], : grid.shape[1]].astype(np.float64)
    at = grid.to_module(np.stack([x, y], axis=-1))
    shading = cv2.GaussianBlur(rng.normal(size=grid.shape), (0, 0), 4.0)
    values = 0.5 + 0.06 * shading / shading.std()
    values[np.abs(at - np.round(at)).min(-1) < 0.03] = 0.1
    for k in range(5):
        values[np.abs(at[..., 0] * np.cos(k) + at[..., 1] * np.sin(k) - 0.3 * k) < 0.012] -= 0.15
    return cv2.GaussianBlur(values, (0, 0), 0.9)


def recording(noise: float) -> tuple[Trial, ObservationModel, np.ndarray]:
    rng = np.random.default_rng(12)
    homographies = [
        np.array([[1.0, 0.03, -1.0 + a], [-0.03, 1.0, -1.0 + b], [0.0, 0.0, 9.0]])
        for a, b in rng.uniform(-0.06, 0.06, (14, 2))
    ]
    grid = HrGrid.covering(LAYOUT, 200.0 / 9.0, MAGNIFICATION)
    rays = SensorRays.of(CAMERA, SHAPE)
    model = ObservationModel.build(rays, CAMERA, np.array(homographies), grid, SIGMA)
    scene = cells_on(grid)
    weights = np.full(SHAPE, noise**-2, np.float32)
    views = []
    for H in homographies:
        clean = model.frame(H).forward(scene)
        g = (clean + rng.normal(0, noise, SHAPE)).astype(np.float32)
        views.append(View(H, rays, g, weights))
    return Trial(grid, tuple(views)), model, scene


@pytest.mark.parametrize("noise", [0.005, 0.02])
def test_weight_is_found_between_too_much_noise_and_too_much_blur(noise: float) -> None:
    trial, model, scene = recording(noise)
    weight, curve = result_of(choose_prior_weight(CAMERA, [trial], SIGMA))
    equations = NormalEquations.empty(model)
    for view in trial.views:
        equations.add(view.H, view.g, view.weights)

    def error(weight: float) -> float:
        f = result_of(minimise(Problem(equations, weight, 0.5), first_guess(equations), 60)).image
        return float(np.sqrt(((f - scene)[12:-12, 12:-12] ** 2).mean()))

    found = error(weight)
    assert found < 0.8 * error(weight / 20)
    assert found < 0.8 * error(weight * 40)
    assert found < 1.4 * min(error(weight * factor) for factor in (2.0, 4.0))
    weights = [w for w, _ in curve]
    assert weights == sorted(weights)
    # Noise is 1; the wider and the narrower PSF leave more.
    assert min(e for _, e in curve) > 0.9
    best = min(curve, key=lambda tried: tried[1])[0]
    assert 0.5 <= weight / best <= 2.0


@pytest.mark.parametrize("factor", [1.0, 1.07])
def test_weight_suits_a_psf_that_is_right_or_somewhat_wide(factor: float) -> None:
    trial, _, scene = recording(0.005)
    weight, _ = result_of(choose_prior_weight(CAMERA, [trial], factor * SIGMA))
    model = model_of(CAMERA, trial.grid, trial.views, factor * SIGMA)
    equations = equations_of(model, trial.views, [view.weights for view in trial.views])

    def error(weight: float) -> float:
        f = result_of(minimise(Problem(equations, weight, 0.5), first_guess(equations), 60)).image
        return float(np.sqrt(((f - scene)[12:-12, 12:-12] ** 2).mean()))

    assert error(weight) < 1.1 * min(error(weight * f) for f in (0.25, 0.5, 1.0, 2.0, 4.0))


def test_windows_lie_inside_of_the_grid_and_show_the_same_places() -> None:
    grid = HrGrid.covering(ModuleLayout(6, 10), 55.0, 4.0)
    for window in windows_of(grid):
        corner = window.to_module(np.zeros(2))
        x, y = np.round(grid.to_pixels(corner)).astype(int)
        assert 0 <= x <= grid.shape[1] - window.shape[1]
        assert 0 <= y <= grid.shape[0] - window.shape[0]
        np.testing.assert_allclose(grid.to_pixels(corner), [x, y], atol=1e-9)


def test_no_view_of_any_window_leaves_the_usual_weight_without_a_curve() -> None:
    grid = HrGrid.covering(LAYOUT, 22.0, 2.0)
    weight, curve = result_of(choose_prior_weight(CAMERA, [Trial(grid, ())], SIGMA))
    assert curve == ()
    assert weight == typical_prior_weight(DEFAULT_PRIOR)
    tried = CANDIDATES[DEFAULT_PRIOR]
    assert min(tried) < weight < max(tried)
