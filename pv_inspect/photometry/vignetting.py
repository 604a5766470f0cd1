"""How the light falls off towards the corners, told by the module's motion over the sensor.

A spot of the module is darker in frames in which it lies further out. A module that moves by a few
pixels changes by some tenths of a percent only, but it does so in all of its 100 000 pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pv_inspect.geometry.camera import Camera
from pv_inspect.photometry.residual_sums import (
    BAND_ROWS,
    COUNT,
    LIGHT,
    LIGHT2,
    PRODUCT,
    ResidualSums,
)

__all__ = ["Vignetting", "estimate_vignetting"]

Array = NDArray[np.float64]

_BLOCK_COLS = 16
_LEAST_BLOCK = 0.2
_LEAST_FRAMES = 5
_SIGNIFICANCE = 3.0
# The fall-off at the corner must be known to this much, and be no more than that.
_LARGEST_ERROR = 0.1
_LARGEST_FALL = 1.5


@dataclass(frozen=True)
class Vignetting:
    """Relative illumination V of the sensor about the principal point.

    Parameters
    ----------
    coefficients : tuple of float
        ``log V = a_1 q + a_2 q^2 + ..``, q = squared distance over squared half diagonal; empty if
        the frames do not tell.
    deviations : tuple of float
        Their standard deviations.

    Notes
    -----
    V = cos^4 of the field angle, an ellipse of mechanical vignetting and 1 - v q all start like
    this; the logarithm is linear in the coefficients and stays positive.
    """

    coefficients: tuple[float, ...] = ()
    deviations: tuple[float, ...] = ()

    def and_further(self, further: Vignetting) -> Vignetting:
        """Return both in one: the further one is what an image made with this one still tells."""
        if not further.coefficients:
            return self
        terms = max(len(self.coefficients), len(further.coefficients))
        both = np.zeros(terms)
        both[: len(self.coefficients)] += self.coefficients
        both[: len(further.coefficients)] += further.coefficients
        known = np.zeros(terms)
        known[: len(self.deviations)] = self.deviations
        known[: len(further.deviations)] = further.deviations
        return Vignetting(tuple(both.tolist()), tuple(known.tolist()))

    def illumination(self, camera: Camera, shape: tuple[int, int]) -> Array:
        """V at every pixel of a sensor, (height, width) float64; 1 at the principal point."""
        y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
        basis = _basis(np.stack([x, y], axis=-1), camera, shape, len(self.coefficients))
        v: Array = np.exp(basis @ np.array(self.coefficients, dtype=np.float64))
        return v


def estimate_vignetting(
    sums: ResidualSums, camera: Camera, homographies: Array, shape: tuple[int, int]
) -> Vignetting:
    """Estimate the fall-off, r^2 and r^4 as far as they are significant.

    Parameters
    ----------
    sums : ResidualSums
        Residuals against a module image made of these frames, vignetting and all.
    camera : Camera
    homographies : (n_frames, 3, 3) float64
        Of the frames in ``sums``, in their order.
    shape : tuple of int
        (height, width) of a frame.

    Returns
    -------
    Vignetting
        Without coefficients if the fall-off is not determined.

    Notes
    -----
    The module image has the mean of log V over the frames in it, so that the relative residual of
    frame i at x is ``log V(x) - mean_k log V(m_k(m_i^-1(x)))``. It is fitted by weighted least
    squares to blocks of pixels, with a gain and an offset per frame left free. The deviations are
    the larger ones of the fit's own and of the jackknife over the frames, which knows of errors
    that a frame has in all of its blocks.
    """
    n = len(homographies)
    if n < _LEAST_FRAMES:
        return Vignetting()
    best = Vignetting()
    relative = [_relative_blocks(frame.astype(np.float64)) for frame in sums.bands]
    for terms in (1, 2):
        normal, right, rest = np.zeros((n, terms, terms)), np.zeros((n, terms)), []
        for i, (weight, value, inverse_light) in enumerate(relative):
            known = weight > 0
            if known.sum() < 10:
                continue
            design = _design(i, known, camera, homographies, shape, terms)
            root = np.sqrt(weight[known])[:, None]
            nuisance = np.column_stack([np.ones(known.sum()), inverse_light[known]]) * root
            both = np.column_stack([design, value[known]]) * root
            both -= nuisance @ np.linalg.lstsq(nuisance, both, rcond=None)[0]
            normal[i] = both[:, :-1].T @ both[:, :-1]
            right[i] = both[:, :-1].T @ both[:, -1]
            rest.append(both)
        fit = _fit(normal, right, rest)
        if fit is None:
            break
        x, deviation = fit
        if abs(x[-1]) < _SIGNIFICANCE * deviation[-1]:
            break
        if not (deviation.max() < _LARGEST_ERROR and 0.0 <= -float(x.sum()) <= _LARGEST_FALL):
            break
        best = Vignetting(tuple(x.tolist()), tuple(deviation.tolist()))
    return best


def _fit(normal: Array, right: Array, rest: list[Array]) -> tuple[Array, Array] | None:
    """Solve the frames' normal equations together; returns coefficients and deviations."""
    whole, b = normal.sum(axis=0), right.sum(axis=0)
    n_used = len(rest)
    n_blocks = sum(len(r) for r in rest)
    if n_used < _LEAST_FRAMES or not np.linalg.cond(whole) < 1e10:
        return None
    x = np.linalg.solve(whole, b)
    misfit = sum(float(((r[:, -1] - r[:, :-1] @ x) ** 2).sum()) for r in rest)
    reduced = misfit / max(n_blocks - 2 * n_used - len(x), 1)
    formal = np.diag(np.linalg.inv(whole)) * reduced
    without = []
    for a, v in zip(normal, right, strict=True):
        if not np.linalg.cond(whole - a) < 1e10:
            return None
        without.append(np.linalg.solve(whole - a, b - v))
    spread = np.array(without) - np.mean(without, axis=0)
    jackknife = (len(without) - 1) / len(without) * (spread**2).sum(axis=0)
    return x, np.sqrt(np.maximum(formal, jackknife))


