"""The prior R of Eq. 7: weighted bilateral total variation.

References
----------
.. [1] T. Koehler, X. Huang, F. Schebesch, A. Aichert, A. Maier, J. Hornegger, "Robust multiframe
   super-resolution employing iteratively re-weighted minimization", IEEE Trans. Computational
   Imaging 2(1), 2016, doi:10.1109/TCI.2016.2516909.
.. [2] S. Farsiu, M. D. Robinson, M. Elad, P. Milanfar, "Fast and robust multiframe super
   resolution", IEEE Trans. Image Processing 13(10), 2004, doi:10.1109/TIP.2004.834669.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np
from numpy.typing import NDArray

from pv_inspect.stencil import OFFSETS, Stencil

__all__ = ["WeightedBtv"]

Image = NDArray[np.floating]


@dataclass(frozen=True)
class WeightedBtv:
    """Weighted bilateral total variation of an image.

    Parameters
    ----------
    threshold : float
        Difference of neighbours up to which the prior is the L1 norm, intensity units; larger
        ones, edges, are penalised less. See `adapted_to`.
    alpha : float
        Weight of a shift (l, m) is alpha^(|l| + |m|).
    sparsity : float
        Exponent p of the penalty of edges, 0 < p <= 1; 1 is plain BTV [2]_.
    smoothing : float
        Difference below which the L1 norm is rounded off, intensity units.

    Notes
    -----
    With the differences d = f(x) - f(x + s) over the half window of 12 shifts s, each edge of the
    window counted once,

        R(f) = sum_x sum_s alpha^|s| (phi(u) - e),  u = sqrt(d^2 + e^2),

    phi(u) = u for u <= T and T + (u^p T^(1-p) - T) / p beyond, so that
    phi' = min(1, (T / u)^(1-p)) is continuous: the adaptive weight of [1]_ without its jump.
    phi is concave in d^2. The quadratic with edge weights alpha^|s| phi'(u) / u therefore
    touches R at f and lies above it everywhere: minimising it never raises R (`majoriser`).
    """

    threshold: float
    alpha: float = 0.6
    sparsity: float = 0.5
    smoothing: float = 1e-3

    def adapted_to(self, image: Image, scale: float = 60.0) -> WeightedBtv:
        """Return the prior with the threshold that suits an image.

        Parameters
        ----------
        image : (height, width)
            Current estimate; every third row is enough to see its differences.
        scale : float
            Threshold in robust standard deviations (1.4826 MAD) of the nearest differences.
        """
        rows = image[::3]
        d = np.diff(rows, axis=1)
        mad = 1.4826 * float(np.median(np.abs(d - np.median(d))))
        return replace(self, threshold=max(scale * mad, self.smoothing))

    def objective(self, image: Image) -> float:
        """R(f), summed in float64."""
        return float(_objective(image, self._weights, *self._numbers).sum())

    def gradient(self, image: Image) -> Image:
        """Return d R / d f, (height, width)."""
        return self.majoriser(image).apply(image)

    def majoriser(self, image: Image, factor: float = 1.0, out: Stencil | None = None) -> Stencil:
        """Quadratic f' L f / 2 that touches ``factor * R`` at the image up to a constant.

        Parameters
        ----------
        image : (height, width)
        factor : float
        out : Stencil, optional
            Is overwritten, to save memory.

        Returns
        -------
        Stencil
            L, the Laplacian of the graph of the edge weights; ``L @ image`` is the gradient.
        """
        height, width = image.shape
        if out is None:
            out = Stencil.zeros((height, width), image.dtype.type)
        _edges(image, factor * self._weights, *self._numbers, out.planes)
        _degrees(out.planes)
        return out

    @property
    def _weights(self) -> NDArray[np.float64]:
        weights: NDArray[np.float64] = self.alpha ** np.abs(OFFSETS).sum(axis=1).astype(np.float64)
        return weights

    @property
    def _numbers(self) -> tuple[float, float, float]:
        return self.threshold, self.sparsity, self.smoothing


@numba.njit(cache=True, parallel=True)
def _objective(f, weights, threshold, sparsity, smoothing):  # type: ignore[no-untyped-def]
    height, width = f.shape
    rows = np.zeros(height)
    for y in numba.prange(height):
        total = 0.0
        for k in range(1, 13):
            dy, dx = OFFSETS[k]
            if y + dy >= height:
                continue
            s = 0.0
            for x in range(max(0, -dx), min(width, width - dx)):
                d = np.float64(f[y, x]) - np.float64(f[y + dy, x + dx])
                u = np.sqrt(d * d + smoothing * smoothing)
                if u > threshold:
                    u = threshold + threshold * ((u / threshold) ** sparsity - 1.0) / sparsity
                s += u - smoothing
            total += weights[k] * s
        rows[y] = total
    return rows


@numba.njit(cache=True, parallel=True, fastmath={"contract", "reassoc", "arcp"})
def _edges(f, weights, threshold, sparsity, smoothing, planes):  # type: ignore[no-untyped-def]
    """Off-diagonal planes: minus the edge weights."""
    height, width = f.shape
    kind = planes.dtype.type
    t2, e2 = kind(1.0 / threshold**2), kind(smoothing * smoothing)
    one, power = kind(1.0), kind(-0.5 * (1.0 - sparsity))
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
            if sparsity == 0.5:
                for x in range(lo, hi):
                    d = here[x] - there[x + dx]
                    u2 = d * d + e2
                    ratio = max(u2 * t2, one)
                    row[x] = w / np.sqrt(u2 * np.sqrt(ratio))
            else:
                for x in range(lo, hi):
                    d = here[x] - there[x + dx]
                    u2 = d * d + e2
                    ratio = max(u2 * t2, one)
                    row[x] = w / np.sqrt(u2) * ratio**power


@numba.njit(cache=True, parallel=True)
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
