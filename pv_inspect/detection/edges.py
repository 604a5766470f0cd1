"""Positions of the gaps between cells, measured on profiles across them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.robust import MAD_TO_SIGMA
from pv_inspect.detection.gap_model import (
    BESIDE,
    GAP_SHAPES,
    STEP_PX,
    GapShape,
    best_shape,
    fit_gaps,
    fit_steps,
    missing_light,
)
from pv_inspect.detection.gap_width import (
    SIDES_APART_PX,
    UNSURE_WIDTH,
    gap_width,
    width_between_sides,
)
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose

__all__ = [
    "CellEdges",
    "EdgeOffsets",
    "cell_edges",
    "edge_profiles",
    "measure_edges",
    "measure_gaps_robustly",
    "scales_px",
]

Array = NDArray[np.float64]

ALONG = np.linspace(0.2, 0.8, 13)
"""Where along an edge the profile is averaged: the cut corners of mono cells stay outside."""
ALONG_DENSELY = np.linspace(0.15, 0.85, 25)
CLEAN_PERCENTILE = 25.0
"""Of the widths of the gaps: so wide is one between cells that are bright up to their edges."""
UNEVEN = 1 / np.sqrt(12.0)
PLACE_SIGMA = 0.05
"""What a place along a clean gap is off, gap widths."""
ROBUST_ITERATIONS = 5
MOST_FRAMES_PER_UNIT = 4
"""A pose by which a cell is larger than so many frames has failed."""


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
    gap : (n,) float64
        By how much the gap at the edge is wider than a usual one, module units.
    """

    middle: Array
    normal: Array
    along: Array
    crossings: NDArray[np.int64]
    inner: NDArray[np.bool_]
    side: NDArray[np.int64]
    gap: Array

    def part(self, which: NDArray[np.bool_]) -> CellEdges:
        """Return some of the edges."""
        return CellEdges(*(getattr(self, field.name)[which] for field in fields(self)))


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

    @classmethod
    def together(
        cls, n: int, parts: Iterable[tuple[NDArray[np.bool_], EdgeOffsets]]
    ) -> EdgeOffsets:
        """Put the offsets of groups of edges, each with the mask of its edges, into one."""
        nothing = np.zeros(n, bool)
        whole = cls(np.full(n, np.nan), np.full(n, np.inf), nothing, nothing.copy())
        for mask, part in parts:
            for name in ("offset", "sigma", "found", "visible"):
                getattr(whole, name)[mask] = getattr(part, name)
        return whole


def cell_edges(layout: ModuleLayout) -> CellEdges:
    """List the edges of all cells: first those along y, then those along x."""
    rows, cols, heights, widths = layout.rows, layout.cols, layout.heights, layout.widths
    wide_x, wide_y = _gap_widths(layout)
    i, j = (a.ravel() for a in np.mgrid[0:rows, 0 : cols + 1])
    upright = (
        np.column_stack([layout.col_lines[j], layout.row_starts[i] + 0.5 * heights[i]]),
        np.tile([1.0, 0.0], (i.size, 1)),
        np.column_stack([np.zeros(i.size), heights[i]]),
        np.column_stack([i * (cols + 1) + j, (i + 1) * (cols + 1) + j]),
        (j > 0) & (j < cols),
        np.where(j == 0, 1, -1),
        wide_x[j],
    )
    i, j = (a.ravel() for a in np.mgrid[0 : rows + 1, 0:cols])
    level = (
        np.column_stack([layout.col_starts[j] + 0.5 * widths[j], layout.row_lines[i]]),
        np.tile([0.0, 1.0], (i.size, 1)),
        np.column_stack([widths[j], np.zeros(i.size)]),
        np.column_stack([i * (cols + 1) + j, i * (cols + 1) + j + 1]),
        (i > 0) & (i < rows),
        np.where(i == 0, 1, -1),
        wide_y[i],
    )
    return CellEdges(*(np.concatenate(pair) for pair in zip(upright, level, strict=True)))


def _gap_widths(layout: ModuleLayout) -> tuple[Array, Array]:
    """How much wider than usual the gaps are at the upright and the level lines."""
    across = np.full(layout.cols + 1, layout.cell_gap[0])
    down = np.full(layout.rows + 1, layout.cell_gap[1])
    for widths, gaps in ((across, layout.col_gaps), (down, layout.row_gaps)):
        for after, gap in gaps:
            widths[after] += gap
    return across, down


