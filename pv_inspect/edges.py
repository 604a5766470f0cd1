"""Positions of the gaps between cells, measured on profiles across them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from pv_inspect.layout import ModuleLayout
from pv_inspect.outline import Pose

__all__ = ["CellEdges", "EdgeOffsets", "cell_edges", "measure_edges"]

Array = NDArray[np.float64]

ALONG = np.linspace(0.2, 0.8, 13)
"""Where along an edge the profile is averaged: the cut corners of mono cells stay outside."""
STEP_PX = 0.25
BLUR_PX = (0.65, 1.0, 1.6)
"""Standard deviations of the gap's image that are tried: sharp, soft, blurred by motion."""
FIT_PX = 3.5
MIN_SIGNIFICANCE = 4.0
MIN_DEPTH = 0.04
CORRELATED = 3.0
LINE_ITERATIONS = 4


@dataclass(frozen=True)
class CellEdges:
    """The sides of all cells.

    Parameters
    ----------
    middle : (n, 2) float64
        Middle of the edge in the module plane.
    normal, along : (n, 2) float64
        Unit vector across the edge (pointing to +x or +y), and the edge itself from end to end.
    crossings : (n, 2) int64
        Indices of the crossing points at its two ends.
    inner : (n,) bool
        Whether cells lie on both sides.
    side : (n,) int64
        For outer edges: +1 if the module lies on the positive side of the normal, else -1.
    """

    middle: Array
    normal: Array
    along: Array
    crossings: NDArray[np.int64]
    inner: NDArray[np.bool_]
    side: NDArray[np.int64]


@dataclass(frozen=True)
class EdgeOffsets:
    """Measured offsets of the edges from where a pose expects them.

    Parameters
    ----------
    offset, sigma : (n,) float64
        Along the normal, module units.
    found : (n,) bool
        Whether the gap is significant.
    visible : (n,) bool
        Whether the frame shows the place at all.
    """

    offset: Array
    sigma: Array
    found: NDArray[np.bool_]
    visible: NDArray[np.bool_]


def cell_edges(layout: ModuleLayout) -> CellEdges:
    """List the edges of all cells: first those along y, then those along x."""
    rows, cols, height = layout.rows, layout.cols, 1.0 / layout.cell_aspect
    i, j = (a.ravel() for a in np.mgrid[0:rows, 0 : cols + 1])
    upright = (
        np.column_stack([j, (i + 0.5) * height]).astype(float),
        np.tile([1.0, 0.0], (i.size, 1)),
        np.tile([0.0, height], (i.size, 1)),
        np.column_stack([i * (cols + 1) + j, (i + 1) * (cols + 1) + j]),
        (j > 0) & (j < cols),
        np.where(j == 0, 1, -1),
    )
    i, j = (a.ravel() for a in np.mgrid[0 : rows + 1, 0:cols])
    level = (
        np.column_stack([j + 0.5, i * height]).astype(float),
        np.tile([0.0, 1.0], (i.size, 1)),
        np.tile([1.0, 0.0], (i.size, 1)),
        np.column_stack([i * (cols + 1) + j, i * (cols + 1) + j + 1]),
        (i > 0) & (i < rows),
        np.where(i == 0, 1, -1),
    )
    return CellEdges(*(np.concatenate(pair) for pair in zip(upright, level, strict=True)))


