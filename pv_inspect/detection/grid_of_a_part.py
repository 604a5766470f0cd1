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

from pv_inspect.detection.cell_likeness import CellLikeness, cell_likeness
from pv_inspect.detection.edges import CellEdges, EdgeOffsets, cell_edges, measure_edges
from pv_inspect.detection.even_lines import even_lines
from pv_inspect.detection.grid_check import IN_PLACE_PX, offsets_px
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
MAX_STRETCH = 0.3
"""Logarithm; perspective changes the aspect of cells by up to 1.22 at 35 degrees."""
TRIED = 5
RINGS = (1.2, 2.2, 3.2, 4.2, 5.2, 7.2, 9.2, 12.2, 16.2, 22.2, 29.2)
"""Distances from the first cell to which the grid grows, cells."""
SEARCH_UNITS = 0.12
LEAST_IN_PLACE = 0.75
"""Share of the borders between bright cells, in the worse direction."""
LEAST_GAPS = 8
SURE_RING = 2.5
SURE = 0.5
"""A grid is taken at once if the brightness varies by a factor of e to this more across its lines
than anywhere else, both ways; and is moved if it does so elsewhere."""
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
        for grid, looks in _grids(image, bright, edges, start, cell_aspect):
            if best is None or looks.score > best[0]:
                best = looks.score, grid
            if min(looks.own) >= SURE:
                return grid
    if best is None:
        raise OutlineError("no grid of cells is seen in the part of the module that it shows")
    return best[1]


def _grids(
    image: Image, bright: Mask, edges: CellEdges, start: Pose, cell_aspect: float
) -> Iterator[tuple[GridOfPart, CellLikeness]]:
    """Grow the grid from a start, and once more from where cells end if that is elsewhere.

    Busbars near the borders may keep it from growing: a narrow search does not reach them.
    """
    for search in (SEARCH_UNITS, SEARCH_UNITS / 2):
        looks = None
        with suppress(OutlineError):
            grid = _grown(image, bright, edges, start, search)
            looks = cell_likeness(image, bright, grid.pose, plane_of(cell_aspect))
        if looks is None:
            continue
        yield grid, looks
        if min(looks.own) > -SURE:
            return
        x, y = looks.ends
        moved = np.array([[1, 0, x], [0, 1, y / cell_aspect], [0, 0, 1]])
        start = Pose(grid.pose.camera, grid.pose.homography @ moved)


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
        across, down = (even_lines(image, centre, half, upright) for upright in (True, False))
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


def _grown(image: Image, bright: Mask, edges: CellEdges, start: Pose, search: float) -> GridOfPart:
    """Fit the grid to the borders around the first cell, then to those of more and more cells."""
    pose, share, count = start, 0.0, 0
    middle = edges.middle[edges.inner].mean(axis=0)
    away = (np.abs(edges.middle - middle) / np.abs(edges.along).max(axis=0)).max(axis=1)
    for ring in RINGS:
        part = edges.part((away < ring) & pose.shows(edges.middle, image.shape))
        offsets = measure_edges(image, part, pose, search)
        pose = refined_pose(pose, part, offsets)
        offsets = measure_edges(image, part, pose, search / 2)
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


def _share(
    shape: tuple[int, ...], bright: Mask, edges: CellEdges, offsets: EdgeOffsets, pose: Pose
) -> tuple[float, int]:
    """Share of the borders that lie between bright places and are in place; number of such."""
    lit = offsets.visible.copy()
    for side in (-BESIDE, BESIDE):
        points = edges.middle + side * np.abs(edges.along[:, ::-1])
        lit &= pose.shows(points, shape)
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
