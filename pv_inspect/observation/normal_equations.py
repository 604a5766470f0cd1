"""The normal equations of many frames, summed on the HR grid."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.compiling import compiled, read_only
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.observation.model import ObservationModel
from pv_inspect.observation.motion_blur import STILL, MovingFrame
from pv_inspect.observation.psf import footprint_variance_lr_px2
from pv_inspect.observation.stencil import Stencil
from pv_inspect.observation.taps import fill_taps, locate

__all__ = ["NormalEquations"]

Array = NDArray[np.float64]
Image = NDArray[np.floating]


# LR rows that one thread works through; the bands between are another phase, so that the taps of
# bands of the same phase never meet.
_BAND_ROWS = 16


@dataclass(eq=False)
class NormalEquations:
    """Sum over frames of W_i' V_i^-1 W_i and W_i' V_i^-1 g_i; frames are added one by one.

    Parameters
    ----------
    model : ObservationModel
    stencil : Stencil
        ``sum_i S_i' V_i^-1 S_i``.
    back_projection : (height, width) float32
        ``sum_i S_i' V_i^-1 g_i``, not yet blurred.
    energy : float
        ``sum_i g_i' V_i^-1 g_i``.
    n_pixels : int
        LR pixels that have entered.
    n_still : int
        Frames in the stencil.
    moving : list of (MovingFrame, (n,) float32, float)
        Frames whose motion is longer than the taps of the stencil reach: their samples, weights,
        and peak of their PSF relative to that of a still frame.
    """

    model: ObservationModel
    stencil: Stencil
    back_projection: Image
    energy: float = 0.0
    n_pixels: int = 0
    n_still: int = 0
    moving: list[tuple[MovingFrame, Image, float]] = field(default_factory=list)

    @classmethod
    def empty(
        cls, model: ObservationModel, dtype: type[np.floating] = np.float32
    ) -> NormalEquations:
        """Return the equations of no frame at all."""
        shape = model.grid.shape
        return cls(model, Stencil.zeros(shape, dtype), np.zeros(shape, dtype))

    def add(
        self,
        H: Array,
        g: Image,
        weights: Image,
        motion: Array = STILL,
        rays: SensorRays | None = None,
    ) -> None:
        """Add one frame.

        Parameters
        ----------
        H : (3, 3) float64
        g : (height, width) float32
            Frame, mapped to the module's intensities.
        weights : (height, width) float32
            1 / variance per LR pixel; 0 where it must not count.
        motion : (2,) float64
            See `pv_inspect.observation.motion_blur.motion_of`.
        rays : SensorRays, optional
            Rays of g if it is only a part of the frame; default: those of the model.
        """
        model = self.model if rays is None else replace(self.model, rays=rays)
        rays = model.rays.contiguous()
        if model.samples(motion) > 1:
            self._add_moving(model, H, g, weights, motion)
            return
        self.n_still += 1
        path = np.append(motion, 1.0)
        inputs = (model.to_hr(H), rays.xy, rays.per_px, model.moments, path, g, weights)
        energy, n = _accumulate(inputs, self.stencil.planes, self.back_projection)
        self.energy += energy
        self.n_pixels += n

    def _add_moving(
        self, model: ObservationModel, H: Array, g: Image, weights: Image, motion: Array
    ) -> None:
        kind = self.back_projection.dtype
        frame = model.moving(H, motion, weights > 0, kind)
        values = g.reshape(-1)[frame.pixels].astype(kind)
        w = weights.reshape(-1)[frame.pixels].astype(kind)
        frame.scatter(w * values, self.back_projection)
        still = footprint_variance_lr_px2(model.psf_sigma_lr_px)
        spread = np.sqrt(still / (still + (motion[0] ** 2 + motion[1] ** 2) / 12.0))
        self.moving.append((frame, w, float(spread)))
        self.energy += float(np.sum(w * values.astype(np.float64) ** 2))
        self.n_pixels += len(w)

    def apply(self, f: Image) -> Image:
        """Apply ``B (sum_i S_i' V_i^-1 S_i) B`` to an HR image."""
        blur = self.model.blur
        blurred = blur.apply(f)
        out = self.stencil.apply(blurred) if self.n_still else np.zeros_like(blurred)
        for frame, weights, _ in self.moving:
            frame.add_normal(weights, blurred, out)
        return blur.apply(out)

    @property
    def right_hand_side(self) -> Image:
        """``sum_i W_i' V_i^-1 g_i``."""
        return self.model.blur.apply(self.back_projection)

    @property
    def coverage(self) -> Image:
        """``sum_i S_i' V_i^-1 1``: the weight of the LR pixels around every HR pixel."""
        out = self._still_coverage
        for frame, weights, _ in self.moving:
            frame.scatter(weights, out)
        return out

    @property
    def diagonal(self) -> Image:
        """Positive approximation of the operator's diagonal, for preconditioning.

        The stencil is lumped to its row sums; where taps of either sign cancel, its own diagonal
        stands in. The row sums of frames that moved are lowered by what the motion widens the PSF.
        """
        lumped = np.maximum(self._still_coverage, self.stencil.diagonal)
        for frame, weights, spread in self.moving:
            frame.scatter(weights * lumped.dtype.type(spread), lumped)
        # At the end of a module's coverage single taps may be negative.
        return self.model.blur.apply_squared(np.maximum(lumped, 0))

    @property
    def _still_coverage(self) -> Image:
        ones = np.ones(self.back_projection.shape, self.back_projection.dtype)
        return self.stencil.apply(ones) if self.n_still else np.zeros_like(ones)


def _accumulate(
    inputs: tuple[NDArray[Any], ...], planes: NDArray[Any], back: NDArray[Any]
) -> tuple[float, int]:
    """Add S' V^-1 S and S' V^-1 g of one frame; returns g' V^-1 g and the number of pixels.

    Bands of LR rows run in two phases: the bands of one phase lie a band apart, and so do their
    taps on the HR grid. The sums do not depend on the number of threads.
    """
    height = inputs[1].shape[0]
    n_bands = -(-height // _BAND_ROWS)
    energy = np.zeros(n_bands)
    count = np.zeros(n_bands, np.int64)
    _add_bands(*read_only(*inputs), planes, back, energy, count)
    return float(energy.sum()), int(count.sum())


@compiled(parallel=True)
def _add_bands(  # type: ignore[no-untyped-def]
    M, rays, per_px, moments, motion, g, weights, planes, back, energy, count
):
    for phase in range(2):
        for half in numba.prange((len(count) - phase + 1) // 2):
            band = 2 * half + phase
            _add_band(
                band, M, rays, per_px, moments, motion, g, weights, planes, back, energy, count
            )


@compiled()
def _add_band(  # type: ignore[no-untyped-def]
    band, M, rays, per_px, moments, motion, g, weights, planes, back, energy, count
):
    place = np.empty(7)
    taps = np.empty(9)
    weighted = np.empty(9, planes.dtype)
    narrow = np.empty(9, planes.dtype)
    for row in range(band * _BAND_ROWS, min(rays.shape[0], (band + 1) * _BAND_ROWS)):
        for col in range(rays.shape[1]):
            weight = weights[row, col]
            if not weight > 0.0:
                continue
            if not locate(M, rays[row, col], per_px[row, col], moments, motion, back.shape, place):
                continue
            iy, ix = fill_taps(place[0], place[1], place[4], place[5], place[6], taps)
            value = np.float64(g[row, col])
            energy[band] += weight * value * value
            count[band] += 1
            for t in range(9):
                weighted[t] = weight * taps[t]
                narrow[t] = taps[t]
            for ay in range(3):
                y = iy + ay - 1
                for ax in range(3):
                    x = ix + ax - 1
                    c = weighted[3 * ay + ax]
                    back[y, x] += c * value
                    for bx in range(ax, 3):
                        planes[bx - ax, y, x] += c * narrow[3 * ay + bx]
                    for by in range(ay + 1, 3):
                        for bx in range(3):
                            k = 5 * (by - ay) + bx - ax
                            planes[k, y, x] += c * narrow[3 * by + bx]
