"""Priors on the differences of neighbouring pixels: bilateral total variation, plain and weighted.

References
----------
.. [1] S. Farsiu, M. D. Robinson, M. Elad, P. Milanfar, "Fast and robust multiframe super
   resolution", IEEE Trans. Image Processing 13(10), 2004, doi:10.1109/TIP.2004.834669.
.. [2] T. Koehler, X. Huang, F. Schebesch, A. Aichert, A. Maier, J. Hornegger, "Robust multiframe
   super-resolution employing iteratively re-weighted minimization", IEEE Trans. Computational
   Imaging 2(1), 2016, doi:10.1109/TCI.2016.2516909.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numba
import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.compiling import compiled
from pv_inspect.observation.stencil import OFFSETS, Stencil

__all__ = ["Btv", "WeightedBtv"]

Array = NDArray[np.float64]
Image = NDArray[np.floating]

# The threshold of the weights is this many median absolute deviations: the tuning constant c = 2
# of [2]_.
_DEVIATIONS = 2.0
# Rounds after which the threshold follows the image no longer. It reaches its least value in one
# round on D4, and in four if the contrast is a fiftieth (``benchmarks/priors.py --thresholds``).
_ROUNDS = 5
# The median is taken of about this many pixels with their 12 differences each.
_SAMPLED_PIXELS = 40_000


@dataclass(frozen=True)
class Btv:
    """Bilateral total variation [1]_, and with the exponent 2 Tikhonov's squared differences.

    Parameters
    ----------
    contrast : float
        Unit c of differences, full-scale units.
    alpha : float
        Weight of a shift (l, m) is alpha^(|l| + |m|).
    smoothing : float
        Difference below which the L1 norm is rounded off, units of c.
    exponent : float
        p, 0 < p <= 2; 1 is total variation, 2 Tikhonov.

    Notes
    -----
    With the differences d = f(x) - f(x + s) over the half window of 12 shifts s, each edge of the
    window counted once, ``R(f) = sum_x sum_s alpha^|s| (u^p - e^p) / p``, u^2 = (d / c)^2 + e^2.
    The graph with edge weights alpha^|s| u^(p-2) has the Laplacian L of the majoriser.
    """

    contrast: float
    alpha: float = 0.6
    smoothing: float = 0.5
    exponent: float = 1.0

    def objective(self, image: Image) -> float:
        """R(f), summed in float64."""
        return float(_btv(image, _decay(self.alpha), *self._numbers).sum())

    def majoriser(self, image: Image, factor: float = 1.0) -> Stencil:
        """Quadratic f' L f / 2 that touches ``factor * R``; see `WeightedBtv.majoriser`."""
        height, width = image.shape
        out = Stencil.zeros((height, width), image.dtype.type)
        _edges(image, factor / self.contrast**2 * _decay(self.alpha), *self._numbers, out.planes)
        _degrees(out.planes)
        return out

    def continued(self, _image: Image, _rounds: int, /) -> Self:
        """Return itself."""
        return self

    @property
    def _numbers(self) -> tuple[float, float, float]:
        return 1.0 / self.contrast, self.smoothing, self.exponent


