"""The grid of cells in a frame that shows a part of a module, right up to whole cells.

Without an outline there is nothing to start from but the lines themselves: in a window inside of
the bright area candidates for evenly spaced dark lines are found in two directions, and from there
the grid grows outwards cell by cell as long as its borders are in place.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.detection.edges import CellEdges, EdgeOffsets, cell_edges, measure_edges
from pv_inspect.detection.grid_check import IN_PLACE_PX, offsets_px
from pv_inspect.detection.line_profiles import along, line_profiles
from pv_inspect.detection.outline import (
    OutlineError,
    conventional_camera,
    solver_errors_as_reasons,
)
from pv_inspect.detection.pose_refinement import refined_pose
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose

__all__ = ["REACH", "GridOfPart", "bright_area", "grid_of_part", "plane_of"]

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

# No search for these constants is on record: they were set by hand on seeds 0 to 3 of
# `python benchmarks/partial_views.py`.

REACH = 30
"""Cells to all sides of the one that the grid grows from."""
WINDOW_SHARES = (0.6, 0.95)
"""Side of the window in which lines are sought, shares of the shorter side of the frame."""
MOST_TURNED_DEG, STEP_DEG = 24, 2
LEAST_CELL_PX, LEAST_LINES = 14, 2.2
LINE_REACH_PX = 3.0
MAX_STRETCH = 0.3
"""Logarithm; perspective changes the aspect of cells by up to 1.22 at 35 degrees."""
LEAST_SHARE_OF_DEPTH = 0.5
TRIED = 5
RINGS = (1.2, 2.2, 3.2, 4.2, 5.2, 7.2, 9.2, 12.2, 16.2, 22.2, 29.2)
"""Distances from the first cell to which the grid grows, cells."""
SEARCH_UNITS = 0.12
LEAST_IN_PLACE = 0.75
"""Share of the borders between bright cells, in the worse direction."""
LEAST_GAPS = 8
SURE_RING = 2.5
SAMPLES = 16
"""Per cell, where cells are compared."""
LEAST_CELLS = 3
WHOLLY = 0.97
PER_STRETCH, PER_CELL = 3.0, 0.3
"""How much an aspect that is off by a factor e, and a share of the cells, count in a likeness."""
BESIDE = 0.35
"""Cells beside a border that are looked at for light, cells."""


@dataclass(frozen=True)
class GridOfPart:
    """The grid that one frame shows.

    Parameters
    ----------
    pose : Pose
        Of a plane whose cell (`REACH`, `REACH`) is one of those that are seen.
    share : float
        Of the borders between bright cells that are in place, in the worse direction.
    """

    pose: Pose
    share: float


def plane_of(cell_aspect: float) -> ModuleLayout:
    """Return the layout in which grids of parts are described: so many cells to all sides."""
    return ModuleLayout(2 * REACH + 1, 2 * REACH + 1, cell_aspect)


def bright_area(image: Image) -> Mask:
    """Return what is brighter than the background, gaps closed."""
    smooth = cv2.GaussianBlur(image, (0, 0), 1.5)
    low, high = (float(v) for v in np.percentile(smooth, [1, 99]))
    scaled = (np.clip((smooth - low) / max(high - low, 1e-6), 0, 1) * 255).astype(np.uint8)
    threshold, _ = cv2.threshold(scaled, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    mask = (scaled > 0.5 * threshold).astype(np.uint8)
    size = max(3, min(image.shape) // 40) | 1
    return cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((size, size), np.uint8)) > 0


@solver_errors_as_reasons()
def grid_of_part(image: Image, cell_aspect: float) -> GridOfPart:
    """Find the grid of cells in a frame that may show a part of a module only.

    Parameters
    ----------
    image : (height, width) float32
    cell_aspect : float
        Cell width / cell height; rows run across the frame, give or take 24 degrees.

    Returns
    -------
    GridOfPart

    Raises
    ------
    OutlineError
        If no evenly spaced lines are seen both ways.
    """
    edges = cell_edges(plane_of(cell_aspect))
    bright = bright_area(image)
    best: tuple[float, GridOfPart] | None = None
    for start in _starts(image, bright, cell_aspect):
        grid = None
        with suppress(OutlineError):
            grid = _grown(image, bright, edges, start)
        score = -np.inf if grid is None else _likeness(image, bright, grid.pose, cell_aspect)
        if grid is not None and np.isfinite(score) and (best is None or score > best[0]):
            best = score, grid
    if best is None:
        raise OutlineError("no grid of cells is seen in the part of the module that it shows")
    return best[1]


def _starts(image: Image, bright: Mask, cell_aspect: float) -> Iterator[Pose]:
    """Yield poses of a flat grid in a window, what is likelier first."""
    height, width = image.shape
    inside = cv2.distanceTransform(
        cv2.copyMakeBorder(bright.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT),
        cv2.DIST_L2, 5,
    )[1:-1, 1:-1]  # fmt: skip
    row, col = np.unravel_index(int(inside.argmax()), inside.shape)
    centre = (float(col), float(row))
    camera = conventional_camera(image.shape)
    for share in WINDOW_SHARES:
        half = int(min(0.5 * share * min(height, width), 1.2 * inside.max()))
        across, down = (_lines(image, centre, half, upright) for upright in (True, False))
        pairs = [
            (one.score * other.score * np.exp(-2 * stretch), one, other)
            for one in across
            for other in down
            if (stretch := abs(np.log(one.period / other.period / cell_aspect))) < MAX_STRETCH
        ]
        pairs.sort(key=lambda pair: -pair[0])
        for _, one, other in pairs[:TRIED]:
            # The lines of both families: n . p = offset + k period.
            normals = np.array([one.normal, other.normal])
            steps = np.linalg.inv(normals) @ np.diag([one.period, other.period * cell_aspect])
            corner = np.linalg.solve(normals, [one.offset, other.offset])
            # The line nearest to the middle of the window is one of the first cell.
            k = np.floor(
                (normals @ np.array(centre) - [one.offset, other.offset])
                / [one.period, other.period]
            )
            corner = corner + steps @ ((k - REACH) / [1.0, cell_aspect])
            affine = np.vstack([np.column_stack([steps, corner]), [0, 0, 1]])
            yield Pose(camera, np.linalg.inv(camera.K) @ affine)


@dataclass(frozen=True)
class _Lines:
    """Evenly spaced dark lines: normal . p = offset + k period, pixels."""

    normal: Array
    offset: float
    period: float
    score: float


def _lines(image: Image, centre: tuple[float, float], half: int, upright: bool) -> list[_Lines]:
    """Find evenly spaced dark lines in a window, in the direction in which they are sharpest."""
    sharpest = -1.0
    profile, normal = np.zeros(0), np.zeros(2)
    steps = np.zeros(0)
    for degrees in range(-MOST_TURNED_DEG, MOST_TURNED_DEG + 1, STEP_DEG):
        turn = np.radians(degrees)
        x, y = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
        if not upright:
            x, y = y, -x
        # Columns of the window run along the lines.
        to_image = np.column_stack([x, y, centre - half * (x + y)]).astype(np.float32)
        size = (2 * half + 1, 2 * half + 1)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        window = np.asarray(
            cv2.warpAffine(image, to_image, size, flags=flags, borderMode=cv2.BORDER_REPLICATE),
            np.float32,
        )
        bands = line_profiles(window, 1.0)
        sharp = float(np.square(bands).mean())
        if sharp > sharpest:
            sharpest, normal = sharp, x
            profile, steps = along(bands, LINE_REACH_PX), _steps(window)
    return _combs(profile, steps, normal, float(normal @ centre) - half)


def _steps(window: Image) -> Array:
    """How much the brightness differs on both sides of each column: it does between two cells."""
    smooth = cv2.blur(window, (5, 3))
    padded = cv2.copyMakeBorder(smooth, 0, 0, 6, 6, cv2.BORDER_REPLICATE)
    one, other = padded[:, :-12], padded[:, 12:]
    change = (other - one) / np.maximum(other + one, 1e-4)
    bands = [np.abs(np.median(band, axis=0)) for band in np.array_split(change, 6)]
    return np.asarray(np.median(bands, axis=0), np.float64)


def _combs(profile: Array, steps: Array, normal: Array, origin: float) -> list[_Lines]:
    found = []
    for period in np.geomspace(LEAST_CELL_PX, len(profile) / LEAST_LINES, 60):
        scores = []
        phases = np.arange(0.0, period, 1.0)
        for phase in phases:
            at = np.arange(phase, len(profile) - 1, period).round().astype(int)
            depth = float(np.quantile(profile[at], 0.2))
            scores.append(depth * (1 + 4 * float(np.mean(steps[at]))))
        for k in range(len(scores)):
            around = [scores[(k + d) % len(scores)] for d in (-3, -2, -1, 1, 2, 3)]
            if scores[k] >= max(around):
                found.append(_Lines(normal, origin + phases[k], float(period), scores[k]))
    deepest = max((lines.score for lines in found), default=0.0)
    return [lines for lines in found if lines.score > LEAST_SHARE_OF_DEPTH * deepest]


def _grown(image: Image, bright: Mask, edges: CellEdges, start: Pose) -> GridOfPart:
    """Fit the grid to the borders around the first cell, then to those of more and more cells."""
    pose, share, count = start, 0.0, 0
    middle = edges.middle[edges.inner].mean(axis=0)
    away = (np.abs(edges.middle - middle) / np.abs(edges.along).max(axis=0)).max(axis=1)
    for ring in RINGS:
        part = edges.part((away < ring) & _in_view(pose, edges.middle, image.shape))
        offsets = measure_edges(image, part, pose, SEARCH_UNITS)
        pose = refined_pose(pose, part, offsets)
        offsets = measure_edges(image, part, pose, SEARCH_UNITS / 2)
        pose = refined_pose(pose, part, offsets)
        share, seen = _share(image.shape, bright, part, offsets, pose)
        if ring > SURE_RING and share < LEAST_IN_PLACE:
            raise OutlineError("the borders between cells are not in place")
        if seen == count and ring > SURE_RING:
            break
        count = seen
    if count < LEAST_GAPS:
        raise OutlineError("too few borders between cells are seen")
    return GridOfPart(pose, share)


def _in_view(pose: Pose, points: Array, shape: tuple[int, ...]) -> Mask:
    pixels = np.nan_to_num(pose.project(points), nan=-1e4)
    return np.asarray(np.all((pixels >= 0) & (pixels <= [shape[1] - 1, shape[0] - 1]), axis=1))


def _share(
    shape: tuple[int, ...], bright: Mask, edges: CellEdges, offsets: EdgeOffsets, pose: Pose
) -> tuple[float, int]:
    """Share of the borders that lie between bright places and are in place; number of such."""
    lit = offsets.visible.copy()
    for side in (-BESIDE, BESIDE):
        points = edges.middle + side * np.abs(edges.along[:, ::-1])
        lit &= _in_view(pose, points, shape)
        pixels = np.nan_to_num(pose.project(points)).round()
        x, y = np.clip(pixels, 0, [shape[1] - 1, shape[0] - 1]).astype(int).T
        lit &= bright[y, x]
    with np.errstate(invalid="ignore"):
        in_place = np.abs(offsets_px(edges, offsets, pose)) < IN_PLACE_PX
    shares = []
    for axis in range(2):
        across = lit & (edges.normal[:, axis] == 1)
        shares.append(float(in_place[across].mean()) if across.any() else 0.0)
    return min(shares), int(lit.sum())


def _likeness(image: Image, bright: Mask, pose: Pose, cell_aspect: float) -> float:
    """How much what lies in the meshes of a grid looks like cells; -inf if too few are seen.

    Cells are alike in their fine structure, but each is of its own brightness, to its very borders.
    Busbars taken for borders make meshes that are not, or of another aspect.
    """
    cells = np.arange(2 * REACH + 1) + 0.5
    x, y = (a.ravel() for a in np.meshgrid(cells, cells / cell_aspect))
    seen = _in_view(pose, np.column_stack([x, y]), image.shape)
    if seen.sum() < LEAST_CELLS:
        return -np.inf
    sampled = []
    for values in (x[seen] - 0.5, y[seen] * cell_aspect - 0.5):
        first, n = int(values.min()), int(values.max() - values.min()) + 1
        sampled.append(first + (np.arange(n * SAMPLES) + 0.5) / SAMPLES)
    points = np.stack(np.meshgrid(sampled[0], sampled[1] / cell_aspect), axis=-1)
    lookup = np.nan_to_num(pose.project(points.reshape(-1, 2)), nan=-1e4)
    lookup = lookup.reshape(points.shape).astype(np.float32)
    smooth = cv2.GaussianBlur(image, (0, 0), 1.0)
    grey, lit = (
        cv2.remap(picture, lookup[..., 0], lookup[..., 1], cv2.INTER_LINEAR)
        for picture in (smooth, bright.astype(np.float32))
    )
    n_y, n_x = (len(s) // SAMPLES for s in sampled[::-1])
    meshes, lights = (
        a.reshape(n_y, SAMPLES, n_x, SAMPLES).transpose(0, 2, 1, 3).reshape(-1, SAMPLES, SAMPLES)
        for a in (grey, lit)
    )
    meshes = meshes[lights.mean(axis=(1, 2)) > WHOLLY]
    n = len(meshes)
    if n < LEAST_CELLS:
        return -np.inf
    fine = np.clip(meshes / meshes.mean(axis=(1, 2), keepdims=True) - 1, -0.5, 0.5).reshape(n, -1)
    others = (fine.sum(axis=0) - fine) / (n - 1)
    alike = np.median([np.corrcoef(a, b)[0, 1] for a, b in zip(fine, others, strict=True)])
    inner = meshes[:, 2:-2, 2:-2]
    half = (SAMPLES - 4) // 2
    quarters = np.log(np.maximum(inner.reshape(n, 2, half, 2, half).mean(axis=(2, 4)), 1e-6))
    uneven = quarters.reshape(n, 4).var(axis=1).mean() / (quarters.var() + 1e-12)
    # Where few meshes count, many cells are left out.
    share = n * _cell_area(pose, image.shape) / max(float(bright.sum()), 1.0)
    stretch = abs(np.log(pose.aspect))
    return float(alike - uneven - PER_STRETCH * stretch + PER_CELL * min(share, 1.0))


def _cell_area(pose: Pose, shape: tuple[int, ...]) -> float:
    """Area of a cell in the middle of the frame, square pixels."""
    middle = pose.unproject(np.array([[(shape[1] - 1) / 2, (shape[0] - 1) / 2]]))
    return float(np.abs(np.linalg.det(pose.camera.jacobian(pose.homography, middle)[0])))
