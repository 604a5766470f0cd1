"""What an image of a part of the module says of LR pixels that it was not made from.

Weights and widths that have to be found are judged by it: the pixels of every frame are split at
random, an image is made from most of them, and the others are predicted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.observation.model import ObservationModel
from pv_inspect.observation.motion_blur import STILL, MovingFrame
from pv_inspect.observation.normal_equations import NormalEquations
from pv_inspect.observation.psf import Blur

__all__ = ["HeldOutPixels", "View", "cut_view", "equations_of", "model_of", "seen_part", "split"]

Array = NDArray[np.float64]
Image = NDArray[np.float32]

# Residuals beyond this many sigma are outliers and count as this many.
_OUTLIER = 5.0


@dataclass(frozen=True, eq=False)
class View:
    """The part of one frame that sees a window of the module.

    Parameters
    ----------
    H : (3, 3) float64
    rays : SensorRays
    g, weights : (height, width) float32
        Intensities on the module's scale and 1 / variance.
    motion : (2,) float64
        See `pv_inspect.observation.motion_blur.motion_of`.
    grain_px : int
        See `NoiseModel`; pixels are held out in squares of this side, for one tells of the others.
    """

    H: Array
    rays: SensorRays
    g: Image
    weights: Image
    motion: Array = field(default_factory=lambda: STILL)
    grain_px: int = 1


def seen_part(
    camera: Camera, H: Array, window: HrGrid, shape: tuple[int, int]
) -> tuple[slice, slice] | None:
    """Return the [row, col] slices of a frame (height, width) that see a window, or None."""
    h, w = window.shape
    t = np.linspace(0.0, 1.0, 9)
    rim = np.concatenate(
        [
            np.column_stack([a, b])
            for a, b in ((t, 0 * t), (t, 0 * t + 1), (0 * t, t), (0 * t + 1, t))
        ]
    )
    px = camera.project(H, window.to_module(rim * [w - 1, h - 1]))
    if not np.isfinite(px).all():
        return None
    low = np.maximum(np.floor(px.min(0)).astype(int) - 1, 0)
    high = np.minimum(np.ceil(px.max(0)).astype(int) + 2, [shape[1], shape[0]])
    if (high - low < 4).any():
        return None
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def cut_view(
    camera: Camera,
    H: Array,
    rays: SensorRays,
    window: HrGrid,
    g: Image,
    weights: Image,
    motion: Array = STILL,
    grain_px: int = 1,
) -> View | None:
    """Cut what a frame sees of a window; None if it sees nothing of it."""
    part = seen_part(camera, H, window, (g.shape[0], g.shape[1]))
    if part is None:
        return None
    return View(
        H,
        rays.cut(part),
        np.ascontiguousarray(g[part]),
        np.ascontiguousarray(weights[part]),
        motion,
        grain_px,
    )


def split(views: Sequence[View], share: float, seed: int) -> tuple[list[Image], list[Image]]:
    """Split LR pixels at random: weights to reconstruct with, weights to judge with.

    Parameters
    ----------
    views : sequence of View
    share : float
        Share of the pixels that is held out.
    seed : int
    """
    rng = np.random.default_rng(seed)
    train, test = [], []
    for view in views:
        side = view.grain_px
        height, width = view.weights.shape
        out = rng.random((-(-height // side), -(-width // side))) < share
        if side > 1:
            out = out.repeat(side, 0).repeat(side, 1)[:height, :width]
        train.append(np.where(out, np.float32(0), view.weights))
        test.append(np.where(out, view.weights, np.float32(0)))
    return train, test


def model_of(camera: Camera, grid: HrGrid, views: Sequence[View], sigma: float) -> ObservationModel:
    """Return the model of some views of a window, with an optical sigma in LR px."""
    homographies = np.array([view.H for view in views])
    return ObservationModel.build(views[0].rays, camera, homographies, grid, sigma)


def equations_of(
    model: ObservationModel, views: Sequence[View], train: Sequence[Image]
) -> NormalEquations:
    """Return the equations of the views, with other weights than their own."""
    equations = NormalEquations.empty(model)
    for view, weights in zip(views, train, strict=True):
        equations.add(view.H, view.g, weights, view.motion, view.rays)
    return equations


@dataclass(frozen=True, eq=False)
class HeldOutPixels:
    """Held-out pixels, placed on the HR grid.

    Parameters
    ----------
    blur : Blur
        Of the model that predicts them.
    pixels : tuple of (MovingFrame, (n,) float32, (n,) float32)
        Per view: where the pixels lie, their intensities, 1 / variance.
    """

    blur: Blur
    pixels: tuple[tuple[MovingFrame, Image, Image], ...]

    @classmethod
    def of(
        cls, model: ObservationModel, views: Sequence[View], test: Sequence[Image]
    ) -> HeldOutPixels:
        """Place the pixels whose weight in ``test`` is not 0."""
        placed = []
        for view, weights in zip(views, test, strict=True):
            frame = replace(model, rays=view.rays).moving(
                view.H, view.motion, weights > 0, np.float32
            )
            at = frame.pixels
            placed.append((frame, view.g.reshape(-1)[at], weights.reshape(-1)[at]))
        return cls(model.blur, tuple(placed))

    @property
    def n_pixels(self) -> int:
        """Number of pixels."""
        return sum(len(g) for _, g, _ in self.pixels)

    def residual(self, image: Image) -> float:
        """Sum of the squared residuals of an image (height, width), in noise units."""
        blurred = self.blur.apply(image)
        total = 0.0
        for frame, g, weights in self.pixels:
            z2 = weights * (g - frame.sample(blurred)) ** 2
            total += float(np.minimum(z2, _OUTLIER**2).sum(dtype=np.float64))
        return total
