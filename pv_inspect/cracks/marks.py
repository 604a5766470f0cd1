"""Marks that a crack could have made, and from when on they count."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["OperatingPoint", "crack_marks"]

# A crack is long and slender, a cluster of dark grains is neither. Longer side of a mark's
# smallest rectangle over the other one; a large mark (cell widths) may be a crack that branches
# and need not be slender.
MIN_SLENDERNESS = 2.0
_LARGE_EXTENT_CELLS = 0.25


@dataclass(frozen=True)
class OperatingPoint:
    """From when on a detector's answer counts as a crack.

    Parameters
    ----------
    threshold : float
        Least probability of a pixel.
    least_extent_cells : float
        Least length of a mark, cell widths.
    least_length_cells : float
        Least length of the longest mark along its centre line, cell widths, from which on a cell
        gets a class. A cell whose marks are all shorter can't be judged.
    least_score : float
        Least `CellFeatures.crack_score` from which on a cell gets a class.
    """

    threshold: float = 0.5
    least_extent_cells: float = 0.15
    least_length_cells: float = 0.0
    least_score: float = 0.0


def crack_marks(
    probability: NDArray[np.float32],
    threshold: float,
    cell_width_px: float,
    least_extent_cells: float = OperatingPoint.least_extent_cells,
) -> list[NDArray[np.bool_]]:
    """Find the marks of a cell that a crack could have made.

    Parameters
    ----------
    probability : (h, w) float32
        Crack probability of the pixels of one cell.
    threshold : float
        Pixels with at least this probability belong to marks.
    cell_width_px : float
        Pixels per cell width.
    least_extent_cells : float
        Cell widths.

    Returns
    -------
    list of (h, w) bool
        8-connected; the smallest rectangle around each is at least ``least_extent_cells`` long,
        and twice as long as wide unless it is longer than 0.25 cell widths.
    """
    mask = (probability >= max(threshold, 1e-6)).astype(np.uint8)
    n_labels, labels, boxes, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    marks = []
    for k in range(1, n_labels):
        x, y, width, height, _ = boxes[k]
        if np.hypot(width, height) < least_extent_cells * cell_width_px:
            continue
        pixels = np.argwhere(labels[y : y + height, x : x + width] == k).astype(np.float32)
        # The rectangle goes through the centres of pixels, which reach half a pixel further.
        short, long = sorted(side + 1 for side in cv2.minAreaRect(pixels)[1])
        extent = long / cell_width_px
        slender = long >= MIN_SLENDERNESS * short or extent >= _LARGE_EXTENT_CELLS
        if extent >= least_extent_cells and slender:
            marks.append(labels == k)
    return marks
