"""The prior R of Eq. 7: what the solver asks of it, its names, and sparse curvature.

References
----------
.. [1] T. Koehler, X. Huang, F. Schebesch, A. Aichert, A. Maier, J. Hornegger, "Robust multiframe
   super-resolution employing iteratively re-weighted minimization", IEEE Trans. Computational
   Imaging 2(1), 2016, doi:10.1109/TCI.2016.2516909.
.. [2] S. Lefkimmiatis, A. Bourquard, M. Unser, "Hessian-based norm regularization for image
   restoration with biomedical applications", IEEE Trans. Image Processing 21(3), 2012,
   doi:10.1109/TIP.2011.2168232.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol, Self

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.compiling import compiled
from pv_inspect.observation.stencil import Quadratic
from pv_inspect.reconstruction.total_variation import Btv, WeightedBtv

__all__ = ["Curvature", "Prior", "PriorName", "SparseCurvature", "prior_named"]

Image = NDArray[np.floating]
PriorName = Literal["sparse_curvature", "wbtv", "btv", "tikhonov"]

# Second differences d go along x, y and both diagonals. On a diagonal d is f_xx + f_yy +- 2 f_xy:
# with a quarter each, the weighted sum of squares is the squared Frobenius norm of the Hessian plus
# half of the squared Laplacian, the same for every direction of an edge.
_STEP_WEIGHTS = np.array([1.0, 1.0, 0.25, 0.25])
# Side of the neighbourhood that shares its weights, HR px.
_GROUP = 5
# Rows that one thread works through.
_BAND_ROWS = 32


class Prior(Protocol):
    """What the solver asks of a prior; images are (height, width), full-scale units."""

    def objective(self, image: Image) -> float:
        """R(f), summed in float64."""

    def majoriser(self, image: Image, factor: float = 1.0) -> Quadratic:
        """Return L; f' L f / 2 touches ``factor * R`` at the image and lies above it elsewhere."""

    def continued(self, image: Image, rounds: int, /) -> Prior:
        """Return the prior of the next round: itself, unless its scale follows the image.

        Parameters
        ----------
        image : (height, width)
            As it is after some rounds, each of which has minimised one majoriser.
        rounds : int
        """


def prior_named(name: PriorName, contrast: float) -> Prior:
    """Return the prior of a name.

    Parameters
    ----------
    name : {"sparse_curvature", "wbtv", "btv", "tikhonov"}
    contrast : float
        Unit that differences are measured in, full-scale units.
    """
    if name == "sparse_curvature":
        return SparseCurvature(contrast)
    if name == "wbtv":
        return WeightedBtv(contrast)
    if name == "btv":
        return Btv(contrast)
    return Btv(contrast, exponent=2.0)


@dataclass(frozen=True, eq=False)
class Curvature:
    """The operator L of ``f' L f / 2 = sum_x v(x) sum_s w_s d_s(x)^2 / 2``.

    Parameters
    ----------
    weights : (height, width) float32 or float64
        v; 0 at the border, where second differences d are not defined.

    Notes
    -----
    ``L f = sum_s D_s' (w_s v D_s f)`` needs one image of weights where a stencil needs nine.
    """

    weights: Image

    @cached_property
    def diagonal(self) -> Image:
        """The operator's diagonal, (height, width)."""
        w0, w1, w2, w3 = _STEP_WEIGHTS
        kernel = np.array([[w2, w1, w3], [w0, 4.0 * _STEP_WEIGHTS.sum(), w0], [w3, w1, w2]])
        out = cv2.filter2D(self.weights, -1, kernel, borderType=cv2.BORDER_CONSTANT)
        return np.asarray(out, self.weights.dtype)

    def apply(self, image: Image) -> Image:
        """L f of a (height, width) image."""
        out = np.empty_like(image)
        _curvature(image, self.weights, _STEP_WEIGHTS, out)
        return out


