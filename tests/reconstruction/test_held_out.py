"""Held-out pixels: how they are split, and what the truth leaves of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.observation.motion_blur import STILL, motion_of
from pv_inspect.reconstruction.held_out import HeldOutPixels, View, equations_of, model_of, split

SHAPE = (48, 52)
CAMERA = Camera(np.array([[200.0, 0, 25.5], [0, 200.0, 23.5], [0, 0, 1]]), 0.0)
GRID = HrGrid.covering(ModuleLayout(2, 2), 200.0 / 9.0, 3.0)
SIGMA, NOISE = 0.45, 0.01


def seen(motion: np.ndarray) -> tuple[list[View], np.ndarray]:
    """Views of a random smooth scene."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[: GRID.shape[0], : GRID.shape[1]]
    scene = (0.5 + 0.2 * np.sin(0.21 * x) * np.cos(0.17 * y)).astype(np.float32)
    rays = SensorRays.of(CAMERA, SHAPE)
    weights = np.full(SHAPE, NOISE**-2, np.float32)
    views = []
    for a, b in rng.uniform(-0.06, 0.06, (6, 2)):
        H = np.array([[1.0, 0.03, -1.0 + a], [-0.03, 1.0, -1.0 + b], [0.0, 0.0, 9.0]])
        view = View(H, rays, np.zeros(SHAPE, np.float32), weights, motion)
        clean = model_of(CAMERA, GRID, [view], SIGMA).frame(H, motion).forward(scene)
        g = (clean + rng.normal(0, NOISE, SHAPE)).astype(np.float32)
        views.append(View(H, rays, g, weights, motion))
    return views, scene


def test_split_parts_all_pixels_and_is_the_same_every_time() -> None:
    views, _ = seen(STILL)
    train, test = split(views, 0.1, 5)
    for a, b, view in zip(train, test, views, strict=True):
        np.testing.assert_array_equal(a + b, view.weights)
        assert ((a == 0) ^ (b == 0)).all()
    assert np.mean([(t > 0).mean() for t in test]) == pytest.approx(0.1, abs=0.02)
    np.testing.assert_array_equal(test[1], split(views, 0.1, 5)[1][1])
    assert (test[0] != test[1]).any()


def test_frames_whose_errors_hang_together_are_split_in_squares() -> None:
    views = [replace(view, grain_px=8) for view in seen(STILL)[0]]
    for a, b, view in zip(*split(views, 0.3, 5), views, strict=True):
        np.testing.assert_array_equal(a + b, view.weights)
        squares = (b > 0)[:, :48].reshape(6, 8, 6, 8).mean(axis=(1, 3))
        assert set(np.unique(squares)) == {0.0, 1.0}


@pytest.mark.parametrize("motion", [STILL, motion_of(3.0, 30.0)])
def test_truth_leaves_the_noise_of_held_out_pixels(motion: np.ndarray) -> None:
    views, scene = seen(motion)
    _, test = split(views, 0.5, 1)
    held_out = HeldOutPixels.of(model_of(CAMERA, GRID, views, SIGMA), views, test)
    assert held_out.residual(scene) / held_out.n_pixels == pytest.approx(1.0, abs=0.07)


def test_pixels_are_either_judged_or_used() -> None:
    views, _ = seen(STILL)
    model = model_of(CAMERA, GRID, views, SIGMA)
    train, test = split(views, 0.3, 2)
    n = HeldOutPixels.of(model, views, test).n_pixels
    every = equations_of(model, views, [view.weights for view in views]).n_pixels
    assert 0 < n < every
    assert n + equations_of(model, views, train).n_pixels == every
