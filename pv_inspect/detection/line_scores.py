"""How well each number of cells fits the dark lines of a module, along one direction.

Seen as a rectangle the gaps between n cells are dark lines at k / n of its width. Busbars are dark
lines too, in one direction; they are less dark, not evenly spaced together with the gaps, or make
cells of an unlikely aspect.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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


@dataclass(frozen=True)
class LineScores:
    """How well each number of cells n fits along one direction.

    `base` (n,) is the score, 0 to 1; `finer` (n, m) the depth of the lines that would divide each
    cell into `FINER` [m] ones.
    """

    base: Array
    finer: Array


def line_scores(rectified: NDArray[np.float32], side_px: float) -> LineScores:
    """Score every number of cells n from 0 to `MAX_CELLS` along x.

    Relative to the deepest lines there are, the score is the depth of the shallower lines at k / n,
    less what differs between one cell and the next, less a little for other lines in the cells.
    """
    width = rectified.shape[1]
    profiles = line_profiles(rectified, width / side_px)
    base = np.zeros(MAX_CELLS + 1)
    depths = np.zeros(MAX_CELLS + 1)
    finer = np.zeros((MAX_CELLS + 1, len(FINER)))
    for n in range(2, int(min(MAX_CELLS, side_px / MIN_CELL_PX)) + 1):
        lines = along(profiles, 0.1 * width / n)[columns_at(np.arange(1, n) / n, width)]
        depths[n] = np.quantile(lines, 0.15)
        within = along(profiles, 0.03 * width / n)

        def typical(phase: Array, n: int = n, within: Array = within) -> tuple[Array, Array]:
            cells = np.arange(n)
            one = within[columns_at((cells + phase[:, None]) / n, width)]
            other = within[columns_at((cells + 1 - phase[:, None]) / n, width)]
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
    deepest = float(depths.max())
    if deepest < MIN_DEPTH:
        return LineScores(np.zeros_like(base), np.zeros_like(finer))
    return LineScores(np.clip(base / deepest, 0, 1), finer / deepest)