@dataclass(frozen=True)
class WeightedBtv:
    """Weighted bilateral total variation [2]_, the prior of the paper.

    Parameters
    ----------
    contrast : float
        Unit c of differences, full-scale units.
    alpha : float
        Weight of a shift (l, m) is alpha^(|l| + |m|), alpha_0 of [2]_.
    smoothing : float
        Difference below which the L1 norm is rounded off, units of c.
    sparsity : float
        p, 0 < p <= 1, of differences over the threshold; 0.5 in [2]_.
    threshold : float
        Weighted difference from which on the penalty grows with the power p, units of c. Infinite,
        the prior is bilateral total variation.

    Notes
    -----
    With z = alpha^|s| (f(x) - f(x + s)) / c over the half window of 12 shifts s, and the
    threshold t,

        R(f) = sum_x sum_s h(u) - h(e),   u^2 = z^2 + e^2,
        h(u) = u for u <= t,   t^(1 - p) u^p for u > t.

    Its slope is 1 below the threshold and p (t / u)^(1 - p) above: the weights beta of [2]_, which
    an iteration of theirs keeps. h is concave in u^2: with the weights of f the quadratic touches R
    at f and lies above it everywhere, so that R with a fixed t is minimised, and not only its
    weights repeated.

    As in [2]_ all weights are 1 at first, and t is twice the weighted median absolute deviation of
    z, taken again from round to round (`continued`). After some rounds it stays, so that there is
    one objective that falls. [2]_ also goes from coarse grids to the fine one; here the first
    image is the mean of all frames on the fine grid already.
    """

    contrast: float
    alpha: float = 0.5
    smoothing: float = 1.0
    sparsity: float = 0.5
    threshold: float = np.inf

    def objective(self, image: Image) -> float:
        """R(f), summed in float64."""
        return float(_weighted_btv(image, _decay(self.alpha), *self._numbers).sum())

    def majoriser(self, image: Image, factor: float = 1.0) -> Stencil:
        """Quadratic f' L f / 2 that touches ``factor * R`` at the image up to a constant.

        Parameters
        ----------
        image : (height, width)
        factor : float

        Returns
        -------
        Stencil
            L; ``L.apply(image)`` is the gradient.
        """
        height, width = image.shape
        out = Stencil.zeros((height, width), image.dtype.type)
        _weighted_edges(image, factor, _decay(self.alpha), *self._numbers, out.planes)
        _degrees(out.planes)
        return out

    def continued(self, image: Image, rounds: int, /) -> WeightedBtv:
        """Return the prior with its threshold as it is at the image, in the first rounds.

        Parameters
        ----------
        image : (height, width)
        rounds : int
            Majorisers that have been minimised; before the first one all weights are 1.
        """
        if rounds == 0:
            return replace(self, threshold=np.inf)
        if rounds > _ROUNDS:
            return self
        z = _sampled_differences(image, _decay(self.alpha)) / self.contrast
        deviation = _weighted_deviation(z, self._slope(np.hypot(z, self.smoothing)))
        # Below the smoothing there is no norm to tell from another.
        return replace(self, threshold=max(_DEVIATIONS * deviation, self.smoothing))

    def _slope(self, u: Array) -> Array:
        """h'(u): the confidence weights beta of [2]_."""
        over = np.maximum(u, self.threshold)
        with np.errstate(invalid="ignore"):
            slope = self.sparsity * (self.threshold / over) ** (1.0 - self.sparsity)
        return np.where(u <= self.threshold, 1.0, slope)

    @property
    def _numbers(self) -> tuple[float, float, float, float]:
        return 1.0 / self.contrast, self.smoothing, self.threshold, self.sparsity


def _decay(alpha: float) -> Array:
    """alpha^|s| of every shift."""
    weights: Array = alpha ** np.abs(OFFSETS).sum(axis=1).astype(np.float64)
    return weights


def _sampled_differences(image: Image, decay: Array) -> Array:
    """Weighted differences z times c of pixels spread over an image."""
    step = max(int(np.sqrt(image.size / _SAMPLED_PIXELS)), 1)
    height, width = image.shape
    z = []
    for (dy, dx), weight in zip(OFFSETS[1:], decay[1:], strict=True):
        here = image[: height - dy : step, max(0, -dx) : min(width, width - dx) : step]
        there = image[dy::step, max(0, dx) : min(width, width + dx) : step]
        z.append(weight * (here.astype(np.float64) - there).ravel())
    return np.concatenate(z)


def _weighted_deviation(values: Array, weights: Array) -> float:
    """Weighted median absolute deviation from the weighted median."""
    return _weighted_median(np.abs(values - _weighted_median(values, weights)), weights)


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(total, 0.5 * total[-1])]])


@compiled(parallel=True)
def _btv(f, weights, scale, smoothing, exponent):  # type: ignore[no-untyped-def]
    height, width = f.shape
    rows = np.zeros(height)
    least = smoothing**exponent
    for y in numba.prange(height):
        total = 0.0
        for k in range(1, 13):
            dy, dx = OFFSETS[k]
            if y + dy >= height:
                continue
            s = 0.0
            for x in range(max(0, -dx), min(width, width - dx)):
                d = scale * (np.float64(f[y, x]) - np.float64(f[y + dy, x + dx]))
                s += (d * d + smoothing * smoothing) ** (0.5 * exponent) - least
            total += weights[k] * s / exponent
        rows[y] = total
    return rows


