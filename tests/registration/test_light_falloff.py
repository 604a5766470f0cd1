"""The fall-off of the light is told from frames that show different parts of the module."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest

from pv_inspect.calibration.calibrate import Calibration
from pv_inspect.common.work import result_of
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.observation.model import ObservationModel
from pv_inspect.photometry.photometry import (
    estimate_photometry,
    falloff_alone,
    mean_illumination,
)
from pv_inspect.registration.light_falloff import evenly_lit, falloff_of_parts
from pv_inspect.registration.register import register
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import NoiseModel
from pv_inspect.settings import Settings
from tests.recording import Frames

SHAPE = (90, 120)
CAMERA = Camera(np.array([[300.0, 0, 59.5], [0, 300.0, 44.5], [0, 0, 1]]), 0.0)
LAYOUT = ModuleLayout(3, 4)
PX = 24.0
"""Width of a cell."""
WHOLE = [(60, 45), (57, 46), (62, 43), (59, 47), (61, 44), (60, 46)]
CUT = [(25, 45), (96, 44), (60, 15), (62, 76), (30, 66), (88, 25)]
"""Where the middle of the module, 96 x 72 px, lies in a frame."""
FALL = 0.2


class _Recording(Frames):
    no_measurements: ClassVar[dict[int, str]] = {}

    def indices(self, names: tuple[str, ...]) -> list[int]:
        return [len(self)] * len(names)


@dataclass(frozen=True, eq=False)
class Made:
    sequence: Any
    registration: Registration
    """Places, gains and offsets as they are."""
    model: ObservationModel
    scene: np.ndarray


def light() -> np.ndarray:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    q = ((x - 59.5) ** 2 + (y - 44.5) ** 2) / (0.25 * (SHAPE[0] ** 2 + SHAPE[1] ** 2))
    return np.exp(-FALL * q)


def made(places: list[tuple[int, int]]) -> Made:
    """Frames of W, with noise, gains and a fall-off."""
    rng = np.random.default_rng(5)
    n = len(places)
    homographies = np.array(
        [
            [[PX / 300, 0, (x - 59.5 - 2 * PX) / 300], [0, PX / 300, (y - 44.5 - 1.5 * PX) / 300],
             [0, 0.002, 1]]
            for x, y in places
        ]
    )  # fmt: skip
    gain = rng.uniform(0.95, 1.05, n)
    gain /= np.exp(np.log(gain).mean())
    registration = Registration(
        LAYOUT, CAMERA, homographies, np.ones(n, bool), ("",) * n, gain, np.zeros(n), np.ones(n)
    )
    grid = HrGrid.covering(LAYOUT, PX, 2.0)
    rays = SensorRays.of(CAMERA, SHAPE)
    model = ObservationModel.build(rays, CAMERA, homographies, grid, 0.5)
    y, x = np.mgrid[: grid.shape[0], : grid.shape[1]].astype(np.float64)
    at = grid.to_module(np.stack([x, y], axis=-1))
    inside = ((at > 0) & (at < [4.0, 3.0])).all(-1)
    gap = np.minimum(np.abs(at - np.round(at)).min(-1), 0.5) < 0.03
    texture = 0.5 + 0.15 * cv2.GaussianBlur(rng.normal(0, 4, grid.shape), (0, 0), 3.0)
    scene = cv2.GaussianBlur(np.where(inside & ~gap, texture, 0.02), (0, 0), 0.8)
    frames = [
        g * light() * model.frame(H).forward(scene) + rng.normal(0, 0.002, SHAPE)
        for g, H in zip(gain, homographies, strict=True)
    ]
    images = [np.asarray(frame, np.float32) for frame in frames]
    return Made(_Recording(images, NoiseModel(0.002**2, 0.0)), registration, model, scene)


@pytest.fixture(scope="module")
def parts() -> Made:
    return made(WHOLE[:2] + CUT)


def test_frames_that_show_parts_tell_the_fall_off_and_their_gains(parts: Made) -> None:
    true = parts.registration
    # What a gain for each frame alone made of it.
    wrong = replace(true, gain=true.gain * np.linspace(0.97, 1.03, 8), offset=np.full(8, 0.003))
    found = falloff_of_parts(parts.sequence, wrong)
    assert found is not None
    np.testing.assert_allclose(found.illumination(CAMERA, SHAPE), light(), atol=0.01)
    np.testing.assert_allclose(found.corrected(wrong).gain, true.gain, rtol=0.008)


def test_frames_that_show_the_whole_module_are_left_as_they_are() -> None:
    whole = made(WHOLE)
    assert falloff_of_parts(whole.sequence, whole.registration) is None
    sequence, state = evenly_lit(whole.sequence, whole.registration)
    assert sequence is whole.sequence
    assert state is whole.registration
    assert falloff_alone(whole.sequence, whole.registration) is None


def test_a_sensor_without_fall_off_is_given_none(parts: Made) -> None:
    flat = [np.asarray(frame / light(), np.float32) for frame in parts.sequence.images]
    found = falloff_of_parts(Frames(flat, parts.sequence.noise), parts.registration)
    assert found is None or -sum(found.coefficients) < 0.004


def test_frames_that_show_parts_are_registered_with_their_true_gains(parts: Made) -> None:
    true, n = parts.registration, len(parts.sequence)
    start = Calibration(
        LAYOUT, CAMERA, true.homographies, true.used, true.why, np.full(n, 0.1), False, 0.0
    )
    state = result_of(register(parts.sequence, start, Settings(kappa=0.0)))
    np.testing.assert_allclose(state.gain, true.gain, rtol=0.006)
    off = []
    for i in range(n):
        seen = true.crossings_px(i)
        shown = ((seen >= 0) & (seen <= [SHAPE[1] - 1, SHAPE[0] - 1])).all(axis=1)
        off.append(np.abs(state.crossings_px(i) - seen)[shown].max())
    assert max(off) < 0.1


def test_what_is_known_of_the_sensor_is_refined_and_not_taken_out_twice(parts: Made) -> None:
    registration = parts.registration
    known = falloff_alone(parts.sequence, registration)
    assert known is not None
    still = np.zeros((len(parts.sequence), 2))
    scene = np.asarray(parts.scene, np.float32)
    steps = estimate_photometry(parts.sequence, registration, parts.model, scene, still, known)
    found = result_of(steps)
    np.testing.assert_allclose(found.illumination, light(), atol=0.01)
    left = mean_illumination(found, registration, parts.model, known)
    np.testing.assert_allclose(left, 1.0, atol=0.01)
