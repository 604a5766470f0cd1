"""The image of a gap between two cells on profiles across it, and its fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

__all__ = [
    "BESIDE",
    "CORRELATED",
    "GAP_ITERATIONS",
    "GAP_SHAPES",
    "MIN_DEPTH",
    "MIN_SIGNIFICANCE",
    "STEP_BLUR_PX",
    "STEP_PX",
    "STEP_REACH_PX",
    "GapShape",
    "best_shape",
    "fit_gaps",
    "fit_steps",
    "gap_basis",
    "missing_light",
]

Array = NDArray[np.float64]


STEP_PX = 0.25


BESIDE = 1.85
"""The cells beside a gap are judged between the reach of its fit and so many times the reach."""


MIN_SIGNIFICANCE = 4.0


MIN_DEPTH = 0.04


CORRELATED = 3.0


GAP_ITERATIONS = 4


STEP_BLUR_PX = 0.8


STEP_REACH_PX = 3.5


@dataclass(frozen=True)
class GapShape:
    """Image of a gap, in pixels: blur, width, and how far from it the model is fitted.

    Close to the gap the cells are taken as uniform; many are darker towards their edges, so a
    sharp picture is fitted only nearby.
    """

    blur: float
    width: float
    reach: float

    def scaled(self, factor: float) -> GapShape:
        """Return the shape in an image with `factor` times as many pixels per length."""
        return GapShape(self.blur * factor, self.width * factor, self.reach * factor)

    def widened(self, by: float) -> GapShape:
        """Return the shape of a gap that is so many pixels wider."""
        return GapShape(self.blur, self.width + by, self.reach + by / 2)


GAP_SHAPES = (
    GapShape(0.6, 1.3, 1.75),
    GapShape(0.65, 1.0, 3.5),
    GapShape(1.0, 1.0, 3.5),
    GapShape(1.6, 1.0, 4.0),
)
"""What is tried: sharp, sharp but noisy, soft, blurred by motion; LR pixels."""


def missing_light(profiles: Array, x: Array, place: Array, reach: float) -> Array:
    """Width of a wholly dark gap that would take as much light, image pixels; NaN if unknown."""
    t = np.abs(x - place[:, None])
    turn = x < place[:, None]
    beside = (t > reach) & (t < BESIDE * reach)
    with np.errstate(invalid="ignore", divide="ignore"):
        left, right = (
            np.where(side, profiles, 0).sum(axis=1) / side.sum(axis=1)
            for side in (beside & turn, beside & ~turn)
        )
        level = np.where(turn, left[:, None], right[:, None])
        missing = np.where(t <= reach, 1 - profiles / level, 0).sum(axis=1) * STEP_PX
    return np.where((left > 0) & (right > 0), missing, np.nan)


def _windows(profiles: Array, x: Array, search: float, reach: float) -> tuple[Array, Array, Array]:
    """Cut the part within `reach` of every candidate place out of each profile.

    Returns the candidates (k,), the distances (m,) within a part, and the parts (n, k, m).
    """
    step = float(x[1] - x[0])
    candidates = np.flatnonzero(np.abs(x) <= search)
    half = min(int(reach / step), int(candidates[0]))
    first, last = candidates[0] - half, candidates[-1] + half + 1
    parts = np.lib.stride_tricks.sliding_window_view(profiles[:, first:last], 2 * half + 1, axis=1)
    distance: Array = step * np.arange(-half, half + 1, dtype=np.float64)
    return x[candidates], distance, parts


def gap_basis(x: Array, shape: GapShape) -> tuple[Array, Array]:
    """Blurred level on the left, on the right and in the gap, and their slopes: (..., 3) each."""
    t_left = (x + shape.width / 2) / shape.blur
    t_right = (x - shape.width / 2) / shape.blur
    left, right = ndtr(t_left), ndtr(t_right)
    basis = np.stack([1 - left, right, left - right], axis=-1)
    bell_left, bell_right = (
        np.exp(-0.5 * t**2) / (np.sqrt(2 * np.pi) * shape.blur) for t in (t_left, t_right)
    )
    # d / dc, with x = d - c.
    slopes = np.stack([bell_left, -bell_right, bell_right - bell_left], axis=-1)
    return basis, slopes


def _search(
    profiles: Array, x: Array, search: float, shape: GapShape
) -> tuple[Array, Array, Array, Array]:
    """Significance of a gap at every candidate place, (n, k), with `_windows`."""
    candidates, distance, parts = _windows(profiles, x, search, shape.reach)
    basis, _ = gap_basis(distance, shape)
    inverse = np.linalg.pinv(basis)
    levels = parts @ inverse.T
    residual = np.square(parts - levels @ basis.T).mean(axis=-1)
    depth = levels[..., :2].mean(axis=-1) - levels[..., 2]
    spread = np.square(0.5 * (inverse[0] + inverse[1]) - inverse[2]).sum()
    # Samples are 0.25 px apart and interpolated: about one in three is independent.
    significance = depth / np.sqrt(CORRELATED * residual * spread + 1e-14)
    level = np.maximum(levels[..., :2].min(axis=-1), 1e-6)
    shallow = level - levels[..., 2] < MIN_DEPTH * level
    return candidates, distance, parts, np.where(shallow, 0.0, significance)


def best_shape(profiles: Array, x: Array, search: float, wider: float = 0.0) -> GapShape:
    """Return the shape that most profiles fit, for gaps that are wider by so many pixels."""
    shapes = [shape.widened(wider) for shape in GAP_SHAPES]
    scores = [float(np.median(_search(profiles, x, search, s)[3].max(axis=1))) for s in shapes]
    return shapes[int(np.argmax(scores))]


def fit_gaps(
    profiles: Array, x: Array, search: float, shape: GapShape
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Place of the gap, its standard deviation, and whether it is significant."""
    candidates, distance, parts, significance = _search(profiles, x, search, shape)
    n = len(profiles)
    best = significance.argmax(axis=1)
    start = candidates[best]
    part = parts[np.arange(n), best]
    centre = np.zeros(n)
    for _ in range(GAP_ITERATIONS):
        basis, slopes = gap_basis(distance - centre[:, None], shape)
        levels = _least_squares(basis, part)
        slope = np.einsum("nmk,nk->nm", slopes, levels)
        design = np.concatenate([basis, slope[..., None]], axis=-1)
        solution = _least_squares(design, part)
        centre += np.clip(solution[:, 3], -shape.blur, shape.blur)
    residual = np.square(part - np.einsum("nmk,nk->nm", design, solution)).mean(axis=1)
    covariance = np.linalg.inv(_gram(design))[:, 3, 3]
    significant = significance[np.arange(n), best] > MIN_SIGNIFICANCE
    found = significant & (np.abs(centre) <= 3 * shape.blur)
    sigma: Array = np.where(found, np.sqrt(CORRELATED * residual * np.abs(covariance)), np.inf)
    return np.where(found, start + centre, np.nan), sigma, found