def measure_edges(
    image: NDArray[np.float32],
    edges: CellEdges,
    pose: Pose,
    search: float,
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
    A profile across an inner edge is modelled as two levels L, R and a gap of width w and level G
    between them, blurred by a Gaussian of standard deviation s. With x the distance from the gap,

        p(x) = L (1 - A) + G (A - B) + R B,   A = Phi((x + w/2) / s),  B = Phi((x - w/2) / s),

    which is linear in L, R, G. The place with the most significant (L + R) / 2 - G > 0 is refined
    by Gauss-Newton. An outer edge is measured as a step alone: it lies half a gap inside of the
    cell's pitch. Gaps that are wider than the usual ones have that much larger w. Where all gaps
    are, and their sides are clearly apart, w is what is seen between the sides.
    """
    groups = ((edges.gap == gap, float(gap)) for gap in np.unique(edges.gap))
    return EdgeOffsets.together(
        len(edges.middle),
        (
            (alike, _measure_alike(image, edges.part(alike), pose, search, gap))
            for alike, gap in groups
        ),
    )


def _measure_alike(
    image: NDArray[np.float32], edges: CellEdges, pose: Pose, search: float, gap_units: float
) -> EdgeOffsets:
    """Measure edges whose gaps are wider than usual by the same width."""
    # Image pixels per module unit; everything below is in image pixels.
    scales = scales_px(edges, pose)
    scale = float(np.nanmedian(scales)) if np.isfinite(scales).any() else np.inf
    if not scale < MOST_FRAMES_PER_UNIT * max(image.shape):
        return EdgeOffsets.together(len(edges.middle), ())
    wider = gap_units * scale
    usual = search * scale + max(shape.reach for shape in GAP_SHAPES) + 2 * STEP_PX
    x = _distances(usual + (0.5 + UNSURE_WIDTH) * wider)
    search_px = max(search * scale, STEP_PX)
    samples, visible = edge_profiles(image, edges, pose, x / scale, ALONG)
    profiles = samples.mean(axis=1)
    around, at_cell = profiles, x
    if wider:
        # Half of a wide gap lies outside of the module, perhaps outside of the frame.
        at_cell = _distances(usual)
        moved = edges.middle + (0.5 * gap_units * edges.side)[:, None] * edges.normal
        samples, seen = edge_profiles(
            image, replace(edges, middle=moved), pose, at_cell / scale, ALONG
        )
        around = samples.mean(axis=1)
        visible = np.where(edges.inner, visible, seen)
    place = np.full(len(profiles), np.nan)
    sigma = np.full(len(profiles), np.inf)
    found = np.zeros(len(profiles), bool)
    shapes = [GAP_SHAPES[0], GAP_SHAPES[0]]
    widths = [wider, wider]
    for axis in range(2):
        inner = visible & edges.inner & (edges.normal[:, axis] == 1)
        if inner.any():
            shapes[axis] = best_shape(profiles[inner], x, search_px, wider)
            if wider > SIDES_APART_PX and not edges.inner.all():
                widths[axis] = width_between_sides(profiles[inner], x, search_px, wider)
                shapes[axis] = shapes[axis].widened(widths[axis] - shapes[axis].width)
            place[inner], sigma[inner], found[inner] = fit_gaps(
                profiles[inner], x, search_px, shapes[axis]
            )
    with np.errstate(invalid="ignore"):
        found &= np.abs(place) <= search_px
    for axis in range(2):
        across = edges.normal[:, axis] == 1
        outer, inner = visible & ~edges.inner & across, found & edges.inner & across
        if not outer.any() or (edges.inner.any() and not found.any()):
            continue
        # Gaps between rows and between columns may differ in width.
        gaps = inner if inner.any() else found & edges.inner
        gap = widths[axis] - wider
        if not wider and gaps.any():
            gap = gap_width(profiles[gaps], x, place[gaps], shapes[axis])
        turn = edges.side[outer] < 0
        flipped = np.where(turn[:, None], around[outer][:, ::-1], around[outer])
        step, deviation, good = fit_steps(flipped, at_cell, search_px)
        place[outer] = np.where(turn, -1, 1) * (step - gap / 2)
        sigma[outer] = np.hypot(deviation, 0.25 * abs(gap) + 0.1)
        found[outer] = good
    return EdgeOffsets(np.where(found, place / scale, np.nan), sigma / scale, found, visible)


def _distances(reach: float) -> Array:
    """Places of the samples of a profile, image pixels from its middle."""
    half = int(np.ceil(reach / STEP_PX))
    return STEP_PX * np.arange(-half, half + 1, dtype=np.float64)


def measure_gaps_robustly(
    image: NDArray[np.float32], edges: CellEdges, pose: Pose, search: float, shape: GapShape
) -> EdgeOffsets:
    """Measure the inner edges of a picture that is nearly free of noise, place by place.

    Every gap is fitted at many places along it and the places are combined by a robust mean: a
    crack or a dark cluster beside the gap then spoils some places, not the whole edge.

    Parameters
    ----------
    image : (height, width) float32
    edges : CellEdges
    pose : Pose
        Right to about `search`.
    search : float
        Half width of the search, module units.
    shape : GapShape
        Image of a gap, image pixels.

    Returns
    -------
    EdgeOffsets
        Outer edges are never found.

    Notes
    -----
    Many cells are darker at their edges, within less than a pixel and not alike on both sides. This
    widens what is seen of a gap and moves its middle: if two margins share the excess width e in
    any proportion with equal probability, the middle is off by e / sqrt(12). Places and gaps that
    are wider than the clean ones of their direction therefore count less.
    """
    groups = ((edges.gap == gap, float(gap)) for gap in np.unique(edges.gap))
    return EdgeOffsets.together(
        len(edges.middle),
        (
            (alike, _measure_alike_robustly(image, edges.part(alike), pose, search, shape, gap))
            for alike, gap in groups
        ),
    )


def _measure_alike_robustly(
    image: NDArray[np.float32],
    edges: CellEdges,
    pose: Pose,
    search: float,
    usual: GapShape,
    gap_units: float,
) -> EdgeOffsets:
    """Measure edges whose gaps are wider than usual by the same width."""
    scale = float(np.nanmedian(scales_px(edges, pose)))
    wider = gap_units * scale
    widened = usual.widened(wider)
    x = _distances(search * scale + BESIDE * widened.reach + 2 * STEP_PX)
    samples, visible = edge_profiles(image, edges, pose, x / scale, ALONG_DENSELY)
    n, places = samples.shape[:2]
    place, dark = np.full((n, places), np.nan), np.full((n, places), np.nan)
    for axis in range(2):
        along = visible & edges.inner & (edges.normal[:, axis] == 1)
        if not along.any():
            continue
        shape = widened
        if wider > SIDES_APART_PX and not edges.inner.all():
            typical = np.median(samples[along], axis=1)
            width = width_between_sides(typical, x, search * scale, wider)
            shape = widened.widened(width - widened.width)
        profiles = samples[along].reshape(-1, len(x))
        at, _, found = fit_gaps(profiles, x, search * scale, shape)
        dark[along] = missing_light(profiles, x, at, shape.reach).reshape(-1, places)
        place[along] = np.where(found, at, np.nan).reshape(-1, places)
    # Where one side of a gap is black, how wide the gap is can't be told.
    known = np.isfinite(place) & np.isfinite(dark)
    good = visible & edges.inner & (known.sum(axis=1) > places // 2)
    sigma = np.full((n, places), np.inf)
    for axis in range(2):
        along = good & (edges.normal[:, axis] == 1)
        if along.any():
            clean = np.percentile(np.nanmedian(dark[along], axis=1), CLEAN_PERCENTILE)
            sigma[along] = np.hypot(PLACE_SIGMA * usual.width, UNEVEN * (dark[along] - clean))
    mean, sigma = _robust_means(place[good], sigma[good])
    offset, deviation = np.full(n, np.nan), np.full(n, np.inf)
    offset[good], deviation[good] = mean / scale, sigma / scale
    return EdgeOffsets(offset, deviation, good, visible)


def _robust_means(values: Array, sigma: Array) -> tuple[Array, Array]:
    """Mean of each row with Cauchy weights, and the usual standard deviation of its values.

    What is not finite is left out. Neighbouring places are uneven alike, so that their number does
    not make the mean better.
    """
    known = np.isfinite(values) & np.isfinite(sigma)
    precision = np.where(known, 1 / np.square(sigma), 0.0)
    filled = np.where(known, values, 0.0)
    mean = np.nanmedian(values, axis=1)
    for _ in range(ROBUST_ITERATIONS):
        distance = np.abs(filled - mean[:, None]) * np.sqrt(precision)
        usual = MAD_TO_SIGMA * np.nanmedian(np.where(known, distance, np.nan), axis=1)
        weight = precision / (1 + np.square(distance / (usual[:, None] + 0.3)))
        mean = (weight * filled).sum(axis=1) / weight.sum(axis=1)
    return mean, 1 / np.sqrt(precision.mean(axis=1))


def scales_px(edges: CellEdges, pose: Pose) -> Array:
    """LR pixels per module unit at each edge, (n,)."""
    jacobian = pose.camera.jacobian(pose.homography, edges.middle)
    with np.errstate(invalid="ignore"):  # NaN beyond the fold of the lens
        return np.asarray(np.sqrt(np.abs(np.linalg.det(jacobian))), np.float64)


def edge_profiles(
    image: NDArray[np.float32], edges: CellEdges, pose: Pose, d: Array, along: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Sample the image across each edge at several places along it: (n, places, distances)."""
    height, width = image.shape
    points = (
        edges.middle[:, None, None]
        + (along - 0.5)[None, :, None, None] * edges.along[:, None, None]
        + d[None, None, :, None] * edges.normal[:, None, None]
    )
    pixels = pose.project(points.reshape(-1, 2)).reshape(points.shape)
    lookup = np.nan_to_num(pixels, nan=-1e4).astype(np.float32)
    inside = np.all((lookup >= 0) & (lookup <= [width - 1, height - 1]), axis=-1)
    flat = lookup.reshape(-1, len(d) * len(along), 2)
    values = cv2.remap(
        image, flat[..., 0], flat[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    ).reshape(inside.shape)
    return values.astype(np.float64), inside.all(axis=(1, 2))
