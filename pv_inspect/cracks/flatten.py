"""A cell without what looks like a crack but is none: busbars, borders, slow brightness."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

__all__ = ["CELL_PX", "FlatCell", "find_lines", "flatten"]

Image = NDArray[np.float32]

# Cells are brought to this size (longer side), so that every scale is one relative to the cell.
CELL_PX = 256
# A row or column belongs to a line if it differs from its surroundings by this share: in the
# median, in the 80th percentile (broad dark lines), in the 20th (dashed busbars).
_LINE_CONTRAST = ((50, 0.10), (80, 0.07), (20, 0.14))


@dataclass(frozen=True, eq=False)
class FlatCell:
    """A cell at the working size, made even.

    Parameters
    ----------
    contrast : (h, w) float32
        (image - background) / background, with busbars filled from their sides; 0 outside.
    background : (h, w) float32
        Slow brightness, median of the cell = 1.
    outside : (h, w) bool
        Border of the cell and the gap beyond it.
    lines : (h, w) bool
        Busbars.
    """

    contrast: Image
    background: Image
    outside: NDArray[np.bool_]
    lines: NDArray[np.bool_]


def flatten(tile: Image) -> FlatCell:
    """Take the brightness, the busbars and the border out of a cell.

    Parameters
    ----------
    tile : (h, w) float32
        Any brightness scale.

    Returns
    -------
    FlatCell
    """
    scale = CELL_PX / max(tile.shape)
    size = (max(round(tile.shape[1] * scale), 8), max(round(tile.shape[0] * scale), 8))
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    image = np.asarray(cv2.resize(tile, size, interpolation=way), np.float32)
    h, w = image.shape
    median = float(np.median(image[h // 10 : -(h // 10) or None, w // 10 : -(w // 10) or None]))
    image /= max(median, 1e-6)
    outside = _outside(image)
    rows, cols = _widen(find_lines(image, 0)), _widen(find_lines(image, 1))
    filled = _fill_rows(_fill_rows(image, rows).T, cols).T
    inside = (~outside).astype(np.float32)
    background = _smooth_inside(filled, inside, 0.05 * CELL_PX)
    contrast = np.where(outside, 0.0, filled - background) / np.maximum(background, 0.15)
    contrast = contrast * cv2.GaussianBlur(inside, (0, 0), 1.0)
    return FlatCell(
        np.asarray(contrast, np.float32), background, outside, rows[:, None] | cols[None, :]
    )


def find_lines(image: Image, axis: int) -> NDArray[np.bool_]:
    """Find the rows (axis 0) or columns (axis 1) that a straight line fills from edge to edge.

    Busbars are parallel to the cell's edges, cracks hardly ever: where a row differs from the
    rows around it as a whole, in its median or in an upper or lower percentile, it is a busbar.

    Parameters
    ----------
    image : (h, w) float32
        Cell, about `CELL_PX` large.
    axis : int

    Returns
    -------
    (h,) or (w,) bool
    """
    found = np.zeros(image.shape[axis], bool)
    window = round(0.06 * CELL_PX) | 1
    for percentile, contrast in _LINE_CONTRAST:
        profile = np.percentile(image, percentile, axis=1 - axis)
        around = median_filter(profile, window, mode="nearest")
        floor = 0.05 * float(profile.max())
        found |= np.abs(profile - around) > contrast * np.maximum(around, floor)
    edge = int(0.03 * CELL_PX)
    found[:edge] = found[-edge:] = False
    return found


def _widen(lines: NDArray[np.bool_]) -> NDArray[np.bool_]:
    wide = lines.copy()
    wide[1:] |= lines[:-1]
    wide[:-1] |= lines[1:]
    return wide


def _fill_rows(image: Image, rows: NDArray[np.bool_]) -> Image:
    """Replace rows by what lies above and below, linearly."""
    good, bad = np.flatnonzero(~rows), np.flatnonzero(rows)
    if not bad.size or good.size < 2:
        return image
    after = np.clip(np.searchsorted(good, bad), 1, good.size - 1)
    a, b = good[after - 1], good[after]
    share = np.clip((bad - a) / (b - a), 0, 1).astype(np.float32)[:, None]
    filled = image.copy()
    filled[bad] = image[a] * (1 - share) + image[b] * share
    return filled


def _outside(image: Image) -> NDArray[np.bool_]:
    """Dark pixels joined to the edge of the tile and near to it: gap and cut corners."""
    _, labels = cv2.connectedComponents((image < 0.45).astype(np.uint8), connectivity=4)
    frame = np.ones(image.shape, bool)
    frame[1:-1, 1:-1] = False
    near = np.ones(image.shape, bool)
    reach = int(0.1 * CELL_PX)
    near[reach:-reach, reach:-reach] = False
    joined = np.unique(labels[frame])
    outside = np.isin(labels, joined[joined > 0]) & near
    outside[:2] = outside[-2:] = True
    outside[:, :2] = outside[:, -2:] = True
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))
    return np.asarray(cv2.dilate(outside.astype(np.uint8), disc) > 0)


def _smooth_inside(image: Image, inside: Image, sigma: float) -> Image:
    """Gaussian mean over the pixels inside only."""
    total = cv2.GaussianBlur(image * inside, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
    weight = cv2.GaussianBlur(inside, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
    return np.asarray(total / np.maximum(weight, 1e-3), np.float32)