def _gram(design: Array) -> Array:
    """Normal matrices of many small problems, with a ridge that only matters if one is singular."""
    gram = np.einsum("nmi,nmj->nij", design, design)
    trace = np.trace(gram, axis1=1, axis2=2)
    return np.asarray(gram + 1e-10 * (trace[:, None, None] + 1e-30) * np.eye(gram.shape[-1]))


def _least_squares(design: Array, values: Array) -> Array:
    right = np.einsum("nmi,nm->ni", design, values)
    return np.asarray(np.linalg.solve(_gram(design), right[..., None])[..., 0])


def fit_steps(profiles: Array, x: Array, search: float) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Place of a dark-to-bright step along +x, its standard deviation, and whether it is there."""
    candidates, distance, parts = _windows(profiles, x, search, STEP_REACH_PX)
    step = ndtr(distance / STEP_BLUR_PX)
    basis = np.column_stack([1 - step, step])
    levels = parts @ np.linalg.pinv(basis).T
    height = levels[..., 1] - levels[..., 0]
    noise = (parts - levels @ basis.T).std(axis=-1)
    score = height / np.sqrt(noise**2 + (0.02 * np.abs(height).max()) ** 2)
    best = score.argmax(axis=1)
    inside = (best > 0) & (best < len(candidates) - 1)
    rows = np.arange(len(best))
    around = np.clip(best[:, None] + np.array([-1, 0, 1]), 0, len(candidates) - 1)
    left, middle, right = (score[rows, around[:, k]] for k in range(3))
    curvature = left - 2 * middle + right
    shift = np.where(curvature < 0, 0.5 * (left - right) / np.minimum(curvature, -1e-12), 0.0)
    step_size = candidates[1] - candidates[0] if len(candidates) > 1 else 0.0
    place = candidates[best] + np.clip(shift, -1, 1) * step_size
    top, rest = height[rows, best], noise[rows, best]
    sigma = STEP_BLUR_PX * np.sqrt(2 * np.pi) * rest / np.maximum(top, 1e-9)
    return place, sigma, inside & (top > 4 * rest)
