"""Whether a grid that was fitted to one frame can be that of the module: its rows and columns.

A grid with a row too few, too many or half as many can lie on the gaps of the module nearly
everywhere. What gives it away does not depend on other frames: the module goes on outside of the
grid, a row of the grid is dark all along, one of its lines is no gap, or there are gaps in the
middle of all its cells. Dead cells say nothing, so only bright cells are asked.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.detection.edges import CellEdges, EdgeOffsets, cell_edges, measure_edges
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose

__all__ = ["cell_levels", "grid_fault", "is_lit", "offsets_px"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# The limits were chosen on simulated modules of 4 x 6 to 24 x 6 cells (benchmarks/wrong_layouts.py,
# seeds 0 to 20) with their true grid and with the grid moved on and off by one and two lines.
# There, right grids had 0.75 to 1.0 of the gaps of their worst line, at most 0.15 of the gaps that
# would halve the cells both ways (0.11 of the share of the grid's own gaps, seeds 0 to 59), and
# outer rows of level 0.66 to 1; wrong ones had 0 of the gaps of a line outside, 0.88 to 1 of the
# share of their own gaps halving the cells, and rows outside of level 0 to 0.05.
IN_PLACE_PX = 0.5
LINE_PX = 1.0
"""A whole line may lie so far off: the pose of one frame is not perfect."""
LIT = 0.35
"""Level of a cell above the background, that of a bright one being 1, that is not dead."""
BACKGROUND = 0.1
BRIGHT_PERCENTILE = 75.0
SAMPLES = np.linspace(0.2, 0.8, 5)
MIN_SEEN = 0.2
"""A cell counts as seen if the frame shows so much of it."""
ABSENT_SHARE = 0.6
ABSENT_SIGMA = 3.5
"""A line is no gap if it has less than this share of the usual gaps, and significantly less."""
MAX_USUAL = 0.9
BEYOND_SHARE = 0.75
"""Share of the usual gaps on the outer line of a grid that is too small. Beside a neighbouring
module it was at most 0.6 on photographs of a power plant."""
FINER_SHARE = 0.6
SEARCH_UNITS = 0.04
MIN_SEARCH_PX = 1.2
RING = 2


def cell_levels(image: NDArray[np.float32], layout: ModuleLayout, pose: Pose) -> Array:
    """Measure how bright the middle of each cell is.

    Parameters
    ----------
    image : (height, width) float32
    layout : ModuleLayout
    pose : Pose

    Returns
    -------
    (rows, cols) float64
        Background 0, bright cell 1; NaN where the frame does not show the cell.
    """
    return _relative(*_brightness(image, layout, pose))


def is_lit(levels: Array) -> Mask:
    """Whether cells of these levels are bright enough for their gaps to be seen."""
    return np.nan_to_num(levels) > LIT


def offsets_px(edges: CellEdges, offsets: EdgeOffsets, pose: Pose) -> Array:
    """Return the offsets of the gaps that were found, (n,) in pixels of the frame, else NaN."""
    jacobian = pose.camera.jacobian(pose.homography, edges.middle)
    across = np.linalg.norm(np.einsum("nij,nj->ni", jacobian, edges.normal), axis=1)
    return np.asarray(np.where(offsets.found, offsets.offset, np.nan) * across)


def grid_fault(
    image: NDArray[np.float32], layout: ModuleLayout, pose: Pose, *, whole: bool = False
) -> str:
    """Say what speaks against the number of rows and columns of a grid.

    Parameters
    ----------
    image : (height, width) float32
    layout : ModuleLayout
    pose : Pose
        Fitted to the gaps.
    whole : bool
        Whether the frame is known to show the whole module.

    Returns
    -------
    str
        Part of a sentence; empty if nothing does.
    """
    around = layout.with_rows_around(RING)
    moved = _shifted(pose, -RING, -RING / layout.cell_aspect)
    levels, background = _brightness(image, around, moved)
    inside = (slice(RING, -RING), slice(RING, -RING))
    relative = _relative(levels, background, levels[inside])
    offsets = measure_edges(image, cell_edges(around), moved, _search(layout, pose))
    views = _directions(around, moved, offsets, relative)
    for view in views:
        fault = _outside(view, whole) or _lines(view)
        if fault:
            return f"{fault} {layout.rows} x {layout.cols} cells"
    if _has_finer_grid(image, layout, pose, is_lit(relative[inside])):
        return f"there are borders in the middle of the {layout.rows} x {layout.cols} cells too"
    return ""


@dataclass(frozen=True)
class _Direction:
    """The grid as n lines side by side (of rows or of columns), each across m cells.

    `place` (m, n + 1) is the offset of the gap there, pixels, NaN if none was found; `visible`
    likewise; `level` (m, n) the brightness of the cells. `RING` lines on both sides are outside.
    """

    what: str
    place: Array
    visible: Mask
    level: Array

    @property
    def between(self) -> Mask:
        """Where a gap must show, (m, n + 1): seen, and bright cells on both sides."""
        lit = is_lit(self.level)
        both = np.zeros_like(self.visible)
        both[:, 1:-1] = lit[:, :-1] & lit[:, 1:]
        return both & self.visible

    @property
    def inner(self) -> slice:
        """The lines between two cells of the grid."""
        return slice(RING + 1, self.place.shape[1] - RING - 1)

    def in_place(self, line: int) -> Mask:
        """Whether the gaps of a line are there, the line as a whole being a little off."""
        place = self.place[:, line]
        found = place[self.between[:, line] & np.isfinite(place)]
        middle = float(np.median(found)) if found.size else 0.0
        middle = float(np.clip(middle, -LINE_PX, LINE_PX))
        with np.errstate(invalid="ignore"):
            return np.asarray(np.abs(place - middle) < IN_PLACE_PX)

    def share(self, line: int) -> tuple[float, int]:
        """Share of the gaps of a line that are in place, and how many must show."""
        must = self.between[:, line]
        n = int(must.sum())
        return (float(self.in_place(line)[must].mean()) if n else np.nan), n

    @property
    def usual(self) -> float:
        """Median share over the inner lines."""
        lines = range(self.place.shape[1])[self.inner]
        shares = [share for share, n in map(self.share, lines) if n]
        return min(float(np.median(shares)), MAX_USUAL) if shares else MAX_USUAL


def _directions(
    around: ModuleLayout, pose: Pose, offsets: EdgeOffsets, relative: Array
) -> tuple[_Direction, _Direction]:
    edges = cell_edges(around)
    place = offsets_px(edges, offsets, pose)
    rows, cols = around.rows, around.cols
    upright = rows * (cols + 1)

    def cut(values: NDArray[np.generic]) -> tuple[NDArray[np.generic], NDArray[np.generic]]:
        return (
            values[:upright].reshape(rows, cols + 1)[RING:-RING],
            values[upright:].reshape(rows + 1, cols)[:, RING:-RING].T,
        )

    places, visible = cut(place), cut(offsets.visible)
    levels = relative[RING:-RING], relative[:, RING:-RING].T
    columns, lines = (
        _Direction(what, np.asarray(p, np.float64), np.asarray(v, bool), level)
        for what, p, v, level in zip(("column", "row"), places, visible, levels, strict=True)
    )
    return columns, lines


def _outside(view: _Direction, whole: bool) -> str:
    """Say whether the module goes on outside of the grid, or ends before it."""
    n = view.level.shape[1]
    for first, outer, step in (("first", RING, -1), ("last", n - RING - 1, 1)):
        level = view.level[:, outer]
        seen = np.isfinite(level)
        if not seen.any():
            if whole:
                return f"the {first} {view.what} would lie outside of the frame with"
            continue
        if not is_lit(level).any() and np.median(level[seen]) < BACKGROUND:
            return f"all of the {first} {view.what} is as dark as what is around the module with"
        line = outer if step < 0 else outer + 1
        share, count = view.share(line)
        if count < 2 or share < BEYOND_SHARE * view.usual or 2 * count <= seen.sum():
            continue
        # A neighbouring module has its lines elsewhere, for the gap between modules is wider.
        next_share, n_next = view.share(line + step)
        beyond, further = view.level[:, outer + step], view.level[:, outer + 2 * step]
        ends = is_lit(beyond) & np.isfinite(further) & ~is_lit(further)
        unseen = not np.isfinite(further[is_lit(beyond)]).any()
        if (
            (n_next > 1 and next_share >= BEYOND_SHARE * view.usual)
            or 2 * ends.sum() > is_lit(beyond).sum()
            or (unseen and share >= view.usual)
        ):
            return f"the module goes on beyond the {first} {view.what} of"
    return ""


def _lines(view: _Direction) -> str:
    """Say whether one of the inner lines is no gap."""
    usual = view.usual
    for line in range(view.place.shape[1])[view.inner]:
        share, n = view.share(line)
        if not n:
            continue
        least = usual * n - ABSENT_SIGMA * np.sqrt(n * usual * (1 - usual))
        if share < ABSENT_SHARE * usual and share * n < least:
            k = line - RING
            return f"there is no border between {view.what} {k} and {k + 1} of"
    return ""


def _has_finer_grid(
    image: NDArray[np.float32], layout: ModuleLayout, pose: Pose, lit: Mask
) -> bool:
    """Whether gaps halve the bright cells both ways, as when rows and cols are half too few.

    One way alone they may be busbars.
    """
    finer = layout.halved()
    halved = Pose(pose.camera, pose.homography @ np.diag([0.5, 0.5, 1.0]))
    edges = _with_gaps_of(layout, cell_edges(finer))
    offsets = measure_edges(image, edges, halved, SEARCH_UNITS)
    with np.errstate(invalid="ignore"):
        in_place = np.abs(offsets_px(edges, offsets, halved)) < IN_PLACE_PX
    upright = finer.rows * (finer.cols + 1)
    return all(
        _halves(lines, bright)
        for lines, bright in (
            (in_place[:upright].reshape(finer.rows, -1), np.repeat(lit, 2, axis=0)),
            (in_place[upright:].reshape(-1, finer.cols).T, np.repeat(lit, 2, axis=1).T),
        )
    )


def _with_gaps_of(layout: ModuleLayout, finer: CellEdges) -> CellEdges:
    """Give those edges of the finer grid that are edges of the grid itself their gaps."""
    rows, cols = layout.rows, layout.cols
    gap, own = np.zeros_like(finer.gap), cell_edges(layout).gap
    upright, own_upright = 2 * rows * (2 * cols + 1), rows * (cols + 1)
    lines = gap[:upright].reshape(2 * rows, -1)
    lines[:, ::2] = 2 * np.repeat(own[:own_upright].reshape(rows, -1), 2, axis=0)
    lines = gap[upright:].reshape(-1, 2 * cols)
    lines[::2] = 2 * np.repeat(own[own_upright:].reshape(-1, cols), 2, axis=1)
    return replace(finer, gap=gap)


def _halves(lines: Mask, bright: Mask) -> bool:
    """Whether the odd lines of a finer grid (m, 2 n + 1) are gaps like the even ones.

    `bright` (m, n) are the cells of the grid itself. Blur and motion may hide all lines of one
    direction alike, so that the share of gaps says nothing by itself.
    """
    halving = lines[:, 1::2][bright]
    own = lines[:, 2:-1:2][bright[:, 1:] & bright[:, :-1]]
    usual = float(own.mean()) if own.size else 1.0
    return bool(halving.any()) and float(halving.mean()) > FINER_SHARE * usual


def _search(layout: ModuleLayout, pose: Pose) -> float:
    return max(SEARCH_UNITS, MIN_SEARCH_PX / pose.scale_px(layout.size))


def _shifted(pose: Pose, x: float, y: float) -> Pose:
    shift = np.array([[1.0, 0, x], [0, 1, y], [0, 0, 1]])
    return Pose(pose.camera, pose.homography @ shift)


def _brightness(
    image: NDArray[np.float32], layout: ModuleLayout, pose: Pose
) -> tuple[Array, float]:
    """Mean brightness of the middle of each cell, NaN if unseen, and that of the background."""
    x, y = layout.places_in_cells(SAMPLES, SAMPLES)
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    pixels = np.nan_to_num(pose.project(points), nan=-1e4).astype(np.float32)
    height, width = image.shape
    seen = np.all((pixels >= 0) & (pixels <= [width - 1, height - 1]), axis=1)
    smooth = cv2.GaussianBlur(image, (0, 0), 1.0)
    lookup = pixels.reshape(len(y), len(x), 2)
    values = cv2.remap(smooth, lookup[..., 0], lookup[..., 1], cv2.INTER_LINEAR)
    shape = (layout.rows, len(SAMPLES), layout.cols, len(SAMPLES))
    seen_in_cell = seen.reshape(shape).transpose(0, 2, 1, 3).reshape(layout.rows, layout.cols, -1)
    in_cell = values.reshape(shape).transpose(0, 2, 1, 3).reshape(seen_in_cell.shape)
    count = seen_in_cell.sum(axis=-1)
    mean = np.where(seen_in_cell, in_cell, 0).sum(axis=-1) / np.maximum(count, 1)
    enough = count >= MIN_SEEN * seen_in_cell.shape[-1]
    return np.where(enough, mean, np.nan), float(np.percentile(smooth, 1))


def _relative(levels: Array, background: float, of_module: Array | None = None) -> Array:
    """Levels with the background at 0 and the bright cells of the module at 1."""
    cells = levels if of_module is None else of_module
    if not np.isfinite(cells).any():
        return np.full_like(levels, np.nan)
    bright = float(np.nanpercentile(cells, BRIGHT_PERCENTILE))
    return np.asarray((levels - background) / max(bright - background, 1e-6))
