"""How well each number of cells fits the dark lines of a module, along one direction.

Seen as a rectangle the gaps between n cells are dark lines at k / n of its width. Busbars are dark
lines too, in one direction; they are less dark, not evenly spaced together with the gaps, or make
cells of an unlikely aspect. In a half-cut module the two halves lie apart, in a mini-module all
cells: then the lines lie a little elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pv_inspect.detection.gap_proposals import (
    ALIKE,
    CELL_GAPS,
    LEAST_CELL_GAP_PX,
    REACH_PX,
    WIDTHS,
    columns_of,
    gap_between_all,
)
from pv_inspect.detection.line_profiles import along, columns_at, line_profiles

__all__ = ["FINER", "LineScores", "line_scores"]

Array = NDArray[np.float64]

# No search for these constants is on record: they were chosen by hand. What they give is shown by
# tests/detection/test_layout_guess.py on simulated modules, and on photographs by
# `python benchmarks/field.py FOLDER --guess`.

MIN_CELL_PX = 8.0
"""Smaller cells are not looked for, LR pixels."""
MAX_CELLS = 60
BETWEEN = np.arange(0.15, 0.851, 0.05)
"""Places in a cell, in its widths, where lines would be busbars."""
FINER = (2, 3, 4, 5)
"""Numbers of parts that the lines in a cell may seem to divide it into."""
BUSBAR_WEIGHT = 0.25
"""What lines that lie symmetrically in the cells take from the score, in parts of their depth."""
MIN_DEPTH = 0.05
"""Shallower lines are none, in parts of the light beside them."""


MIDDLE_BETTER = 0.03
"""By so much a wider gap in the middle has to deepen the lines, as a share."""
LEAST_CORRELATION = 0.8
"""Of the brightness with cells that lie apart, from which on it counts as a score."""


@dataclass(frozen=True)
class LineScores:
    """How well each number of cells n fits along one direction.

    `base` (n,) is the score, 0 to 1; `finer` (n, m) the depth of the lines that would divide each
    cell into `FINER` [m] ones. `middle` and `between` (n,) are the widths of the gap in the middle
    and of those between all cells with which n fits best, in pitches; 0 for the usual gaps.
    """

    base: Array
    finer: Array
    middle: Array
    between: Array


def line_scores(
    rectified: NDArray[np.float32], side_px: float, wide_gaps: bool = False
) -> LineScores:
    """Score every number of cells n from 0 to `MAX_CELLS` along x.

    Relative to the deepest lines there are, the score is the depth of the shallower lines at k / n,
    less what differs between one cell and the next, less a little for other lines in the cells.
    With wide gaps, a gap in the middle moves these lines; cells that all lie apart are scored by
    the correlation of the brightness with them.
    """
    width = rectified.shape[1]
    profiles = line_profiles(rectified, width / side_px)
    base = np.zeros(MAX_CELLS + 1)
    finer = np.zeros((MAX_CELLS + 1, len(FINER)))
    numbers = range(2, int(min(MAX_CELLS, side_px / MIN_CELL_PX)) + 1)
    depths, middle = _depths_of_gaps(profiles, numbers, width / side_px, wide_gaps)
    for n in numbers:
        cells = np.arange(n, dtype=np.float64)
        starts = cells + np.where(cells >= n // 2, middle[n], 0.0)
        within = along(profiles, 0.03 * width / n)

        def typical(
            phase: Array,
            whole: float = n + middle[n],
            starts: Array = starts,
            within: Array = within,
        ) -> tuple[Array, Array]:
            one = within[columns_at((starts + phase[:, None]) / whole, width)]
            other = within[columns_at((starts + 1 - phase[:, None]) / whole, width)]
            either = np.quantile(np.maximum(one, other), 0.4, axis=1)
            return np.quantile(one, 0.4, axis=1), either

        one, either = typical(BETWEEN)
        # Busbars lie symmetrically in a cell: half cells see them now on this side, now on that.
        mirrored = np.maximum(one, one[::-1])
        base[n] = depths[n] - (either - mirrored).max() - BUSBAR_WEIGHT * mirrored.max()
        for k, factor in enumerate(FINER):
            finer[n, k] = typical(np.arange(1, factor) / factor)[0].min()
    for k, factor in enumerate(FINER):
        # Lines that make no even grid of their own are busbars, however dark.
        even = np.zeros_like(base)
        even[: MAX_CELLS // factor + 1] = base[::factor][: MAX_CELLS // factor + 1]
        finer[:, k] = np.clip(np.minimum(finer[:, k], even), 0, None)
    deepest = np.full_like(base, depths.max())
    if wide_gaps and depths[3:].max() >= MIN_DEPTH:
        # A wider gap in the middle is darker than all others.
        deepest[3:] = depths[3:].max()
    if deepest[0] >= MIN_DEPTH:
        base, finer = np.clip(base / deepest, 0, 1), finer / deepest[:, None]
    else:
        base, finer = np.zeros_like(base), np.zeros_like(finer)
    between = np.zeros_like(base)
    bright = columns_of(rectified)
    for n in numbers if wide_gaps else ():
        if CELL_GAPS[-1] * side_px / n <= LEAST_CELL_GAP_PX:
            break
        gap, correlation = gap_between_all(bright, n)
        if correlation > LEAST_CORRELATION and gap * side_px / n > LEAST_CELL_GAP_PX:
            base[n], middle[n], between[n] = max(base[n], correlation), 0.0, gap
    return LineScores(base, finer, middle, between)


def _depths_of_gaps(
    profiles: NDArray[np.float32], numbers: range, lr_px: float, wide_gaps: bool
) -> tuple[Array, Array]:
    """How dark the gaps between n cells are, and the wider gap in the middle that they need."""
    width = profiles.shape[1]
    depths, middle = np.zeros((2, MAX_CELLS + 1))
    for n in numbers:
        near = along(profiles, 0.1 * width / n)
        depths[n] = np.quantile(near[columns_at(np.arange(1, n) / n, width)], 0.15)
    if not wide_gaps:
        return depths, middle
    # As wide as the pose of the outline is right; the widths differ by less than that.
    exact = along(profiles, 0) + along(profiles, REACH_PX * lr_px)
    for n in numbers:
        if n % 2 or n == 2:
            continue
        lines = np.delete(np.arange(1, n), n // 2 - 1)
        places = (lines + WIDTHS[:, None] * (lines > n // 2)) / (n + WIDTHS[:, None])
        seen = exact[columns_at(places, width)]
        tried = np.minimum(seen, np.median(seen, axis=1, keepdims=True)).mean(axis=1)
        if tried.max() < (1 + MIDDLE_BETTER) * tried[0]:
            continue
        gap = float(WIDTHS[tried >= ALIKE * tried.max()].mean())
        near = along(profiles, 0.1 * width / n)
        at = (lines + gap * (lines > n // 2)) / (n + gap)
        depth = float(np.quantile(near[columns_at(at, width)], 0.15))
        if depth >= ALIKE * depths[n]:
            depths[n], middle[n] = depth, gap
    return depths, middle
