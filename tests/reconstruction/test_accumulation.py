"""Frames that enter one by one, and what they say about the result."""

from __future__ import annotations

import numpy as np

from pv_inspect.common.work import result_of
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.reconstruction.accumulation import Accumulation, Extremes
from pv_inspect.reconstruction.reconstruct import reconstruct, solve
from pv_inspect.reconstruction.solver import first_guess
from pv_inspect.registration.registration import Registration
from tests.recording import CAMERA, SHAPE, SIGMA, Frames, recording, settings_with

SETTINGS = settings_with(max_iterations=300, second_pass=False, motion_blur="none")


def begun(sequence: Frames, registration: Registration) -> Accumulation:
    grid = HrGrid.covering(registration.layout, registration.lr_px_per_unit, 3.0)
    rays = SensorRays.of(CAMERA, SHAPE)
    motion = np.zeros((len(sequence), 2))
    return Accumulation.begin(sequence, registration, grid, rays, SIGMA, motion)  # type: ignore[arg-type]


def test_frames_may_enter_in_any_order() -> None:
    sequence, registration, _ = recording(5)
    one, two = (begun(sequence, registration) for _ in range(2))
    for i in range(5):
        one.add(i)
        two.add(4 - i)
    scale = np.abs(one.equations.right_hand_side).max()
    np.testing.assert_allclose(
        one.equations.right_hand_side, two.equations.right_hand_side, atol=1e-5 * scale
    )
    probe = np.random.default_rng(0).standard_normal(one.equations.model.grid.shape)
    probe = probe.astype(np.float32)
    a, b = one.equations.apply(probe), two.equations.apply(probe)
    np.testing.assert_allclose(a, b, atol=1e-4 * np.abs(a).max())


def test_a_run_that_is_split_ends_like_one_that_is_not() -> None:
    sequence, registration, _ = recording(10)
    # Squares have one minimiser; the sparse prior has several, close to each other.
    convex = SETTINGS.changed(prior="tikhonov", prior_weight=0.05)
    whole = result_of(reconstruct(sequence, registration, convex))
    data = begun(sequence, registration)
    for i in range(6):
        data.add(i)
    early = result_of(solve(data, first_guess(data.equations), 0.05, convex))
    for i in range(6, 10):
        data.add(i)
    late = result_of(solve(data, early.image, 0.05, convex))
    # Around the module hardly anything holds the image in its place.
    inside = np.s_[25:-25, 25:-25]
    difference = float(np.sqrt(np.mean((late.image - whole.image)[inside] ** 2)))
    assert difference < 0.1 * float(np.sqrt(np.mean((early.image - whole.image)[inside] ** 2)))


def test_residuals_of_a_right_model_are_those_of_the_noise() -> None:
    sequence, registration, _ = recording(16)
    result = result_of(reconstruct(sequence, registration, SETTINGS))
    h, w = result.image.shape
    inner = result.consistency[h // 3 : -h // 3, w // 3 : -w // 3]
    # The image follows a part of the noise, hence a little less than 1.
    assert 0.7 < float(np.median(inner)) < 1.1
    assert all(0.7 < rms < 1.1 for rms in result.residual_rms)


def test_a_frame_that_contradicts_the_others_is_seen_in_the_residuals() -> None:
    sequence, registration, _ = recording(12)
    images = [image.copy() for image in sequence.images]
    images[4][28:36, 40:50] += 0.2
    wrong = Frames(tuple(images))
    result = result_of(reconstruct(wrong, registration, SETTINGS))  # type: ignore[arg-type]
    shown = result.consistency
    assert shown.max() > 2.0
    place = np.array(np.unravel_index(shown.argmax(), shown.shape))[::-1]
    at = CAMERA.project(registration.homographies[4], result.grid.to_module(place[None]))
    assert 38 < at[0, 0] < 52
    assert 26 < at[0, 1] < 38


def test_an_insect_in_one_frame_leaves_no_trace_after_the_second_pass() -> None:
    sequence, registration, _ = recording(12)
    clean = result_of(reconstruct(sequence, registration, SETTINGS))
    images = [image.copy() for image in sequence.images]
    images[4][30:34, 43:47] += 0.3
    wrong = Frames(tuple(images))
    twice = SETTINGS.changed(second_pass=True)
    once, robust = (
        result_of(reconstruct(wrong, registration, s))  # type: ignore[arg-type]
        for s in (SETTINGS, twice)
    )
    harm, left = (float(np.abs(r.image - clean.image).max()) for r in (once, robust))
    assert left < 0.5 * harm


def test_no_value_is_beyond_what_the_frames_can_show() -> None:
    extremes = Extremes()
    image = np.array([[-1.4, -0.01, 0.3, 1.2]], np.float32)
    np.testing.assert_array_equal(extremes.limit(image), image)
    extremes.add(np.array([[-0.02, 0.5, 9.0]], np.float32), np.array([[1, 1, 0]], np.float32))
    np.testing.assert_allclose(extremes.limit(image), [[-0.02, -0.01, 0.3, 0.55]], atol=1e-6)
    extremes.add(np.array([[-0.4]], np.float32), np.ones((1, 1), np.float32))
    assert extremes.limit(image).min() == np.float32(-0.05)