def measure_edges(
    image: NDArray[np.float32], edges: CellEdges, pose: Pose, search: float
) -> EdgeOffsets:
    """Measure where the gaps lie relative to a pose.

    Parameters
    ----------
    image : (height, width) float32
    edges : CellEdges
    pose : Pose
        Right to about `search`.
    search : float
        Half width of the search, module units.

    Returns
    -------
    EdgeOffsets

    Notes
    -----
    A profile p(d) across an inner edge is modelled as a step plus a dark line at the same place,
    p(d) = L (1 - Phi(t)) + R Phi(t) - b exp(-t^2 / 2), t = (d - c) / s, linear in L, R, b. The
    place c with the most significant b > 0 is refined by Gauss-Newton. An outer edge is measured
    as a step alone: it lies half a gap inside of the cell's pitch.
    """
    scale = _scale_px(edges, pose)
    reach = search + (FIT_PX + 2 * STEP_PX) / float(np.nanmedian(scale))
    step = STEP_PX / float(np.nanmedian(scale))
    half = int(np.ceil(reach / step))
    d = step * np.arange(-half, half + 1)
    profiles, visible = _profiles(image, edges, pose, d)
    offset = np.full(len(profiles), np.nan)
    sigma = np.full(len(profiles), np.inf)
    depth = np.zeros(len(profiles))
    px = step / STEP_PX
    for axis in range(2):
        inner = visible & edges.inner & (edges.normal[:, axis] == 1)
        if not inner.any():
            continue
        blur = _best_blur(profiles[inner], d, search, px)
        offset[inner], sigma[inner], depth[inner] = _fit_lines(
            profiles[inner], d, search, blur * px, FIT_PX * px
        )
    with np.errstate(invalid="ignore"):
        found = visible & (depth > 0) & (np.abs(offset) <= search)
    outer = visible & ~edges.inner
    if outer.any() and found.any():
        flipped = profiles[outer].copy()
        turn = edges.side[outer] < 0
        flipped[turn] = flipped[turn][:, ::-1]
        gap = _gap_width(profiles[found], d, offset[found], px)
        place, deviation, good = _fit_steps(flipped, d, search, 0.8 * px, FIT_PX * px)
        offset[outer] = np.where(turn, -1, 1) * (place - gap / 2)
        sigma[outer] = np.hypot(deviation, 0.25 * gap + 0.1 * px)
        found[outer] = good
    return EdgeOffsets(np.where(found, offset, np.nan), sigma, found, visible)


def _scale_px(edges: CellEdges, pose: Pose) -> Array:
    jacobian = pose.camera.jacobian(pose.homography, edges.middle)
    return np.asarray(np.sqrt(np.abs(np.linalg.det(jacobian))))


