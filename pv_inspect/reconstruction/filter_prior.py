"""Priors on the answers of small filters: sparse curvature, and filters learnt from cells.

References
----------
.. [1] T. Koehler, X. Huang, F. Schebesch, A. Aichert, A. Maier, J. Hornegger, "Robust multiframe
   super-resolution employing iteratively re-weighted minimization", IEEE Trans. Computational
   Imaging 2(1), 2016, doi:10.1109/TCI.2016.2516909.
.. [2] S. Lefkimmiatis, A. Bourquard, M. Unser, "Hessian-based norm regularization for image
   restoration with biomedical applications", IEEE Trans. Image Processing 21(3), 2012,
   doi:10.1109/TIP.2011.2168232.
.. [3] A. Goujon, S. Neumayer, P. Bohra, S. Ducotterd, M. Unser, "A neural-network-based convex
   regularizer for inverse problems", IEEE Trans. Computational Imaging 9, 2023,
   doi:10.1109/TCI.2023.3306100.
.. [4] S. Roth, M. J. Black, "Fields of experts", Int. J. Computer Vision 82, 2009,
   doi:10.1007/s11263-008-0197-6.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.parallel import parallel_map

__all__ = [
    "WEIGHTS",
    "FilterBank",
    "FilterGroup",
    "FilterPrior",
    "learned_prior",
    "sparse_curvature",
]

Array = NDArray[np.float64]
Image = NDArray[np.floating]

WEIGHTS = Path(__file__).with_name("learned_prior.json")
"""Written by ``benchmarks/fit_prior.py``; see learned_prior.md beside it."""

# Second differences d go along x, y and both diagonals. On a diagonal d is f_xx + f_yy +- 2 f_xy:
# with a quarter each, the sum of squares is the squared Frobenius norm of the Hessian plus half of
# the squared Laplacian, the same for every direction of an edge.
_SECOND_DIFFERENCES = np.array(
    [
        [[0, 0, 0], [1, -2, 1], [0, 0, 0]],
        [[0, 1, 0], [0, -2, 0], [0, 1, 0]],
        [[0.5, 0, 0], [0, -1, 0], [0, 0, 0.5]],
        [[0, 0, 0.5], [0, -1, 0], [0.5, 0, 0]],
    ]
)
# Side of the neighbourhood that shares its weights, HR px.
_SHARED = 5
# Rows that one thread works through: with them all answers of a group stay in the cache.
_BAND_ROWS = 64


@dataclass(frozen=True, eq=False)
class FilterGroup:
    """Filters whose answers make one norm.

    Parameters
    ----------
    filters : (n, k, k) float64
        Correlation kernels of an odd side k, each of mean 0.
    weight : float
        a of `FilterPrior`.
    smoothing : float
        e of `FilterPrior`: below, the norm is rounded off; units of the contrast.
    """

    filters: Array
    weight: float
    smoothing: float

    @property
    def reach(self) -> int:
        """How far from its middle a filter reaches, px."""
        return int(self.filters.shape[1]) // 2


@dataclass(frozen=True, eq=False)
class FilterBank:
    """The operator L of ``f' L f / 2 = sum_g sum_x v_g(x) sum_k (w_gk * f)(x)^2 / 2``.

    Parameters
    ----------
    groups : sequence of FilterGroup
    weights : sequence of (height, width) float32 or float64
        v_g; 0 where the filters reach over the border.
    """

    groups: Sequence[FilterGroup]
    weights: Sequence[Image]

    @cached_property
    def diagonal(self) -> Image:
        """The operator's diagonal, (height, width)."""
        out = np.zeros_like(self.weights[0])
        for group, v in zip(self.groups, self.weights, strict=True):
            out += _adjoint(v, (group.filters**2).sum(0))
        return out

    def apply(self, image: Image) -> Image:
        """L f of a (height, width) image."""
        out = np.zeros_like(image)
        parallel_map(lambda first: self._apply_band(image, out, first), _bands(image))
        return out

    def _apply_band(self, image: Image, out: Image, first: int) -> None:
        """Rows of L f; those that the filters reach from them go along."""
        last = min(first + _BAND_ROWS, image.shape[0])
        for group, v in zip(self.groups, self.weights, strict=True):
            seen = slice(max(first - 2 * group.reach, 0), last + 2 * group.reach)
            rows = slice(first - seen.start, last - seen.start)
            f, weights = image[seen], v[seen]
            for w in group.filters:
                out[first:last] += _adjoint(weights * _answer(f, w), w)[rows]


