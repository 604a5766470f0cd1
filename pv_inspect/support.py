"""How much of the finest detail the frames have determined, and how much the prior.

The minimiser of Eq. 7 answers to a change of the scene with ``R = (A + L)^-1 A``, A the data's
normal operator and L the prior's majoriser: what the data say passes, the rest is held back. A
pattern that the scene does not contain is sent through R; the share that arrives is the support.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.observation import NormalEquations
from pv_inspect.preconditioning import Spectral
from pv_inspect.stencil import Quadratic, dot

__all__ = ["probe", "support_of"]

Image = NDArray[np.float32]

# The band of the probe, cycles per LR pixel: just beyond what one frame resolves.
_BAND = (0.55, 0.8)
# Radius over which the answer is averaged, LR pixels.
_WINDOW_LR_PX = 1.5
_ITERATIONS = 40
# The mean support rises from step to step; it is known when it rises by less than this.
_RISE = 1e-3
_TILE = 512
_SEED = 7


def probe(shape: tuple[int, int], magnification: float) -> Image:
    """Noise with details just finer than the LR pixels: 0.55 to 0.8 cycles per LR pixel.

    Parameters
    ----------
    shape : (height, width)
    magnification : float
        HR pixels per LR pixel. If the grid can't carry the band, it ends at the grid's limit.

    Returns
    -------
    (height, width) float32
        Mean 0, standard deviation 1; the same for the same arguments.
    """
    high = min(_BAND[1], 0.5 * magnification)
    low = _BAND[0] / _BAND[1] * high
    fy, fx = np.fft.fftfreq(_TILE)[:, None], np.fft.rfftfreq(_TILE)[None]
    frequency = magnification * np.hypot(fy, fx)
    noise = np.fft.rfft2(np.random.default_rng(_SEED).standard_normal((_TILE, _TILE)))
    noise[(frequency < low) | (frequency > high)] = 0.0
    tile = np.fft.irfft2(noise, (_TILE, _TILE))
    tile /= tile.std()
    height, width = shape
    repeats = (-(-height // _TILE), -(-width // _TILE))
    return np.ascontiguousarray(np.tile(tile, repeats)[:height, :width], dtype=np.float32)


def support_of(equations: NormalEquations, prior: Quadratic) -> Image:
    """Share of a detail just finer than the LR pixels that comes from the frames.

    Parameters
    ----------
    equations : NormalEquations
        The data.
    prior : Quadratic
        Majoriser of the prior at the minimiser, on the scale of the equations.

    Returns
    -------
    (height, width) float32
        0..1. 1: such detail is shown with its full contrast; 0: where it is missing from the
        image, the scene may have it nevertheless.

    Notes
    -----
    With the probe z and u = R z the support is the local regression coefficient of u on z,
    ``G * (z u) / G * z^2`` with a Gaussian window G. ``(A + L) u = A z`` is solved by conjugate
    gradients from 0 until the mean support no longer rises: it comes out too low by about a
    hundredth, with hardly any prior by a quarter, and never too high. The expectation over z is
    the mean of the diagonal of R restricted to the band. Frames that all stand in the same place
    reach about 0.1: one sample per LR pixel tells a part of the band from what it aliases to.
    """
    shape = equations.model.grid.shape
    magnification = equations.model.grid.magnification
    z = probe(shape, magnification)

    diagonal = equations.diagonal
    u = _answer(equations, prior, diagonal, z)
    sigma = _WINDOW_LR_PX * magnification
    answer = cv2.GaussianBlur(u * z, (0, 0), sigma)
    power = cv2.GaussianBlur(z * z, (0, 0), sigma)
    share = np.clip(answer / np.maximum(power, 1e-6), 0.0, 1.0)
    share[diagonal <= 0.0] = 0.0
    return np.asarray(share, np.float32)


def _answer(
    equations: NormalEquations, prior: Quadratic, diagonal: NDArray[np.floating], z: Image
) -> Image:
    """R z; the diagonal is that of the equations."""
    both = diagonal + prior.diagonal
    scale = (1.0 / np.maximum(both, 1e-9 * float(both.max()))).astype(np.float32)
    root = np.sqrt(scale)

    def whole(v: NDArray[np.floating]) -> NDArray[np.floating]:
        return equations.apply(v) + prior.apply(v)

    spectral = Spectral.of(whole, root)
    u = np.zeros_like(z)
    r = np.asarray(equations.apply(z), np.float32)
    p = np.asarray(spectral.apply(r, root), np.float32)
    rz, power = dot(r, p), dot(z, z)
    for _ in range(_ITERATIONS):
        full = np.asarray(whole(p), np.float32)
        curvature = dot(p, full)
        if rz <= 0.0 or curvature <= 0.0:
            break
        length = rz / curvature
        u += np.float32(length) * p
        if abs(length * dot(z, p)) < _RISE * power:
            break
        r -= np.float32(length) * full
        next_p = spectral.apply(r, root)
        new = dot(r, next_p)
        p *= np.float32(new / rz)
        p += next_p
        rz = new
    return u
