"""How much of the finest detail the frames have determined, and how much the prior.

The minimiser of Eq. 7 answers to a change of the scene with ``R = (A + L)^-1 A``, A the data's
normal operator and L the prior's majoriser: what the data say passes, the rest is held back. A
pattern that the scene does not contain is sent through R; the share that arrives is the support.
What L holds back depends on what is there, as a sparse prior lets pass what it takes for a
structure: L is that of the image with as much of the pattern in it as arrives.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.observation.normal_equations import NormalEquations
from pv_inspect.observation.stencil import Quadratic, dot
from pv_inspect.reconstruction.preconditioner import Spectral

__all__ = ["FAINT", "FINEST", "Detail", "probe", "support_of"]

Image = NDArray[np.float32]

FAINT = 0.1
"""Standard deviation of the detail that support is about, in parts of the module's brightness."""


@dataclass(frozen=True)
class Detail:
    """What is asked for.

    Parameters
    ----------
    band : (float, float)
        Of spatial frequencies, cycles per LR pixel.
    window_lr_px : float
        Radius over which the answer is averaged, LR pixels.
    """

    band: tuple[float, float]
    window_lr_px: float


FINEST = Detail((0.55, 0.8), 1.5)
"""Just beyond what one frame resolves."""

_ITERATIONS = 40
# A round ends when the mean support changes by less than this in a step. L moves most after the
# first rounds: what they solve to more than this is out of date.
_CHANGES = (1e-2, 1e-2, 1e-3)
_TILE = 512
_SEED = 7


def probe(
    shape: tuple[int, int], magnification: float, band: tuple[float, float] = FINEST.band
) -> Image:
    """Noise with details of some frequencies, just finer than the LR pixels if not given.

    Parameters
    ----------
    shape : (height, width)
    magnification : float
        HR pixels per LR pixel. If the grid can't carry the band, it ends at the grid's limit.
    band : (float, float)
        Cycles per LR pixel.

    Returns
    -------
    (height, width) float32
        Mean 0, standard deviation 1; the same for the same arguments.
    """
    high = min(band[1], 0.5 * magnification)
    low = band[0] / band[1] * high
    fy, fx = np.fft.fftfreq(_TILE)[:, None], np.fft.rfftfreq(_TILE)[None]
    frequency = magnification * np.hypot(fy, fx)
    noise = np.fft.rfft2(np.random.default_rng(_SEED).standard_normal((_TILE, _TILE)))
    noise[(frequency < low) | (frequency > high)] = 0.0
    tile = np.fft.irfft2(noise, (_TILE, _TILE))
    tile /= tile.std()
    height, width = shape
    repeats = (-(-height // _TILE), -(-width // _TILE))
    return np.ascontiguousarray(np.tile(tile, repeats)[:height, :width], dtype=np.float32)


def support_of(
    equations: NormalEquations,
    prior_with: Callable[[Image], Quadratic],
    detail: Detail = FINEST,
) -> Generator[float, None, Image]:
    """Share of a detail that comes from the frames.

    Parameters
    ----------
    equations : NormalEquations
        The data.
    prior_with : callable
        Majoriser of the prior, on the scale of the equations, at the minimiser with a detail in it,
        (height, width) float32 in units of the probe's standard deviation. How faint the probe is
        is decided there: `FAINT` of the brightness of the module.
    detail : Detail
        Just finer than the LR pixels if not given.

    Yields
    ------
    float
        Share of the work that is done.

    Returns
    -------
    (height, width) float32
        0..1. 1: such detail is shown with its full contrast; 0: where it is missing from the
        image, the scene may have it nevertheless.

    Notes
    -----
    With the probe z and what arrives of it, u, the support is the local regression coefficient of
    u on z, ``G * (z u) / G * z^2`` with a Gaussian window G. ``(A + L(u)) u = A z`` is solved in
    rounds of conjugate gradients, L first with all of z. Frames that all stand in the same place
    reach about 0.1: one sample per LR pixel tells a part of the band from what it aliases to. The
    support of a module image is without it, see
    `pv_inspect.reconstruction.sampling.of_more_than_one`.
    """
    shape = equations.model.grid.shape
    magnification = equations.model.grid.magnification
    z = probe(shape, magnification, detail.band)

    diagonal = equations.diagonal
    # Nothing arrives where no frame looks: the first round begins with nothing.
    u, residual = np.zeros_like(z), np.asarray(equations.apply(z), np.float32)
    frequencies: Spectral | None = None
    for done, change in enumerate(_CHANGES):
        yield done / len(_CHANGES)
        prior = prior_with(u if done else z)
        both = diagonal + prior.diagonal
        scale = (1.0 / np.maximum(both, 1e-9 * float(both.max()))).astype(np.float32)
        root = np.sqrt(scale)
        if frequencies is None:
            frequencies = Spectral.of(partial(_whole, equations, prior), root)
        first = _answer(
            equations, prior, partial(frequencies.apply, root=root), z, u, residual, change
        )
        if done and first < _CHANGES[-1]:
            break
    sigma = detail.window_lr_px * magnification
    answer = cv2.GaussianBlur(u * z, (0, 0), sigma)
    power = cv2.GaussianBlur(z * z, (0, 0), sigma)
    share = np.clip(answer / np.maximum(power, 1e-6), 0.0, 1.0)
    share[diagonal <= 0.0] = 0.0
    return np.asarray(share, np.float32)


def _whole(equations: NormalEquations, prior: Quadratic, v: Image) -> Image:
    return np.asarray(equations.apply(v) + prior.apply(v), np.float32)


def _answer(
    equations: NormalEquations,
    prior: Quadratic,
    precondition: Callable[[Image], Image],
    z: Image,
    u: Image,
    residual: Image,
    change: float,
) -> float:
    """Take u to R z, and with it ``A (z - u)``, the residual of the data.

    Returns by how much the first step changed the mean support.
    """
    r = residual - np.asarray(prior.apply(u), np.float32)
    p = precondition(r)
    rz, power, first = dot(r, p), dot(z, z), 0.0
    for done in range(_ITERATIONS):
        data = np.asarray(equations.apply(p), np.float32)
        full = data + np.asarray(prior.apply(p), np.float32)
        curvature = dot(p, full)
        if rz <= 0.0 or curvature <= 0.0:
            break
        length = rz / curvature
        u += np.float32(length) * p
        residual -= np.float32(length) * data
        changed = abs(length * dot(z, p)) / power
        first = first if done else changed
        if changed < change:
            break
        r -= np.float32(length) * full
        next_p = precondition(r)
        new = dot(r, next_p)
        p *= np.float32(new / rz)
        p += next_p
        rz = new
    return first
