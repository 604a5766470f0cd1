"""Eq. 7 on scenes that are known, and what reconstruct() promises to its callers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from pv_inspect.common.work import result_of
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.inspection.doubts import OVER_FIT
from pv_inspect.observation.model import ObservationModel
from pv_inspect.observation.normal_equations import NormalEquations
from pv_inspect.reconstruction.held_out import View
from pv_inspect.reconstruction.prior import DEFAULT_PRIOR
from pv_inspect.reconstruction.prior_weight import typical_prior_weight
from pv_inspect.reconstruction.psf_estimation import TYPICAL_SIGMA_LR_PX, estimate_psf_sigma
from pv_inspect.reconstruction.reconstruct import reconstruct
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.reconstruction.single_frame import bicubic
from pv_inspect.reconstruction.solver import Problem, first_guess, minimise
from pv_inspect.reconstruction.total_variation import WeightedBtv
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import NoiseModel
from tests.recording import (
    CAMERA,
    LAYOUT,
    NOISE,
    SHAPE,
    SIGMA,
    Frames,
    recording,
    settings_with,
)


def equations_of(sequence: Any, registration: Registration, model: Any) -> NormalEquations:
    equations = NormalEquations.empty(model)
    for H, image, a, b in zip(
        registration.homographies,
        sequence.images,
        registration.gain,
        registration.offset,
        strict=True,
    ):
        weights = np.full(SHAPE, (a / NOISE) ** 2, np.float32)
        equations.add(H, ((image - b) / a).astype(np.float32), weights)
    return equations


def rms_inside(image: np.ndarray, scene: np.ndarray, grid: HrGrid) -> float:
    x0, y0 = (grid.to_pixels(np.zeros(2)) + 0.5).astype(int)
    x1, y1 = (grid.to_pixels(np.asarray(LAYOUT.size)) + 0.5).astype(int)
    return float(np.sqrt(((image - scene)[y0:y1, x0:x1] ** 2).mean()))


@pytest.fixture(scope="module")
def made() -> tuple[Any, Registration, np.ndarray, Reconstruction]:
    sequence, registration, scene = recording(16)
    return (
        sequence,
        registration,
        scene,
        result_of(reconstruct(sequence, registration, settings_with(max_iterations=200))),
    )


def test_a_scene_inside_the_model_is_found_again(
    made: tuple[Any, Registration, np.ndarray, Reconstruction],
) -> None:
    sequence, registration, scene, result = made
    assert result.converged
    assert result.image.dtype == np.float32
    assert result.image.shape == result.grid.shape
    baseline = bicubic(sequence, registration, result.grid, 0)
    ours = rms_inside(result.image, scene, result.grid)
    assert ours < 0.4 * rms_inside(baseline, scene, result.grid)
    # 16 frames at 3x: 1.8 samples per HR pixel. Deconvolution costs, the prior saves noise.
    assert ours < 4 * NOISE


def test_bicubic_shows_the_same_place_and_brightness(
    made: tuple[Any, Registration, np.ndarray, Reconstruction],
) -> None:
    sequence, registration, scene, result = made
    shown = bicubic(sequence, registration, result.grid, 3)
    inner = np.s_[60:-60, 60:-60]
    (dx, dy), _ = cv2.phaseCorrelate(
        shown[inner].astype(np.float64), cv2.GaussianBlur(scene, (0, 0), 1.6)[inner]
    )
    assert np.hypot(dx, dy) < 0.1
    assert shown[inner].mean() == pytest.approx(scene[inner].mean(), rel=0.01)


@pytest.mark.parametrize("prior", ["learned", "sparse_curvature", "btv", "tikhonov"])
def test_objective_falls_from_round_to_round(prior: str) -> None:
    sequence, registration, _ = recording(6)
    weight = {"learned": 0.5, "sparse_curvature": 0.5, "btv": 0.1, "tikhonov": 0.01}[prior]
    settings = settings_with(max_iterations=600, prior=prior, prior_weight=weight)
    result = result_of(reconstruct(sequence, registration, settings))
    objective = np.array(result.objective)
    assert len(objective) > 2
    assert (np.diff(objective) <= 1e-5 * objective[0]).all()
    assert 0.5 < objective[-1] < 2.5
    assert result.converged
    assert 0 < result.iterations < 600
    assert result.lambda_curve == ()


def test_weighted_btv_falls_to_where_its_gradient_vanishes() -> None:
    sequence, registration, _ = recording(6)
    grid = HrGrid.covering(LAYOUT, registration.lr_px_per_unit, 2.0)
    model = ObservationModel.build(
        SensorRays.of(CAMERA, SHAPE), CAMERA, registration.homographies, grid, SIGMA
    )
    equations = equations_of(sequence, registration, model)
    start = first_guess(equations)
    solution = result_of(minimise(Problem(equations, 0.2, 0.5, "wbtv"), start, 400, 0.0))
    prior = solution.problem.prior
    assert isinstance(prior, WeightedBtv)
    assert 0.0 < prior.threshold < np.inf
    objective = np.array(solution.objective)
    assert len(objective) > 10
    assert (np.diff(objective) <= 1e-6 * objective[0]).all()

    def slope(image: np.ndarray) -> np.ndarray:
        pull = solution.problem.majoriser(image).apply(image)
        return equations.apply(image) - equations.right_hand_side + pull

    assert np.linalg.norm(slope(solution.image)) < 2e-3 * np.linalg.norm(slope(start))


def test_stopping_rule_is_right_against_ten_times_the_steps(
    made: tuple[Any, Registration, np.ndarray, Reconstruction],
) -> None:
    sequence, registration, scene, result = made
    weight = settings_with().prior_weight
    assert weight is not None
    model = ObservationModel.build(
        SensorRays.of(CAMERA, SHAPE), CAMERA, registration.homographies, result.grid, SIGMA
    )
    equations = equations_of(sequence, registration, model)
    problem = Problem(equations, weight, 0.5)
    start = first_guess(equations)
    short = result_of(minimise(problem, start, 1000, spectral=True))
    long = result_of(minimise(problem, start, 10 * short.iterations, 0.0, spectral=True))
    assert short.converged
    rms = [rms_inside(s.image, scene, result.grid) for s in (short, long)]
    assert abs(20 * np.log10(rms[0] / rms[1])) < 0.1


def test_support_is_high_where_frames_are_and_zero_where_none_is(
    made: tuple[Any, Registration, np.ndarray, Reconstruction],
) -> None:
    _, _, _, result = made
    assert result.support.min() >= 0
    assert result.support.max() <= 1
    assert result.support[0, 0] < 0.02
    h, w = result.support.shape
    assert np.median(result.support[h // 3 : -h // 3, w // 3 : -w // 3]) > 0.25


def test_frames_that_did_not_move_claim_no_support(
    made: tuple[Any, Registration, np.ndarray, Reconstruction],
) -> None:
    still, registration, _ = recording(16, moving=False)
    result = result_of(reconstruct(still, registration, settings_with(max_iterations=20)))
    h, w = result.support.shape
    inner = np.s_[h // 3 : -h // 3, w // 3 : -w // 3]
    assert np.median(made[3].support[inner]) > 0.25
    assert result.support.max() == 0.0


@pytest.mark.parametrize(("n", "moving"), [(1, True), (8, False)])
def test_frames_in_one_place_choose_neither_psf_nor_prior(n: int, moving: bool) -> None:
    """A change of the scene makes good for a wrong PSF: their optical sigma is 0.45 by chance."""
    sequence, registration, scene = recording(n, moving)
    free = settings_with(prior_weight=None, psf_sigma_lr_px=None)
    result = result_of(reconstruct(sequence, registration, free))
    assert result.psf_sigma_lr_px == TYPICAL_SIGMA_LR_PX
    assert result.prior_weight == typical_prior_weight(DEFAULT_PRIOR)
    assert result.lambda_curve == ()
    assert result.support.max() == 0.0
    baseline = bicubic(sequence, registration, result.grid, 0)
    assert rms_inside(result.image, scene, result.grid) < rms_inside(baseline, scene, result.grid)
    assert OVER_FIT < np.median(result.residual_rms) < 1.2


@pytest.mark.parametrize("magnification", [1.0, 2.5, 6.0])
def test_one_frame_and_any_magnification_work(magnification: float) -> None:
    sequence, registration, _ = recording(1)
    result = result_of(
        reconstruct(
            sequence,
            registration,
            settings_with(magnification=magnification, max_iterations=10, psf_sigma_lr_px=None),
        )
    )
    assert np.isfinite(result.image).all()
    assert np.isfinite(result.support).all()
    assert result.grid.magnification == pytest.approx(magnification, rel=0.05)
    assert np.median(result.image) == pytest.approx(0.5, abs=0.15)


def test_the_same_input_gives_the_same_image_to_the_last_bit() -> None:
    sequence, registration, _ = recording(4)
    settings = settings_with(max_iterations=12)
    one, two = (result_of(reconstruct(sequence, registration, settings)) for _ in range(2))
    np.testing.assert_array_equal(one.image, two.image)


def test_a_brighter_recording_gives_the_same_image_brighter() -> None:
    sequence, registration, _ = recording(6)
    noise = NoiseModel(0.25 * NOISE**2, 0.0)
    darker = Frames(tuple(0.5 * image for image in sequence.images), noise)
    half = replace(registration, offset=0.5 * registration.offset)
    settings = settings_with(max_iterations=30)
    bright = result_of(reconstruct(sequence, registration, settings))
    dark = result_of(reconstruct(darker, half, settings))  # type: ignore[arg-type]
    np.testing.assert_allclose(2 * dark.image, bright.image, atol=2e-4)


def test_progress_rises_and_shows_the_image_and_closing_cancels() -> None:
    sequence, registration, _ = recording(3)
    seen = list(reconstruct(sequence, registration, settings_with(max_iterations=15)))
    fractions = [step.fraction for step in seen]
    assert fractions == sorted(fractions)
    assert fractions[0] > 0
    assert fractions[-1] <= 1
    assert any(step.image is not None for step in seen)
    assert any("sigma 0.45" in step.message for step in seen)
    work = reconstruct(sequence, registration, settings_with())
    next(work)
    work.close()


def test_no_usable_frame_is_one_clear_sentence() -> None:
    sequence, registration, _ = recording(2)
    none = replace(registration, used=np.zeros(2, bool))
    with pytest.raises(InspectionError, match="None of the 2 frames could be registered"):
        result_of(reconstruct(sequence, none, settings_with()))


def test_a_module_outside_of_all_frames_is_one_clear_sentence() -> None:
    sequence, registration, _ = recording(2)
    away = registration.homographies.copy()
    away[:, 0, 2] += 6.0
    with pytest.raises(InspectionError, match="None of the registered frames shows"):
        result_of(reconstruct(sequence, replace(registration, homographies=away), settings_with()))


def test_psf_width_is_found_from_held_out_pixels() -> None:
    sequence, registration, _ = recording(16)
    grid = HrGrid.covering(LAYOUT, registration.lr_px_per_unit, 3.0)
    rays = SensorRays.of(CAMERA, SHAPE)
    views = [
        View(
            H,
            rays,
            ((image - b) / a).astype(np.float32),
            np.full(SHAPE, (a / NOISE) ** 2, np.float32),
        )
        for H, image, a, b in zip(
            registration.homographies,
            sequence.images,
            registration.gain,
            registration.offset,
            strict=True,
        )
    ]
    found = result_of(estimate_psf_sigma(CAMERA, grid, views))
    assert found == pytest.approx(SIGMA, rel=0.1)
    narrow = (SIGMA - 0.08, SIGMA + 0.1)
    assert result_of(estimate_psf_sigma(CAMERA, grid, views, narrow)) == pytest.approx(found, 0.03)
    beyond = (SIGMA + 0.2, SIGMA + 0.4)
    assert result_of(estimate_psf_sigma(CAMERA, grid, views, beyond)) is None


def test_the_minimiser_does_not_depend_on_where_the_solver_starts() -> None:
    sequence, registration, _ = recording(12)
    grid = HrGrid.covering(LAYOUT, registration.lr_px_per_unit, 2.0)
    model = ObservationModel.build(
        SensorRays.of(CAMERA, SHAPE), CAMERA, registration.homographies, grid, SIGMA
    )
    equations = NormalEquations.empty(model)
    weights = np.full(SHAPE, NOISE**-2, np.float32)
    for H, image in zip(registration.homographies, sequence.images, strict=True):
        equations.add(H, image, weights)
    problem = Problem(equations, 1.0, 0.5)
    guess = first_guess(equations)
    one = result_of(minimise(problem, guess, 400, 1e-5))
    two = result_of(minimise(problem, np.full_like(guess, 0.3), 400, 1e-5))
    assert one.objective[-1] == pytest.approx(two.objective[-1], rel=1e-3)
    assert rms_inside(one.image, two.image, grid) < 0.002
