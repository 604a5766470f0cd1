"""Where a module of known rows and columns may have wider gaps, from its outline alone.

Through the pose of the outline the module is a rectangle. Lines between cells that do not lie
evenly in it tell of a wider gap somewhere, wide dark bands between even cells of gaps between all.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.detection.line_profiles import (
    along,
    columns_at,
    line_profiles,
    rectified,
    unit_corners,
)
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose

__all__ = [
    "ALIKE",
    "CELL_GAPS",
    "LEAST_CELL_GAP_PX",
    "REACH_PX",
    "WIDTHS",
    "columns_of",
    "depth_of_lines",
    "gap_between_all",
    "proposed_layouts",
]

Array = NDArray[np.float64]

WIDTHS = np.arange(0.0, 0.61, 0.01)
"""Widths of one wider gap that are tried, cell pitches along its direction."""
CELL_GAPS = np.arange(0.02, 0.31, 0.005)
"""Widths of a gap between all cells, likewise."""
ALIKE = 0.97
"""Scores that differ by less are taken for one."""
MIDDLE = 0.1
"""Half-cut modules have their wider gap in the middle: that is tried before other places."""
REACH_PX = 1.0
"""The pose of the outline is right to about so much."""
LEAST_CORRELATION = 0.6
LEAST_CELL_GAP_PX = 2.5
"""Narrower gaps are what the usual ones look like."""
PROPOSALS = 2
"""Places of a wide gap that are tried in each direction."""


@dataclass(frozen=True)
class _Gaps:
    """One hypothesis for a direction: a wider gap after a line, or a gap between all cells."""

    score: float
    after: int = 0
    width: float = 0.0
    between: float = 0.0


def proposed_layouts(
    image: NDArray[np.float32], pose: Pose, layout: ModuleLayout
) -> Iterator[ModuleLayout]:
    """Yield layouts with wide gaps that the frame may show, likely ones first.

    Parameters
    ----------
    image : (height, width) float32
    pose : Pose
        Of the unit square that the module fills, from its outline, the right way round.
    layout : ModuleLayout
        Rows, columns and cell aspect; its own gaps are ignored.
    """
    corners = unit_corners(pose)
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    across_px, down_px = float(sides[[0, 2]].mean()), float(sides[[1, 3]].mean())
    across = _hypotheses(rectified(image, pose, across_px, True), across_px, layout.cols)
    down = _hypotheses(rectified(image, pose, down_px, False), down_px, layout.rows)
    pairs = sorted(product(across, down), key=lambda pair: -(pair[0].score + pair[1].score))
    height = 1 / layout.cell_aspect
    for x, y in pairs:
        if not (x.width or x.between or y.width or y.between):
            continue
        yield ModuleLayout(
            layout.rows,
            layout.cols,
            layout.cell_aspect,
            ((y.after, y.width * height),) if y.width else (),
            ((x.after, x.width),) if x.width else (),
            (x.between, y.between * height),
        )


def _hypotheses(module: NDArray[np.float32], side_px: float, n: int) -> list[_Gaps]:
    """What the columns of a rectified module may be: even, with a wider gap, with wide gaps."""
    width = module.shape[1]
    found = [_Gaps(0.0)]
    if n < 2:
        return found
    lr_px = width / side_px
    profiles = line_profiles(module, lr_px)
    depth = along(profiles, 0) + along(profiles, REACH_PX * lr_px)
    even = depth_of_lines(depth, np.arange(1, n) / n)
    scale = max(float(depth.max()), 1e-6)
    wider = []
    lines = np.arange(1, n)
    for after in lines.tolist() if n > 2 else ():
        # A line beyond the wide gap moves by its width, the one in it by half.
        moves = 0.5 * (1 + np.sign(lines - after))
        scores = [depth_of_lines(depth, (lines + gap * moves) / (n + gap)) for gap in WIDTHS]
        best = max(scores)
        # Lines as wide as a pixel leave a range of widths: its middle is nearest to the truth.
        good = float(WIDTHS[np.asarray(scores) >= ALIKE * best].mean())
        if good > 0 and best > even:
            gain = (best - even) / scale + (MIDDLE if 2 * after == n else 0.0)
            wider.append(_Gaps(gain, after, good))
    wider.sort(key=lambda one: -one.score)
    found += wider[:PROPOSALS]
    between, correlation = gap_between_all(columns_of(module), n)
    if correlation > LEAST_CORRELATION and between * side_px / n > LEAST_CELL_GAP_PX:
        found.append(_Gaps(correlation, between=between))
    return found


def depth_of_lines(depth: Array, places: Array) -> float:
    """Mean depth of the lines at these shares of the width; a wide gap must not count for more."""
    lines = depth[columns_at(places, len(depth))]
    return float(np.minimum(lines, np.median(lines)).mean())


def columns_of(module: NDArray[np.float32]) -> Array:
    """Brightness of the columns of a rectified module."""
    return np.asarray(np.median(module, axis=0), np.float64)


def gap_between_all(bright: Array, n: int) -> tuple[float, float]:
    """Share of the pitch that is dark between all of n cells, and how well it explains the module.

    The score is the correlation of the brightness of the columns with the cells of that width.
    """
    # Cells differ in brightness, and lenses shade: every place is compared with its surroundings.
    pitch = np.ones((1, round(len(bright) / n) | 1), np.uint8)
    bright = bright / np.maximum(cv2.dilate(bright[None], pitch)[0], 1e-6)
    bright = bright - bright.mean()
    place = (np.arange(len(bright)) + 0.5) / len(bright)
    best, score = 0.0, 0.0
    for gap in CELL_GAPS if n > 1 else ():
        # The outline runs around the cells: n cells and n - 1 gaps fill it.
        in_pitch = (place * (n - gap)) % 1.0
        cells = (in_pitch < 1 - gap).astype(np.float64)
        cells -= cells.mean()
        norm = np.linalg.norm(cells) * np.linalg.norm(bright)
        correlation = float(cells @ bright / norm) if norm > 0 else 0.0
        if correlation > score:
            best, score = float(gap), correlation
    return best, score
