"""The gap between all cells of a module whose grid is known: how wide it is, and whether it is.

Cells that lie apart by some pixels have lines between them like others, wherever in the wide gap
these are found: the grid of a module without wide gaps may seem to fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pv_inspect.detection.edges import ALONG, cell_edges, edge_profiles, scales_px
from pv_inspect.detection.gap_model import GAP_SHAPES, STEP_PX
from pv_inspect.detection.gap_width import gap_width
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose

__all__ = ["cell_gap_if_wide", "seen_cell_gap"]

Array = NDArray[np.float64]

WIDEST = 0.3
"""Of the gaps that are looked for, cell widths."""
LEAST_CELL_GAP = 0.02
"""3 mm of a cell of 156 mm: narrower ones are usual."""
LEAST_SEEN_PX, LEAST_PX, NEVER_BLUR_PX = 4.0, 3.0, 6.0
"""Blur makes a usual gap of 1 px look 2 to 4 px wide; the width without blur must be over 3 px."""


def seen_cell_gap(
    image: NDArray[np.float32], layout: ModuleLayout, pose: Pose, search: float
) -> tuple[float, float]:
    """Width and height of the dark gap between all cells, halfway between dark and light.

    Parameters
    ----------
    image : (height, width) float32
    layout : ModuleLayout
    pose : Pose
    search : float
        How far the grid may lie off, module units.

    Returns
    -------
    tuple of float
        Module units; blur makes narrow gaps look wider. 0 where no gap is seen.
    """
    lines = _lines(image, layout, pose, search)
    across, down = (float(np.median(one.width)) if one is not None else 0.0 for one in lines)
    return across, down


def cell_gap_if_wide(
    image: NDArray[np.float32], layout: ModuleLayout, pose: Pose, search: float
) -> tuple[float, float]:
    """Width and height of the gap between all cells where it is clearly wider than usual, else 0.

    Parameters and units are those of `seen_cell_gap`.
    """
    gaps = [0.0, 0.0]
    for axis, lines in enumerate(_lines(image, layout, pose, search)):
        if lines is None:
            continue
        width = float(np.median(lines.width))
        if width < LEAST_CELL_GAP or width * lines.scale < LEAST_SEEN_PX:
            continue
        resolved = width * lines.scale
        if resolved < NEVER_BLUR_PX:
            resolved = gap_width(lines.profiles, lines.x, lines.place, GAP_SHAPES[2])
        gaps[axis] = width if resolved >= LEAST_PX else 0.0
    return gaps[0], gaps[1]


@dataclass(frozen=True)
class _Lines:
    """Inner edges of one direction at which a gap is seen.

    `width` (n,) and the pixels per unit `scale` are of module units, `place` (n,) and `x` (m,) of
    pixels; `profiles` (n, m).
    """

    profiles: Array
    x: Array
    place: Array
    width: Array
    scale: float


def _lines(
    image: NDArray[np.float32], layout: ModuleLayout, pose: Pose, search: float
) -> tuple[_Lines | None, _Lines | None]:
    edges = cell_edges(layout)
    scale = float(np.nanmedian(scales_px(edges, pose)))
    widest = max(WIDEST, 2.0 * max(layout.cell_gap))
    half = int(np.ceil((0.75 * widest + search) * scale / STEP_PX)) + 2
    x: Array = STEP_PX * np.arange(-half, half + 1, dtype=np.float64)
    samples, visible = edge_profiles(image, edges, pose, x / scale, ALONG)
    profiles = np.median(samples, axis=1)
    near = np.flatnonzero(np.abs(x) <= search * scale)
    sides = np.full((len(profiles), 2), np.nan)
    for k in np.flatnonzero(visible & edges.inner):
        middle = int(near[profiles[k, near].argmin()])
        floor = float(profiles[k, middle - 1 : middle + 2].mean())
        left = _halfway(profiles[k, : middle + 1][::-1], floor)
        right = _halfway(profiles[k, middle:], floor)
        sides[k] = x[middle] - STEP_PX * left, x[middle] + STEP_PX * right
    found: list[_Lines | None] = []
    for axis in range(2):
        known = (edges.normal[:, axis] == 1) & np.isfinite(sides).all(axis=1)
        width = np.diff(sides[known])[:, 0] / scale
        lines = _Lines(profiles[known], x, sides[known].mean(axis=1), width, scale)
        found.append(lines if known.any() else None)
    return found[0], found[1]


def _halfway(side: Array, floor: float) -> float:
    """After how many samples from the middle of a gap its side has risen by half, else NaN."""
    level = 0.5 * (floor + float(np.percentile(side, 90)))
    above = np.flatnonzero(side >= level)
    if not above.size or level <= 1.2 * floor:
        return np.nan
    k = int(above[0])
    before = floor if k == 0 else float(side[k - 1])
    return k - 1 + (level - before) / max(float(side[k]) - before, 1e-12)
