"""The gap between all cells of a module whose grid is known: how wide it is, and whether it is.

Cells that lie apart by some pixels have lines between them like others, wherever in the wide gap
these are found: the grid of a module without wide gaps may seem to fit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pv_inspect.detection.edges import ALONG, CellEdges, cell_edges, edge_profiles, scales_px
from pv_inspect.detection.gap_model import GAP_SHAPES, STEP_PX, typical_significance
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose

__all__ = ["apart_significance", "seen_cell_gap"]

Array = NDArray[np.float64]

WIDEST = 0.3
"""Of the gaps that are looked for, cell widths."""


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
    edges = cell_edges(layout)
    scale = float(np.nanmedian(scales_px(edges, pose)))
    widest = max(WIDEST, 2.0 * max(layout.cell_gap))
    half = int(np.ceil((0.75 * widest + search) * scale / STEP_PX)) + 2
    x: Array = STEP_PX * np.arange(-half, half + 1, dtype=np.float64)
    samples, visible = edge_profiles(image, edges, pose, x / scale, ALONG)
    profiles = np.median(samples, axis=1)
    near = np.abs(x) <= search * scale
    width = np.full(len(profiles), np.nan)
    for k in np.flatnonzero(visible & edges.inner):
        middle = int(np.flatnonzero(near)[profiles[k, near].argmin()])
        floor = float(profiles[k, middle - 1 : middle + 2].mean())
        sides = profiles[k, : middle + 1][::-1], profiles[k, middle:]
        width[k] = STEP_PX * sum(_halfway(side, floor) for side in sides) / scale
    measured = []
    for axis in range(2):
        known = width[(edges.normal[:, axis] == 1) & np.isfinite(width)]
        measured.append(float(np.median(known)) if known.size else 0.0)
    return measured[0], measured[1]


def _halfway(side: Array, floor: float) -> float:
    """After how many samples from the middle of a gap its side has risen by half, else NaN."""
    level = 0.5 * (floor + float(np.percentile(side, 90)))
    above = np.flatnonzero(side >= level)
    if not above.size or level <= 1.2 * floor:
        return np.nan
    k = int(above[0])
    before = floor if k == 0 else float(side[k - 1])
    return k - 1 + (level - before) / max(float(side[k]) - before, 1e-12)


def apart_significance(
    image: NDArray[np.float32], layout: ModuleLayout, pose: Pose, search: float
) -> float:
    """How significant the gaps of a layout typically are, in the worse direction.

    Those of a layout whose gaps are as wide as they are in the frame are the most significant.
    """
    edges = cell_edges(layout)
    found = []
    for axis in range(2):
        part = edges.part(edges.inner & (edges.normal[:, axis] == 1))
        if len(part.middle):
            found.append(_significance(image, part, pose, search, layout.cell_gap[axis]))
    return min(found, default=0.0)


def _significance(
    image: NDArray[np.float32], edges: CellEdges, pose: Pose, search: float, gap: float
) -> float:
    scale = float(np.nanmedian(scales_px(edges, pose)))
    reach = search * scale + max(shape.reach for shape in GAP_SHAPES) + 0.5 * gap * scale
    half = int(np.ceil(reach / STEP_PX)) + 2
    x: Array = STEP_PX * np.arange(-half, half + 1, dtype=np.float64)
    samples, visible = edge_profiles(image, edges, pose, x / scale, ALONG)
    if not visible.any():
        return 0.0
    return typical_significance(samples.mean(axis=1)[visible], x, search * scale, gap * scale)
