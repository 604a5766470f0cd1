"""Motion blur found again: from exact cross spectra, and from frames that W has blurred."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.observation.model import ObservationModel
from pv_inspect.observation.motion_blur import length_and_angle, motion_of
from pv_inspect.reconstruction.motion_estimation import CrossSpectra, estimate_motion, fit_motion
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import NoiseModel
from tests.recording import Frames

SHAPE = (190, 270)
CAMERA = Camera(np.array([[400.0, 0, 135.0], [0, 400.0, 95.0], [0, 0, 1]]), -0.05)
LAYOUT = ModuleLayout(2, 3)
NOISE = 0.004


def errors(found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Largest error of length [LR px] and of angle [deg]."""
    lengths, angles = [], []
    for a, b in zip(found, true, strict=True):
        (la, ta), (lb, tb) = length_and_angle(a), length_and_angle(b)
        lengths.append(abs(la - lb))
        angles.append(abs((ta - tb + 90.0) % 180.0 - 90.0))
    return max(lengths), max(angles)


def recording(motions: np.ndarray) -> tuple[Any, Registration]:
    """Frames of a module with random texture, blurred by W."""
    rng = np.random.default_rng(5)
    n = len(motions)
    homographies = np.array(
        [
            [[1.0, 0.04, -1.5 + a], [-0.04, 1.0, -1.0 + b], [0.01, 0.02, 5.2]]
            for a, b in rng.uniform(-0.03, 0.03, (n, 2))
        ]
    )
    registration = Registration(
        LAYOUT, CAMERA, homographies, np.ones(n, bool), ("",) * n, np.ones(n), np.zeros(n),
        np.ones(n),
    )  # fmt: skip
    grid = HrGrid.covering(LAYOUT, registration.lr_px_per_unit, 3.0, margin=0.4)
    texture = cv2.GaussianBlur(rng.normal(size=grid.shape), (0, 0), 2.0)
    scene = 0.5 + 0.08 * texture / texture.std()
    model = ObservationModel.build(SensorRays.of(CAMERA, SHAPE), CAMERA, homographies, grid, 0.45)
    images = []
    for H, motion in zip(homographies, motions, strict=True):
        clean = model.frame(H, motion).forward(scene)
        images.append((clean + rng.normal(0, NOISE, SHAPE)).astype(np.float32))
    return Frames(images, NoiseModel(NOISE**2, 0.0)), registration


def test_motions_are_the_minimum_of_exact_cross_spectra() -> None:
    rng = np.random.default_rng(6)
    true = np.array([motion_of(rng.uniform(1.5, 5.0), rng.uniform(0, 180)) for _ in range(10)])
    f = rng.uniform(-0.35, 0.35, (900, 2))
    f = f[(np.hypot(*f.T) < 0.35) & (np.hypot(*f.T) > 0.03)]
    h = np.sinc(f @ true.T)
    scene = 1.0 / (np.hypot(*f.T) + 0.02) ** 2
    power = scene[:, None, None] * h[:, :, None] * h[:, None, :] + 0.5 * np.eye(10)
    found = fit_motion(CrossSpectra(power, np.broadcast_to(f, (10, *f.shape)), 100))
    length, angle = errors(found, true)
    assert length < 0.03
    assert angle < 0.5


def test_motions_of_blurred_frames_are_found() -> None:
    true = np.array([motion_of(1.6 + 0.3 * k, 47.0 * k % 180.0) for k in range(10)])
    sequence, registration = recording(true)
    length, angle = errors(estimate_motion(sequence, registration), true)
    assert length < 0.3
    assert angle < 5.0


def test_sharp_frames_among_moving_ones_stay_still() -> None:
    true = np.array([motion_of(3.0 * (k % 2), 40.0 * k) for k in range(8)])
    sequence, registration = recording(true)
    found = estimate_motion(sequence, registration)
    assert not found[::2].any()
    assert errors(found[1::2], true[1::2])[0] < 0.3


@pytest.mark.parametrize("n", [3, 8])
def test_still_and_few_frames_have_no_motion(n: int) -> None:
    sequence, registration = recording(np.zeros((n, 2)))
    assert not estimate_motion(sequence, registration).any()