def _relative_blocks(bands: Array) -> tuple[Array, Array, Array]:
    """Weight, relative residual and 1 / light of the blocks of one frame, flat."""
    width = bands.shape[2] // _BLOCK_COLS * _BLOCK_COLS
    blocks = bands[..., :width].reshape(5, bands.shape[1], -1, _BLOCK_COLS).sum(axis=3)
    blocks = blocks.reshape(5, -1)
    weight, light = blocks[LIGHT2], blocks[LIGHT]
    known = (blocks[COUNT] > 0) & (light > 0)
    if known.any():
        known &= weight > _LEAST_BLOCK * np.median(weight[known])
    value = np.divide(blocks[PRODUCT], weight, out=np.zeros_like(weight), where=known)
    inverse = np.divide(light, weight, out=np.zeros_like(weight), where=known)
    return np.where(known, weight, 0.0), value, inverse


def _design(
    index: int,
    known: NDArray[np.bool_],
    camera: Camera,
    homographies: Array,
    shape: tuple[int, int],
    terms: int,
) -> Array:
    """Basis at the blocks of a frame less its mean over where the other frames see them."""
    n_bands, n_cols = -(-shape[0] // BAND_ROWS), shape[1] // _BLOCK_COLS
    top = np.arange(n_bands) * BAND_ROWS
    y = 0.5 * (top + np.minimum(top + BAND_ROWS, shape[0]) - 1.0)
    x = np.arange(n_cols) * _BLOCK_COLS + 0.5 * (_BLOCK_COLS - 1.0)
    centres = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)[known]
    module = camera.unproject(homographies[index], centres)
    total, count = np.zeros((len(centres), terms)), np.zeros((len(centres), 1))
    for H in homographies:
        px = camera.project(H, module)
        inside = np.asarray(((px >= 0) & (px <= [shape[1] - 1, shape[0] - 1])).all(-1))
        total[inside] += _basis(px[inside], camera, shape, terms)
        count[inside] += 1
    return _basis(centres, camera, shape, terms) - total / np.maximum(count, 1)


def _basis(px: Array, camera: Camera, shape: tuple[int, int], terms: int) -> Array:
    """Powers of the squared distance over the squared half diagonal."""
    q = ((px - camera.K[:2, 2]) ** 2).sum(axis=-1) / (0.25 * (shape[0] ** 2 + shape[1] ** 2))
    basis: Array = q[..., None] ** np.arange(1, terms + 1)
    return basis