@dataclass(frozen=True)
class SparseCurvature:
    """A group-sparse penalty on the second differences of an image.

    Parameters
    ----------
    contrast : float
        Unit c of differences, full-scale units.
    smoothing : float
        Curvature below which the norm is rounded off, units of c.
    exponent : float
        p of the penalty, 0 < p <= 2: 0.5 is the sparsity of [1]_, 1 the total variation, 2
        quadratic.

    Notes
    -----
    With the second differences d_s = f(x - s) - 2 f(x) + f(x + s) in four directions s,

        R(f) = sum_x (u^p - e^p) / p,   u^2 = e^2 + mean_(5 x 5 around x) sum_s w_s (d_s / c)^2.

    It takes from [1]_ the sparsity p and the adaptive weights u^(p-2), which are shared by
    neighbours here: an edge or a finger is a structure, not a single pixel, while noise is not.
    Second differences [2]_, because cells are smooth shading with fine lines rather than flat
    patches: the spectrum of their images falls with the fifth power of the frequency and more.
    First differences with the same penalty turn texture into steps, at the minimiser by 1 to 3 dB
    worse than their own squares.

    R is concave in the squares d^2: the quadratic with the weights of f touches R at f and lies
    above it everywhere. L f is the gradient.
    """

    contrast: float
    smoothing: float = 0.75
    exponent: float = 0.5

    def objective(self, image: Image) -> float:
        """R(f), summed in float64."""
        u2 = self._squares(image).astype(np.float64)
        p = self.exponent
        return float((u2 ** (p / 2) - self.smoothing**p).sum() / p)

    def majoriser(self, image: Image, factor: float = 1.0) -> Curvature:
        """Quadratic f' L f / 2 that touches ``factor * R`` at the image up to a constant.

        Parameters
        ----------
        image : (height, width)
        factor : float

        Returns
        -------
        Curvature
            L; ``L.apply(image)`` is the gradient.
        """
        u2 = self._squares(image)
        weights = u2 ** u2.dtype.type(self.exponent / 2 - 1)
        shared = _mean(weights)
        shared *= shared.dtype.type(factor / self.contrast**2)
        # Second differences are defined one pixel off the border.
        shared[[0, -1]] = 0
        shared[:, [0, -1]] = 0
        return Curvature(shared)

    def continued(self, _image: Image, _rounds: int, /) -> Self:
        """Return itself."""
        return self

    def _squares(self, image: Image) -> Image:
        """u^2 of the notes."""
        energy = np.zeros_like(image)
        _energy(image, _STEP_WEIGHTS / self.contrast**2, energy)
        return _mean(energy) + image.dtype.type(self.smoothing**2)


def _mean(image: Image) -> Image:
    """Mean over 5 x 5 pixels, zeros outside of the image: a symmetric matrix."""
    mean = cv2.blur(image, (_GROUP, _GROUP), borderType=cv2.BORDER_CONSTANT)
    # Sums that slide over the image may leave zero by rounding.
    return np.maximum(np.asarray(mean, image.dtype), 0)


@compiled(parallel=True, fastmath={"contract", "reassoc"})
def _energy(f, weights, out):  # type: ignore[no-untyped-def]
    """Weighted sum of squared second differences, one pixel off the border."""
    height, width = f.shape
    kind = f.dtype.type
    two = kind(2)
    w0, w1, w2, w3 = kind(weights[0]), kind(weights[1]), kind(weights[2]), kind(weights[3])
    for y in numba.prange(1, height - 1):
        a, b, c = f[y - 1], f[y], f[y + 1]
        row = out[y]
        for x in range(1, width - 1):
            middle = two * b[x]
            d0 = b[x - 1] - middle + b[x + 1]
            d1 = a[x] - middle + c[x]
            d2 = a[x - 1] - middle + c[x + 1]
            d3 = a[x + 1] - middle + c[x - 1]
            row[x] = w0 * d0 * d0 + w1 * d1 * d1 + w2 * d2 * d2 + w3 * d3 * d3


@compiled(parallel=True, fastmath={"contract", "reassoc"})
def _curvature(f, v, weights, out):  # type: ignore[no-untyped-def]
    """Bands of rows; three rows of weighted second differences, one pixel wider, go along."""
    height, width = f.shape
    kind = f.dtype.type
    two = kind(2)
    w0, w1, w2, w3 = kind(weights[0]), kind(weights[1]), kind(weights[2]), kind(weights[3])
    for band in numba.prange((height + _BAND_ROWS - 1) // _BAND_ROWS):
        first, last = band * _BAND_ROWS, min(height, (band + 1) * _BAND_ROWS)
        differences = np.zeros((3, 4, width + 2), f.dtype)
        for y in range(first - 1, last + 1):
            d = differences[y % 3]
            if 0 < y < height - 1:
                a, b, c, weight = f[y - 1], f[y], f[y + 1], v[y]
                d0, d1, d2, d3 = d[0], d[1], d[2], d[3]
                for x in range(1, width - 1):
                    middle = two * b[x]
                    d0[x + 1] = w0 * weight[x] * (b[x - 1] - middle + b[x + 1])
                    d1[x + 1] = w1 * weight[x] * (a[x] - middle + c[x])
                    d2[x + 1] = w2 * weight[x] * (a[x - 1] - middle + c[x + 1])
                    d3[x + 1] = w3 * weight[x] * (a[x + 1] - middle + c[x - 1])
            else:
                d[:] = kind(0)
            if y <= first:
                continue
            a, b, c, row = differences[(y - 2) % 3], differences[(y - 1) % 3], d, out[y - 1]
            b0, b1, b2, b3 = b[0], b[1], b[2], b[3]
            a1, a2, a3, c1, c2, c3 = a[1], a[2], a[3], c[1], c[2], c[3]
            for x in range(width):
                s = b0[x + 1] + b1[x + 1] + b2[x + 1] + b3[x + 1]
                sides = b0[x] + b0[x + 2] + a1[x + 1] + c1[x + 1]
                row[x] = sides + a2[x] + c2[x + 2] + a3[x + 2] + c3[x] - two * s
