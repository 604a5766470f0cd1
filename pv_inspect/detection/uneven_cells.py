"""Columns or rows of other cells than the rest, looked for where no module of even ones is found.

Through the pose of its outline the module is a rectangle. Of two kinds of cells, usual ones and
others of one width, every order puts the lines between them elsewhere: the one with the darkest
lines is tried. What is found is told, not used: somebody has to confirm it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.gap_text import CellSizes, gap_text
from pv_inspect.detection.edges import CellEdges, cell_edges, measure_edges
from pv_inspect.detection.gap_proposals import REACH_PX, depth_of_lines
from pv_inspect.detection.grid_check import cell_levels, is_lit
from pv_inspect.detection.line_profiles import (
    along,
    columns_at,
    line_profiles,
    rectified,
    unit_corners,
)
from pv_inspect.detection.outline import Outline, OutlineError, fit_pose
from pv_inspect.detection.single_frame import (
    MAX_ASPECT_RATIO_ERROR,
    Found,
    complete_outlines,
    found_in_outline,
    search_units,
)
from pv_inspect.detection.wide_gaps import pose_basis, robust_fit
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["said_of_uneven", "uneven_in_frame"]

Array = NDArray[np.float64]

WIDTHS = np.concatenate([np.arange(0.3, 0.951, 0.01), np.arange(1.05, 1.601, 0.01)])
"""Of the cells that are not as the others, in widths of those."""
MOST_OTHERS = 0.5
"""Share of the columns that may be others."""
PROPOSALS, LIKELY = 2, 0.5
"""Orders that are tried, with at least this share of the gain of the best one."""
LEAST_GAIN = 0.03
"""Darker lines than those of even cells by this share of the darkest one."""
SIMPLE = 0.02
"""Each other cell has to make the lines darker by this share."""
LEAST_SHARE, SURE_SHARE = 0.95, 0.98
"""Of the borders that must be in place. Orders that differ in one or two cells share most lines."""
LEAST_LIT = 0.5
"""These were chosen on single frames of simulated modules: uneven ones of seeds 0 to 19 of
benchmarks/gapped_modules.py, and those of its seeds 400 to 405 told with a row or a column too many
or a row too few, for which no widths may be seen."""
NEAR_WHOLE = 0.06
"""Others side by side that are together as wide as usual cells, to so much, may be those: halves of
a cell with a busbar in its middle, where one column too many was counted."""
AGREE = 0.03
"""Widths of two frames that differ by less are the same."""
ROUNDS = 3
LEAST_EDGES = 12
UNIT = ModuleLayout(1, 1)


@dataclass(frozen=True)
class _Order:
    """Which of the cells along a direction are of another width, and how dark its lines are."""

    score: float
    numbers: tuple[int, ...]
    width: float


def said_of_uneven(
    sequence: FrameSequence, layout: ModuleLayout, inside: tuple[float, float] | None
) -> str:
    """Say under which other widths of rows or columns frames show a module that was not found.

    Parameters
    ----------
    sequence : FrameSequence
    layout : ModuleLayout
        As it was told.
    inside : tuple of float or None
        (x, y) of a point in the wanted module, LR pixels of the first frame.

    Returns
    -------
    str
        A sentence with a space before it; "" if there are no such widths, or some were told.
    """
    seen = _agreed(sequence, layout, inside) if layout == layout.plain else None
    if seen is None:
        return ""
    return (
        " Nearly all borders are in place if its cells are not alike: compare a frame with "
        f"{seen.sizes_in_words} (in cell widths), and perhaps give {_options(seen)}."
    )


def _agreed(
    sequence: FrameSequence, layout: ModuleLayout, inside: tuple[float, float] | None
) -> ModuleLayout | None:
    """Return the layout with the other widths that two frames agree on; None if they don't."""
    distinct = sequence.measured
    chosen = distinct[:1] if inside is not None else [distinct[0], distinct[len(distinct) // 2]]
    seen: list[ModuleLayout] = []
    for index in dict.fromkeys(chosen):
        one = uneven_in_frame(sequence.frame(index).image, layout, inside)
        if one is None or (seen and not _agree(seen[0], one)):
            return None
        seen.append(one)
    return replace(
        seen[0],
        row_heights=_mean([one.row_heights for one in seen]),
        col_widths=_mean([one.col_widths for one in seen]),
    )


def _options(layout: ModuleLayout) -> str:
    """Write the widths as they are given on the command line."""
    options = [
        f'{option} "{gap_text(sizes)}"' if len(sizes) > 1 else f"{option} {gap_text(sizes)}"
        for option, sizes in (
            ("--row-heights", layout.row_heights),
            ("--col-widths", layout.col_widths),
        )
        if sizes
    ]
    return " ".join(options)


def _agree(one: ModuleLayout, other: ModuleLayout) -> bool:
    pairs = ((one.row_heights, other.row_heights), (one.col_widths, other.col_widths))
    return all(
        [number for number, _ in a] == [number for number, _ in b]
        and all(abs(x - y) < AGREE for (_, x), (_, y) in zip(a, b, strict=True))
        for a, b in pairs
    )


def _mean(sizes: list[CellSizes]) -> CellSizes:
    return tuple(
        (number, float(np.mean([one[k][1] for one in sizes])))
        for k, (number, _) in enumerate(sizes[0])
    )


def uneven_in_frame(
    image: NDArray[np.float32],
    layout: ModuleLayout,
    inside: tuple[float, float] | None = None,
) -> ModuleLayout | None:
    """Return the layout with the widths under which one frame shows the module; None without.

    Parameters
    ----------
    image : (height, width) float32
    layout : ModuleLayout
        Rows, columns and cell aspect.
    inside : tuple of float, optional
        (x, y) of a point in the wanted module, LR pixels.
    """
    best: tuple[ModuleLayout, Found] | None = None
    with suppress(OutlineError):
        outline = next(complete_outlines(image, inside))
        for proposal in _proposals(image, outline, layout):
            with suppress(OutlineError):
                found = found_in_outline(image, proposal, outline)
                # Perspective and lens may have moved the lines that the width was read from.
                refined = _refined(image, proposal, found)
                found = found_in_outline(image, refined, outline)
                if best is None or found.share > best[1].share:
                    best = refined, found
            if best is not None and best[1].share >= SURE_SHARE:
                break
    if best is None or best[1].share < LEAST_SHARE or _are_dark(image, *best):
        return None
    return best[0]


def _are_dark(image: NDArray[np.float32], layout: ModuleLayout, found: Found) -> bool:
    """Whether most of the other cells give no light: then they are a wide gap."""
    lit = is_lit(cell_levels(image, layout, found.pose))
    rows = [number - 1 for number, _ in layout.row_heights]
    cols = [number - 1 for number, _ in layout.col_widths]
    others = np.concatenate([lit[rows].ravel(), lit[:, cols].ravel()])
    return float(others.mean()) < LEAST_LIT


def _proposals(
    image: NDArray[np.float32], outline: Outline, layout: ModuleLayout
) -> list[ModuleLayout]:
    """Layouts with other columns, or other rows, that may fill an outline, likely ones first."""
    pose, _ = fit_pose(outline, UNIT, image.shape, 0)
    found = [
        pair
        for start in (pose, pose.turned(UNIT.size, UNIT.size, 1))
        for pair in _scored(image, start, layout)
    ]
    found.sort(key=lambda pair: -pair[0])
    return [proposal for score, proposal in found if score > LIKELY * found[0][0]][:PROPOSALS]


def _scored(
    image: NDArray[np.float32], pose: Pose, layout: ModuleLayout
) -> Iterator[tuple[float, ModuleLayout]]:
    """Yield layouts for one way round, with their scores."""
    corners = unit_corners(pose)
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    across_px, down_px = float(sides[[0, 2]].mean()), float(sides[[1, 3]].mean())
    found: list[tuple[float, ModuleLayout]] = []
    for order in _orders(rectified(image, pose, across_px, True), across_px, layout.cols):
        widths = tuple((number, order.width) for number in order.numbers)
        found.append((order.score, replace(layout, col_widths=widths)))
    for order in _orders(rectified(image, pose, down_px, False), down_px, layout.rows):
        heights = tuple((number, order.width / layout.cell_aspect) for number in order.numbers)
        found.append((order.score, replace(layout, row_heights=heights)))
    for score, proposal in found:
        width, height = proposal.size
        if abs(np.log(pose.aspect * height / width)) <= np.log(MAX_ASPECT_RATIO_ERROR):
            yield score, proposal


def _orders(module: NDArray[np.float32], side_px: float, n: int) -> list[_Order]:
    """Orders of usual and other cells whose lines are darker than those of even cells."""
    if n < 2:
        return []
    width = module.shape[1]
    lr_px = width / side_px
    profiles = line_profiles(module, lr_px)
    depth = along(profiles, 0) + along(profiles, REACH_PX * lr_px)
    even = depth_of_lines(depth, np.arange(1, n) / n)
    scale = max(float(depth.max()), 1e-6)
    best: dict[tuple[int, ...], _Order] = {}
    for other in WIDTHS.tolist():
        for count in range(1, max(int(MOST_OTHERS * n), 1) + 1):
            numbers = _darkest_order(depth, n, count, other)
            sizes = np.ones(n)
            sizes[np.array(numbers) - 1] = other
            score = depth_of_lines(depth, np.cumsum(sizes)[:-1] / sizes.sum())
            gain = (score - even) / scale - SIMPLE * count
            if gain <= LEAST_GAIN or _may_be_whole(numbers, other):
                continue
            if numbers not in best or gain > best[numbers].score:
                best[numbers] = _Order(gain, numbers, other)
    return sorted(best.values(), key=lambda order: -order.score)[:PROPOSALS]


def _may_be_whole(numbers: tuple[int, ...], other: float) -> bool:
    """Whether others that lie side by side are together as wide as some usual cells."""
    runs = np.split(np.array(numbers), 1 + np.flatnonzero(np.diff(numbers) > 1))
    wide = [len(run) * other for run in runs if len(run) > 1]
    return any(abs(total - max(round(total), 1)) < NEAR_WHOLE for total in wide)


def _darkest_order(depth: Array, n: int, count: int, other: float) -> tuple[int, ...]:
    """Which `count` of n cells must be the other ones for the darkest lines.

    Where a line lies depends only on how many cells of each kind are before it: dynamic programming
    over these two numbers finds the best of all orders.
    """
    # No single line, a crack or a wide gap, may outweigh the others.
    capped = np.minimum(depth, np.quantile(depth, 0.97))
    whole = n - count + count * other
    before, others = np.meshgrid(np.arange(n + 1), np.arange(count + 1), indexing="ij")
    place = np.clip((before - others + others * other) / whole, 0, 1 - 1e-9)
    line = capped[columns_at(place, len(depth))]
    line[[0, n]] = 0.0
    best = np.full((n + 1, count + 1), -np.inf)
    came = np.zeros((n + 1, count + 1), bool)
    best[0, 0] = 0.0
    for k in range(1, n + 1):
        with_other = np.concatenate([[-np.inf], best[k - 1, :-1]])
        came[k] = with_other > best[k - 1]
        best[k] = np.maximum(with_other, best[k - 1]) + line[k]
    numbers, left = [], count
    for k in range(n, 0, -1):
        if came[k, left]:
            numbers.append(k)
            left -= 1
    return tuple(reversed(numbers))


def _refined(image: NDArray[np.float32], layout: ModuleLayout, found: Found) -> ModuleLayout:
    """Measure the width of the other cells on the edges, together with pose and lens."""
    pose = found.pose
    for _ in range(ROUNDS):
        edges = cell_edges(layout)
        offsets = measure_edges(image, edges, pose, search_units(layout, pose))
        # How wide an outer cell is shows at the outline alone.
        use = offsets.found
        if use.sum() < LEAST_EDGES:
            break
        base = np.einsum("nki,nk->ni", pose_basis(edges.middle, pose), edges.normal)
        design = np.column_stack([base, _by_width(layout, edges)])[use]
        solution, _ = robust_fit(design, offsets.offset[use], offsets.sigma[use])
        wider = _wider(layout, float(solution[-1]))
        if wider is None:
            break
        layout = wider
    return layout


def _by_width(layout: ModuleLayout, edges: CellEdges) -> Array:
    """How edges move along their normals per unit by which all other cells are wider."""
    axis, starts, sizes = (
        (0, layout.col_starts, layout.col_widths)
        if layout.col_widths
        else (1, layout.row_starts, layout.row_heights)
    )
    middle = edges.middle[:, axis]
    moved = np.zeros(len(middle))
    for number, size in sizes:
        moved += middle > starts[number - 1] + 0.5 * size
    return np.where(edges.normal[:, axis] == 1, moved, 0.0)


def _wider(layout: ModuleLayout, by: float) -> ModuleLayout | None:
    """Return the layout with all other cells wider by so much; None if that is none."""
    with suppress(InspectionError):
        return replace(
            layout,
            row_heights=tuple((number, size + by) for number, size in layout.row_heights),
            col_widths=tuple((number, size + by) for number, size in layout.col_widths),
        )
    return None
