"""A short recording that W itself has made, of a scene that is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.observation.model import ObservationModel
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.frame import Frame
from pv_inspect.sequence.sequence import NoiseModel
from pv_inspect.settings import Settings

SHAPE = (64, 88)
CAMERA = Camera(np.array([[200.0, 0, 43.5], [0, 200.0, 31.5], [0, 0, 1]]), -0.1)
LAYOUT = ModuleLayout(2, 3)
SIGMA, NOISE = 0.45, 0.004


@dataclass(frozen=True, eq=False)
class Frames:
    """What the stages ask of a Sequence."""

    images: Sequence[np.ndarray]
    noise: NoiseModel = field(default_factory=lambda: NoiseModel(NOISE**2, 0.0))

    @property
    def shape(self) -> tuple[int, ...]:
        return self.images[0].shape

    @property
    def removed_columns(self) -> np.ndarray:
        return np.zeros(self.shape[1], np.float32)

    def __len__(self) -> int:
        return len(self.images)

    def frame(self, index: int) -> Frame:
        return Frame(self.images[index], np.ones(self.shape, bool))


def scene_on(grid: HrGrid) -> np.ndarray:
    """Bright cells with a pattern and dark gaps, softened to what the grid can carry."""
    y, x = np.mgrid[: grid.shape[0], : grid.shape[1]].astype(np.float64)
    at = grid.to_module(np.stack([x, y], axis=-1))
    gap = np.minimum(np.abs(at - np.round(at)).min(-1), 0.5) < 0.03
    inside = ((at > 0) & (at < [3.0, 2.0])).all(-1)
    values = 0.5 + 0.08 * np.sin(12 * at[..., 0] + 5 * at[..., 1])
    return cv2.GaussianBlur(np.where(inside & ~gap, values, 0.05), (0, 0), 0.8)


def recording(
    n: int, moving: bool = True, magnification: float = 3.0
) -> tuple[Any, Registration, np.ndarray]:
    """Frames made by W itself with known noise, gains and offsets; and their scene."""
    rng = np.random.default_rng(11)
    shifts = rng.uniform(-0.05, 0.05, (n, 2)) * moving
    homographies = np.array(
        [[[1.0, 0.04, -1.5 + a], [-0.04, 1.0, -1.0 + b], [0.02, 0.03, 8.0]] for a, b in shifts]
    )
    gain, offset = rng.uniform(0.9, 1.1, n), rng.uniform(-0.01, 0.01, n)
    registration = Registration(
        LAYOUT,
        CAMERA,
        homographies,
        np.ones(n, bool),
        ("",) * n,
        gain,
        offset,
        np.ones(n),
    )
    grid = HrGrid.covering(LAYOUT, registration.lr_px_per_unit, magnification)
    scene = scene_on(grid)
    model = ObservationModel.build(SensorRays.of(CAMERA, SHAPE), CAMERA, homographies, grid, SIGMA)
    images = []
    for H, a, b in zip(homographies, gain, offset, strict=True):
        clean = a * model.frame(H).forward(scene) + b
        images.append((clean + rng.normal(0, NOISE, SHAPE)).astype(np.float32))
    return Frames(tuple(images)), registration, scene


def settings_with(**values: Any) -> Settings:
    return Settings.create(
        **{"magnification": 3.0, "psf_sigma_lr_px": SIGMA, "prior_weight": 0.5, **values}
    )
