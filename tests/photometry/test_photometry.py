"""The sensor is told from the scene where the module moves, and left alone where it doesn't."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

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
from pv_inspect.photometry.photometry import (
    Photometry,
    estimate_photometry,
    huber_weights,
    mean_illumination,
    observed,
)
from pv_inspect.reconstruction.solver import Problem, first_guess, minimise
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import NoiseModel
from tests.recording import Frames

SHAPE = (112, 144)
CAMERA = Camera(np.array([[300.0, 0, 71.5], [0, 300.0, 55.5], [0, 0, 1]]), -0.1)
LAYOUT = ModuleLayout(3, 4)
SIGMA, NOISE, N = 0.5, 0.003, 14


@dataclass(frozen=True, eq=False)
class Made:
    """A recording and a first image of its module."""

    sequence: Any
    registration: Registration
    model: ObservationModel
    image: np.ndarray
    frames: list[tuple[np.ndarray, np.ndarray]]

    def photometry(self) -> Photometry:
        still = np.zeros((len(self.sequence), 2))
        return result_of(
            estimate_photometry(self.sequence, self.registration, self.model, self.image, still)
        )


def recorded(
    reach: float,
    response: np.ndarray | float = 1.0,
    offset: np.ndarray | float = 0.0,
    model_sigma: float = SIGMA,
) -> Made:
    """Frames of a textured module that moves by up to ``reach`` LR px, and their image.

    ``model_sigma`` other than `SIGMA` makes an image that is wrong about the scene.
    """
    rng = np.random.default_rng(21)
    shifts = rng.uniform(-reach / 300, reach / 300, (N, 2))
    homographies = np.array(
        [[[0.1, 0.004, -0.2 + a], [-0.004, 0.1, -0.15 + b], [0.002, 0.003, 1]] for a, b in shifts]
    )
    registration = Registration(
        LAYOUT, CAMERA, homographies, np.ones(N, bool), ("",) * N, np.ones(N), np.zeros(N),
        np.ones(N),
    )  # fmt: skip
    grid = HrGrid.covering(LAYOUT, registration.lr_px_per_unit, 2.0)
    rays = SensorRays.of(CAMERA, SHAPE)
    model = ObservationModel.build(rays, CAMERA, homographies, grid, SIGMA)
    y, x = np.mgrid[: grid.shape[0], : grid.shape[1]].astype(np.float64)
    at = grid.to_module(np.stack([x, y], axis=-1))
    gap = np.minimum(np.abs(at - np.round(at)).min(-1), 0.5) < 0.03
    texture = cv2.GaussianBlur(rng.normal(0, 1, grid.shape), (0, 0), 1.5)
    scene = cv2.GaussianBlur(np.where(gap, 0.05, 0.5 + 0.2 * texture), (0, 0), 0.8)
    images = []
    for H in homographies:
        clean = model.frame(H).forward(scene)
        seen = clean * response + offset
        images.append((seen + rng.normal(0, NOISE, SHAPE)).astype(np.float32))
    sequence: Any = Frames(images, NoiseModel(NOISE**2, 0.0))
    wrong = ObservationModel.build(rays, CAMERA, homographies, grid, model_sigma)
    equations = NormalEquations.empty(wrong)
    frames = [observed(sequence, registration, i) for i in range(N)]
    for H, (g, weights) in zip(homographies, frames, strict=True):
        equations.add(H, g, weights)
    guess = first_guess(equations)
    image = result_of(minimise(Problem(equations, 0.5, 0.5), guess, 30)).image
    return Made(sequence, registration, wrong, np.asarray(image), frames)


def falling(v: float) -> np.ndarray:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    q = ((x - 71.5) ** 2 + (y - 55.5) ** 2) / (0.25 * (SHAPE[0] ** 2 + SHAPE[1] ** 2))
    return np.exp(-v * q)


@pytest.fixture(scope="module")
def patterned() -> tuple[Made, np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(22)
    offset = rng.normal(0, 0.01, SHAPE[1])
    pixels = 1.0 + rng.normal(0, 0.01, SHAPE) + rng.normal(0, 0.01, SHAPE[1])
    fall = falling(0.3)
    return recorded(6.0, fall * pixels, offset), fall, pixels, offset


def test_pattern_and_vignetting_of_a_moving_module_are_found(
    patterned: tuple[Made, np.ndarray, np.ndarray, np.ndarray],
) -> None:
    made, fall, pixels, offset = patterned
    found = made.photometry()
    v = found.vignetting
    assert v.coefficients[0] == pytest.approx(-0.3, abs=4 * v.deviations[0] + 0.02)
    np.testing.assert_allclose(found.illumination, fall, atol=0.03)
    inner = np.s_[20:-20, 30:-30]
    pattern = (found.response / found.illumination - 1.0 + found.offsets.mean(0) / 0.4)[inner]
    truth = (pixels - 1.0 + offset / 0.4)[inner]
    truth = truth - truth.mean()
    assert np.corrcoef(pattern.ravel(), truth.ravel())[0, 1] > 0.9
    assert (pattern - pattern.mean() - truth).std() < 0.5 * truth.std()


def test_what_was_found_makes_the_frames_agree(
    patterned: tuple[Made, np.ndarray, np.ndarray, np.ndarray],
) -> None:
    made = patterned[0]
    photometry = made.photometry()
    image = made.image / mean_illumination(photometry, made.registration, made.model)
    before, after = [], []
    for i in range(N):
        frame = made.model.frame(made.registration.homographies[i])
        for values, picture, sensor in (
            (before, made.image, None),
            (after, image, photometry),
        ):
            g, weights = observed(made.sequence, made.registration, i, sensor)
            predicted = frame.forward(picture)
            values.append(((g - predicted) ** 2 * weights)[predicted != 0].mean())
    assert np.mean(after) < 0.4 * np.mean(before)


def test_a_module_that_stands_still_is_not_corrected() -> None:
    rng = np.random.default_rng(23)
    # The image is wrong about the scene (its PSF is), and the sensor has a pattern as well.
    made = recorded(0.2, falling(0.3), rng.normal(0, 0.01, SHAPE[1]), model_sigma=0.8)
    found = made.photometry()
    np.testing.assert_array_equal(found.response, 1.0)
    np.testing.assert_array_equal(found.offsets, 0.0)


@pytest.mark.parametrize("model_sigma", [SIGMA, 0.7])
def test_scene_detail_is_not_taken_for_pattern(model_sigma: float) -> None:
    found = recorded(4.0, model_sigma=model_sigma).photometry()
    assert np.abs(found.response - found.illumination).max() < 0.02
    change = (found.response / found.illumination - 1.0) * 0.5 + found.offsets.mean(0)
    assert change.std() < 0.2 * NOISE


def test_few_frames_are_not_corrected(
    patterned: tuple[Made, np.ndarray, np.ndarray, np.ndarray],
) -> None:
    made = patterned[0]
    r = made.registration
    few = Registration(
        r.layout, r.camera, r.homographies, np.arange(N) < 5, r.why, r.gain, r.offset, r.rms
    )
    still = np.zeros((len(made.sequence), 2))
    found = result_of(estimate_photometry(made.sequence, few, made.model, made.image, still))
    np.testing.assert_array_equal(found.response, 1.0)


def test_observed_inverts_what_the_sensor_did() -> None:
    rng = np.random.default_rng(24)
    light = rng.uniform(0.1, 0.8, SHAPE)
    response = rng.uniform(0.7, 1.1, SHAPE).astype(np.float32)
    offsets = rng.normal(0, 0.01, (1, SHAPE[1])).astype(np.float32)
    registration = Registration(
        LAYOUT, CAMERA, np.eye(3)[None], np.ones(1, bool), ("",), np.array([1.2]),
        np.array([0.02]), np.ones(1),
    )  # fmt: skip
    image = (1.2 * light * response + offsets[0] + 0.02).astype(np.float32)
    sensor = Photometry(response, offsets, Photometry.ideal(1, SHAPE).vignetting, np.ones(SHAPE))
    sequence: Any = Frames([image], NoiseModel(NOISE**2, 0.0))
    g, weights = observed(sequence, registration, 0, sensor)
    np.testing.assert_allclose(g, light, atol=1e-5)
    np.testing.assert_allclose(weights, (1.2 * response / NOISE) ** 2, rtol=1e-5)


@pytest.mark.parametrize(
    "part", [np.s_[0:20, 30:50], np.s_[40:41, 50:70], np.s_[80 : SHAPE[0], 100 : SHAPE[1]]]
)
def test_a_part_of_a_frame_is_observed_as_in_the_whole(part: tuple[slice, slice]) -> None:
    rng = np.random.default_rng(25)
    response = rng.uniform(0.7, 1.1, SHAPE).astype(np.float32)
    offsets = rng.normal(0, 0.01, (1, SHAPE[1])).astype(np.float32)
    registration = Registration(
        LAYOUT, CAMERA, np.eye(3)[None], np.ones(1, bool), ("",), np.array([1.2]),
        np.array([0.02]), np.ones(1),
    )  # fmt: skip
    sensor = Photometry(response, offsets, Photometry.ideal(1, SHAPE).vignetting, np.ones(SHAPE))
    image = rng.uniform(0.1, 0.8, SHAPE).astype(np.float32)
    sequence: Any = Frames([image], NoiseModel(NOISE**2, 0.01))
    whole = observed(sequence, registration, 0, sensor)
    for cut, expected in zip(observed(sequence, registration, 0, sensor, part), whole, strict=True):
        np.testing.assert_allclose(cut, expected[part], rtol=1e-6)


def test_mean_illumination_is_the_vignetting_where_the_frames_see_the_module(
    patterned: tuple[Made, np.ndarray, np.ndarray, np.ndarray],
) -> None:
    made = patterned[0]
    photometry = made.photometry()
    mean = mean_illumination(photometry, made.registration, made.model)
    assert mean.shape == made.model.grid.shape
    again = made.model.frame(made.registration.homographies[0]).forward(mean)
    seen = again != 0
    np.testing.assert_allclose(again[seen], photometry.illumination[seen], atol=0.02)


def test_huber_weights_fall_with_the_residual() -> None:
    rng = np.random.default_rng(25)
    g = rng.normal(0.5, 0.01, SHAPE).astype(np.float32)
    predicted = np.full(SHAPE, 0.5, np.float32)
    weights = np.full(SHAPE, 1e4, np.float32)
    g[3, 4], g[5, 6] = 0.6, 0.52
    lowered = huber_weights(g, predicted, weights)
    # The robust standard deviation is 1 but for chance.
    assert lowered[3, 4] == pytest.approx(1e4 * 4.0 / 10.0, rel=0.05)
    assert lowered[5, 6] == 1e4
    assert lowered.max() == 1e4


@pytest.mark.parametrize(("misfit", "share"), [(1.5, 1.0), (4.0, 1 / 4), (20.0, 1 / 100)])
def test_a_frame_that_fits_badly_as_a_whole_counts_as_a_noisy_one(
    misfit: float, share: float
) -> None:
    rng = np.random.default_rng(26)
    g = rng.normal(0.5, 0.01 * misfit, SHAPE).astype(np.float32)
    weights = np.full(SHAPE, 1e4, np.float32)
    lowered = huber_weights(g, np.full(SHAPE, 0.5, np.float32), weights)
    assert np.median(lowered) == pytest.approx(1e4 * share, rel=0.05)
    assert lowered.min() > 0.5 * 1e4 * share


def test_huber_leaves_alone_what_has_no_prediction() -> None:
    weights = np.full(SHAPE, 1e4, np.float32)
    g = np.full(SHAPE, 0.5, np.float32)
    np.testing.assert_array_equal(huber_weights(g, np.zeros(SHAPE, np.float32), weights), weights)