@dataclass(frozen=True, eq=False)
class FilterPrior:
    """A penalty on the answers of filters, sparse in groups.

    Parameters
    ----------
    contrast : float
        Unit c of differences, full-scale units.
    groups : sequence of FilterGroup
    exponent : float
        p of the penalty, 0 < p <= 2: 0.5 is the sparsity of [1]_, 1 makes it convex, 2 quadratic.

    Notes
    -----
    With groups g of filters w_gk,

        R(f) = sum_x sum_g a_g (u_g^p - e_g^p) / p,
        u_g^2 = e_g^2 + mean_(5 x 5 around x) sum_k (w_gk * f / c)^2.

    From [1]_ are the sparsity p and the adaptive weights u^(p-2), which are shared by neighbours
    here: an edge or a finger is a structure, not a single pixel, while noise is not. R is concave
    in the squares of the answers: the quadratic with the weights of f touches R at f and lies above
    it everywhere.
    """

    contrast: float
    groups: Sequence[FilterGroup]
    exponent: float = 1.0

    def objective(self, image: Image) -> float:
        """R(f), summed in float64."""
        total, p = 0.0, self.exponent
        for group in self.groups:
            u2 = self._squares(image, group).astype(np.float64)
            total += group.weight * float((u2 ** (p / 2) - group.smoothing**p).sum()) / p
        return total

    def majoriser(self, image: Image, factor: float = 1.0) -> FilterBank:
        """Quadratic f' L f / 2 that touches ``factor * R`` at the image up to a constant.

        Parameters
        ----------
        image : (height, width)
        factor : float

        Returns
        -------
        FilterBank
            L; ``L.apply(image)`` is the gradient.
        """
        weights = []
        for group in self.groups:
            u2 = self._squares(image, group)
            # NumPy knows the square root, but no other power, in vector instructions.
            v = _mean(u2 ** (self.exponent / 2) / u2)
            v *= v.dtype.type(factor * group.weight / self.contrast**2)
            weights.append(_without_border(v, group.reach))
        return FilterBank(self.groups, weights)

    def continued(self, _image: Image, _rounds: int, /) -> Self:
        """Return itself."""
        return self

    def _squares(self, image: Image, group: FilterGroup) -> Image:
        """u_g^2 of the notes."""
        energy = np.zeros_like(image)

        def fill(first: int) -> None:
            last = min(first + _BAND_ROWS, image.shape[0])
            start = max(first - group.reach, 0)
            f = image[start : last + group.reach]
            for w in group.filters / self.contrast:
                energy[first:last] += _answer(f, w)[first - start : last - start] ** 2

        parallel_map(fill, _bands(image))
        return _mean(_without_border(energy, group.reach)) + image.dtype.type(group.smoothing**2)


def sparse_curvature(
    contrast: float, smoothing: float = 0.75, exponent: float = 0.5
) -> FilterPrior:
    """Return a group-sparse penalty on the second differences of an image.

    Parameters
    ----------
    contrast : float
        Unit of differences, full-scale units.
    smoothing : float
        Curvature below which the norm is rounded off, units of the contrast.
    exponent : float
        See `FilterPrior`.

    Notes
    -----
    Second differences [2]_, because cells are smooth shading with fine lines rather than flat
    patches: the spectrum of their images falls with the fifth power of the frequency and more.
    First differences with the same penalty turn texture into steps, at the minimiser by 1 to 3 dB
    worse than their own squares.
    """
    return FilterPrior(contrast, [FilterGroup(_SECOND_DIFFERENCES, 1.0, smoothing)], exponent)


def learned_prior(contrast: float) -> FilterPrior:
    """Return the convex penalty with filters that were learnt from sharp pictures of cells.

    Parameters
    ----------
    contrast : float
        Unit of differences, full-scale units.

    Notes
    -----
    A norm of what is linear in f: R is convex, and with the data Eq. 7 has one minimiser, whatever
    the first image. Few filters learnt under convexity are the idea of [3]_, filters as experts
    that of [4]_. Mirrored and turned filters are in the same group, so that a module on its side
    costs the same.
    """
    return FilterPrior(contrast, _learned_groups())


@cache
def _learned_groups() -> tuple[FilterGroup, ...]:
    stored = json.loads(WEIGHTS.read_text(encoding="utf-8"))
    return tuple(
        FilterGroup(np.array(group["filters"]), group["weight"], group["smoothing"])
        for group in stored["groups"]
    )


def _bands(image: Image) -> range:
    return range(0, image.shape[0], _BAND_ROWS)


def _answer(image: Image, kernel: Array) -> Image:
    """Correlation with a kernel, zeros outside of the image."""
    return np.asarray(cv2.filter2D(image, -1, kernel, borderType=cv2.BORDER_CONSTANT), image.dtype)


def _adjoint(image: Image, kernel: Array) -> Image:
    """Adjoint of `_answer`."""
    return _answer(image, np.ascontiguousarray(kernel[::-1, ::-1]))


def _mean(image: Image) -> Image:
    """Mean over the neighbourhood, zeros outside of the image: a symmetric matrix."""
    mean = cv2.blur(image, (_SHARED, _SHARED), borderType=cv2.BORDER_CONSTANT)
    # Sums that slide over the image may leave zero by rounding.
    return np.maximum(np.asarray(mean, image.dtype), 0)


def _without_border(image: Image, width: int) -> Image:
    """Set the border to 0 in place."""
    image[:width] = 0
    image[-width:] = 0
    image[:, :width] = 0
    image[:, -width:] = 0
    return image