def _profiles(
    image: NDArray[np.float32], edges: CellEdges, pose: Pose, d: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Average the image along each edge, for every distance d across it."""
    height, width = image.shape
    points = (
        edges.middle[:, None, None]
        + (ALONG - 0.5)[None, :, None, None] * edges.along[:, None, None]
        + d[None, None, :, None] * edges.normal[:, None, None]
    )
    pixels = pose.project(points.reshape(-1, 2)).reshape(points.shape)
    lookup = np.nan_to_num(pixels, nan=-1e4).astype(np.float32)
    inside = np.all((lookup >= 0) & (lookup <= [width - 1, height - 1]), axis=-1)
    flat = lookup.reshape(-1, len(d) * len(ALONG), 2)
    values = cv2.remap(
        image, flat[..., 0], flat[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    ).reshape(inside.shape)
    return values.mean(axis=1).astype(np.float64), inside.all(axis=(1, 2))


def _windows(profiles: Array, d: Array, search: float, reach: float) -> tuple[Array, Array, Array]:
    """Cut the part within `reach` of every candidate place out of each profile.

    Returns the candidates (k,), the distances (m,) within a part, and the parts (n, k, m).
    """
    step = float(d[1] - d[0])
    candidates = np.flatnonzero(np.abs(d) <= search)
    half = min(int(reach / step), int(candidates[0]))
    first, last = candidates[0] - half, candidates[-1] + half + 1
    parts = np.lib.stride_tricks.sliding_window_view(profiles[:, first:last], 2 * half + 1, axis=1)
    return d[candidates], step * np.arange(-half, half + 1), parts


def _line_basis(t: Array) -> Array:
    """Level on the left, level on the right, dark line: (..., 3) for distances t in blurs."""
    step = ndtr(t)
    return np.stack([1 - step, step, np.exp(-0.5 * t**2)], axis=-1)


def _search(
    profiles: Array, d: Array, search: float, blur: float, reach: float
) -> tuple[Array, Array, Array, Array]:
    """Significance of a dark line at every candidate place, (n, k), with `_windows`."""
    candidates, distance, parts = _windows(profiles, d, search, reach)
    basis = _line_basis(distance / blur)
    inverse = np.linalg.pinv(basis)
    coefficients = parts @ inverse.T
    residual = np.square(parts - coefficients @ basis.T).mean(axis=-1)
    # Samples are 0.25 px apart and interpolated: about one in three is independent.
    variance = CORRELATED * residual * (inverse[2] ** 2).sum() + 1e-14
    significance = -coefficients[..., 2] / np.sqrt(variance)
    level = np.maximum(coefficients[..., :2].min(axis=-1), 1e-6)
    significance[-coefficients[..., 2] < MIN_DEPTH * level] = 0
    return candidates, distance, parts, significance


def _best_blur(profiles: Array, d: Array, search: float, px: float) -> float:
    scores = [
        float(np.median(_search(profiles, d, search, blur * px, FIT_PX * px)[3].max(axis=1)))
        for blur in BLUR_PX
    ]
    return BLUR_PX[int(np.argmax(scores))]


def _fit_lines(
    profiles: Array, d: Array, search: float, blur: float, reach: float
) -> tuple[Array, Array, Array]:
    """Offset, its standard deviation, and the depth of the dark line (0 where not significant)."""
    candidates, distance, parts, significance = _search(profiles, d, search, blur, reach)
    n = len(profiles)
    best = significance.argmax(axis=1)
    start = candidates[best]
    part = parts[np.arange(n), best]
    centre = np.zeros(n)
    for _ in range(LINE_ITERATIONS):
        t = (distance - centre[:, None]) / blur
        basis = _line_basis(t)
        levels = _least_squares(basis, part)
        bell = basis[..., 2]
        # dp/dc of the model at its present coefficients.
        slope = (
            (levels[:, 0] - levels[:, 1])[:, None] * bell / np.sqrt(2 * np.pi)
            + levels[:, 2, None] * t * bell
        ) / blur
        design = np.concatenate([basis, slope[..., None]], axis=-1)
        solution = _least_squares(design, part)
        centre += np.clip(solution[:, 3], -blur, blur)
    residual = np.square(part - np.einsum("nmk,nk->nm", design, solution)).mean(axis=1)
    covariance = np.linalg.inv(_gram(design))[:, 3, 3]
    significant = significance[np.arange(n), best] > MIN_SIGNIFICANCE
    good = significant & (np.abs(centre) <= 3 * blur)
    sigma = np.where(good, np.sqrt(CORRELATED * residual * np.abs(covariance)), np.inf)
    return np.where(good, start + centre, np.nan), sigma, np.where(good, -levels[:, 2], 0.0)


def _gram(design: Array) -> Array:
    """Normal matrices of many small problems, with a ridge that only matters if one is singular."""
    gram = np.einsum("nmi,nmj->nij", design, design)
    trace = np.trace(gram, axis1=1, axis2=2)
    return np.asarray(gram + 1e-10 * (trace[:, None, None] + 1e-30) * np.eye(gram.shape[-1]))


def _least_squares(design: Array, values: Array) -> Array:
    right = np.einsum("nmi,nm->ni", design, values)
    return np.asarray(np.linalg.solve(_gram(design), right[..., None])[..., 0])


def _fit_steps(
    profiles: Array, d: Array, search: float, blur: float, reach: float
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Place of a dark-to-bright step along +d, its standard deviation, and whether it is there."""
    candidates, distance, parts = _windows(profiles, d, search, reach)
    step = ndtr(distance / blur)
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
    sigma = blur * np.sqrt(2 * np.pi) * rest / np.maximum(top, 1e-9)
    return place, sigma, inside & (top > 4 * rest)


def _gap_width(profiles: Array, d: Array, offset: Array, px: float) -> float:
    """Width of a gap from its missing light, which blur does not change."""
    t = (d - offset[:, None]) / px
    beside = (np.abs(t) > 2.2) & (np.abs(t) <= 3.5)
    left, right = (
        np.where(side, profiles, 0).sum(axis=1) / np.maximum(side.sum(axis=1), 1)
        for side in (beside & (t < 0), beside & (t > 0))
    )
    good = (left > 0) & (right > 0)
    if not good.any():
        return 0.0
    level = np.where(t < 0, left[:, None], right[:, None])[good]
    missing = np.where(np.abs(t[good]) <= 2.2, 1 - profiles[good] / level, 0).sum(axis=1)
    return float(np.clip(np.median(missing) * (d[1] - d[0]), 0, 0.1))