@compiled(parallel=True, fastmath={"contract", "reassoc", "arcp"})
def _edges(f, weights, scale, smoothing, exponent, planes):  # type: ignore[no-untyped-def]
    """Off-diagonal planes: minus the edge weights."""
    height, width = f.shape
    kind = planes.dtype.type
    s2, e2, power = kind(scale * scale), kind(smoothing * smoothing), kind(0.5 * exponent - 1.0)
    for y in numba.prange(height):
        for k in range(1, 13):
            dy, dx = OFFSETS[k]
            row = planes[k, y]
            row[:] = 0
            if y + dy >= height:
                continue
            here, there = f[y], f[y + dy]
            w = kind(-weights[k])
            lo, hi = max(0, -dx), min(width, width - dx)
            if exponent == 1.0:
                for x in range(lo, hi):
                    d = here[x] - there[x + dx]
                    row[x] = w / np.sqrt(s2 * d * d + e2)
            else:
                for x in range(lo, hi):
                    d = here[x] - there[x + dx]
                    row[x] = w * (s2 * d * d + e2) ** power


@compiled(parallel=True)
def _weighted_btv(f, decay, scale, smoothing, threshold, sparsity):  # type: ignore[no-untyped-def]
    height, width = f.shape
    rows = np.zeros(height)
    least = smoothing
    if smoothing > threshold:
        least = threshold ** (1.0 - sparsity) * smoothing**sparsity
    for y in numba.prange(height):
        total = 0.0
        for k in range(1, 13):
            dy, dx = OFFSETS[k]
            if y + dy >= height:
                continue
            for x in range(max(0, -dx), min(width, width - dx)):
                z = decay[k] * scale * (np.float64(f[y, x]) - np.float64(f[y + dy, x + dx]))
                u = np.sqrt(z * z + smoothing * smoothing)
                if u > threshold:
                    u = threshold ** (1.0 - sparsity) * u**sparsity
                total += u - least
        rows[y] = total
    return rows


@compiled(parallel=True, fastmath={"contract", "reassoc", "arcp"})
def _weighted_edges(f, factor, decay, scale, smoothing, threshold, sparsity, planes):  # type: ignore[no-untyped-def]
    """Off-diagonal planes: minus the edge weights h'(u) / u."""
    height, width = f.shape
    kind = planes.dtype.type
    e2, power = kind(smoothing * smoothing), kind(0.5 * (sparsity - 1.0))
    t2, p = kind(threshold * threshold), kind(sparsity)
    for y in numba.prange(height):
        for k in range(1, 13):
            dy, dx = OFFSETS[k]
            row = planes[k, y]
            row[:] = 0
            if y + dy >= height:
                continue
            here, there = f[y], f[y + dy]
            step = decay[k] * scale
            s2, w = kind(step * step), kind(-factor * step * step)
            for x in range(max(0, -dx), min(width, width - dx)):
                d = here[x] - there[x + dx]
                u2 = s2 * d * d + e2
                slope = kind(1)
                if u2 > t2:
                    slope = p * (u2 / t2) ** power
                row[x] = w * slope / np.sqrt(u2)


@compiled(parallel=True)
def _degrees(planes):  # type: ignore[no-untyped-def]
    """Diagonal: sum of the weights of all edges at a pixel."""
    height, width = planes.shape[1:]
    for y in numba.prange(height):
        row = planes[0, y]
        row[:] = 0
        for k in range(1, 13):
            dy, dx = OFFSETS[k]
            lo, hi = max(0, -dx), min(width, width - dx)
            if y + dy < height:
                edges = planes[k, y]
                for x in range(lo, hi):
                    row[x] -= edges[x]
            if y - dy >= 0:
                edges = planes[k, y - dy]
                for x in range(lo, hi):
                    row[x + dx] -= edges[x]
