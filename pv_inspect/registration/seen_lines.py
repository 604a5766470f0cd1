"""Where the sides of the cells lie in the image of all frames, whatever the layout says.

What chose the layout were dark lines in single frames, fitted with a model of a gap of the width
that the layout says. Here every side of a cell is the steepest rise of brightness by itself, on
the mean of the registered frames: a second measurement that knows no gap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from pv_inspect.common.robust import MAD_TO_SIGMA
from pv_inspect.detection.edges import ALONG, CellEdges, cell_edges, edge_profiles
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.pose import Pose

__all__ = ["SeenLines", "seen_lines"]

Array = NDArray[np.float64]
Image = NDArray[np.float32]

STEP_LR_PX = 0.25
SMOOTH_LR_PX = 0.4
"""Of a profile, before its slope is taken."""
SEARCH_UNITS, SEARCH_LR_PX = 0.06, 1.5
"""So far from its line the darkest place of a gap is looked for, the larger of both."""
SIDE_UNITS = 0.16
"""A side is looked for so far from where the layout has it."""
LEAST_RISE = 0.06
"""From the gap to the cell, in parts of the brightness of that cell."""
FIRST_RISE = 0.5
"""Of the steepest rise: nearer ones that are less steep are texture of what lies in a gap."""
LIT = 0.35
"""Brightness of a cell, in parts of that of a bright one, beside which a side is measured."""


@dataclass(frozen=True)
class SeenLines:
    """The lines of one direction, the outer ones included; all in module units.

    Parameters
    ----------
    name : str
        "column" for the lines between columns, "row".
    low, high : (m, n + 1) float64
        Where the sides of the cells before and behind each line lie, from the line: for each of
        the m cells along it. NaN where not seen.
    lr_px : float
        LR pixels per module unit.
    blur : float
        How softly the outer cells end, standard deviation; 0 if that is not seen.
    """

    name: str
    low: Array
    high: Array
    lr_px: float
    blur: float

    @property
    def offsets(self) -> tuple[Array, Array]:
        """How far the middle of each inner line lies off, and its standard deviation: (n - 1,)."""
        return _typical(0.5 * (self.low + self.high)[:, 1:-1])

    @property
    def widths(self) -> tuple[Array, Array]:
        """Width of the gap at each inner line, and its standard deviation: (n - 1,)."""
        return _typical((self.high - self.low)[:, 1:-1])

    @property
    def ends(self) -> tuple[Array, Array]:
        """Where the first and the last cell end, from the outer lines towards the cells: (2,)."""
        return _typical(np.column_stack([self.high[:, 0], -self.low[:, -1]]))


def seen_lines(module: Image, grid: HrGrid) -> tuple[SeenLines, SeenLines]:
    """Measure the sides of all cells.

    Parameters
    ----------
    module : (H, W) float32
        Mean of the registered frames.
    grid : HrGrid
        Where its pixels lie.

    Returns
    -------
    SeenLines, SeenLines
        Of the lines between columns, and of those between rows.
    """
    layout = grid.layout
    edges = cell_edges(layout)
    lr_px = grid.pixels_per_unit / grid.magnification
    plane = Pose(Camera(np.eye(3), 0.0), np.asarray(np.linalg.inv(grid.matrix), np.float64))
    half = 0.5 * float(edges.gap.max())
    search = max(SEARCH_UNITS, SEARCH_LR_PX / lr_px)
    reach = half + search + max(SIDE_UNITS, 4 / lr_px)
    step = STEP_LR_PX / lr_px
    x: Array = step * np.arange(-int(reach / step), int(reach / step) + 1, dtype=np.float64)
    samples, _ = edge_profiles(module, edges, plane, x, ALONG)
    low, high, blur = _sides(np.median(samples, axis=1), x, edges, search)
    rows, cols = layout.rows, layout.cols
    upright = rows * (cols + 1)

    def of(values: Array, across: bool) -> Array:
        if across:
            return values[:upright].reshape(rows, cols + 1)
        return values[upright:].reshape(rows + 1, cols).T

    return (
        SeenLines("column", of(low, True), of(high, True), lr_px, _middle(of(blur, True))),
        SeenLines("row", of(low, False), of(high, False), lr_px, _middle(of(blur, False))),
    )


def _sides(
    profiles: Array, x: Array, edges: CellEdges, search: float
) -> tuple[Array, Array, Array]:
    """Place of the falling and of the rising side around each line, and blur of outer ones.

    NaN where none is seen.
    """
    step = float(x[1] - x[0])
    smooth = gaussian_filter1d(profiles, SMOOTH_LR_PX / STEP_LR_PX, axis=1)
    slope = np.gradient(smooth, step, axis=1)
    bright = float(np.percentile(smooth, 75))
    low, high, blur = (np.full(len(profiles), np.nan) for _ in range(3))
    for k, (one, rise) in enumerate(zip(smooth, slope, strict=True)):
        near = np.flatnonzero(np.abs(x) <= search + 0.5 * edges.gap[k])
        middle = int(near[one[near].argmin()])
        inner, side = bool(edges.inner[k]), int(edges.side[k])
        if inner or side < 0:
            low[k] = _steepest(-rise[: middle + 1][::-1], one[: middle + 1][::-1], bright)
            low[k] = x[middle] - step * low[k]
        if inner or side > 0:
            high[k] = x[middle] + step * _steepest(rise[middle:], one[middle:], bright)
        side_at = high[k] if side > 0 else low[k]
        if not inner and np.isfinite(side_at):
            at = int(np.abs(x - side_at).argmin())
            # A step of this height, blurred by a Gaussian, is so steep in its middle.
            height = 2 * abs(float(one[at]) - float(one[middle]))
            blur[k] = height / max(np.sqrt(2 * np.pi) * abs(float(rise[at])), 1e-12)
    return low, high, blur


def _middle(values: Array) -> float:
    """Median of what is known, else 0."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else 0.0


def _steepest(rise: Array, level: Array, bright: float) -> float:
    """After how many samples from the gap on the brightness rises most; NaN if it hardly does.

    Behind the side of a cell, a busbar or a crack may rise as steeply: the first such rise counts.
    """
    inner = rise[1:-1]
    peaks = 1 + np.flatnonzero((inner >= rise[:-2]) & (inner > rise[2:]) & (inner > 0))
    if not peaks.size:
        return np.nan
    k = int(peaks[rise[peaks] >= FIRST_RISE * rise[peaks].max()][0])
    beyond = float(np.median(level[k:]))
    if beyond < LIT * bright or beyond - float(level[: k + 1].min()) < LEAST_RISE * beyond:
        return np.nan
    before, here, after = rise[k - 1 : k + 2]
    return k + 0.5 * float((before - after) / min(before - 2 * here + after, -1e-12))


def _typical(values: Array) -> tuple[Array, Array]:
    """Median of each column and its standard deviation.

    NaN where fewer than two values, or less than a third, are known. A few values may be alike by
    chance, so that none counts as surer than the usual spread of all columns allows.
    """
    known = np.isfinite(values)
    count = known.sum(axis=0)
    enough = (count >= 2) & (3 * count >= len(values))
    filled = np.where(enough & known, values, np.nan)
    filled[:, ~enough] = 0.0
    middle = np.nanmedian(filled, axis=0)
    rest = np.abs(filled - middle)
    spread = MAD_TO_SIGMA * np.nanmedian(rest, axis=0)
    usual = float(np.median(spread[enough])) if enough.any() else 0.0
    sigma = 1.2533 * np.maximum(spread, usual) / np.sqrt(np.maximum(count, 1))
    return np.where(enough, middle, np.nan), np.where(enough, sigma, np.nan)
