"""Shares of a cell's area and of its cracks' length: dark, cut off, not supported by the frames."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.cracks.centreline import length_of
from pv_inspect.cracks.isolation import Busbars, isolated_share

__all__ = [
    "UNSUPPORTED",
    "dark_shares",
    "isolated",
    "support_on",
    "unsupported_share",
    "usual_brightness",
]

# The cell's edge belongs to the gap between cells, and thin dark lines are no dark area.
_BORDER_CELLS = 0.04
_DARK_MIN_WIDTH_CELLS = 0.05
_DARK_LEVEL = 0.5
# Frames that all stand in one place reach about this support
# (`pv_inspect.reconstruction.support`): pixels with less show no detail that is finer than the
# pixels of a frame and comes from the frames.
UNSUPPORTED = 0.1


def unsupported_share(chains: list[NDArray[np.float64]], support: NDArray[np.float32]) -> float:
    """Share of the length of chains that lies on unsupported pixels; of all pixels if it is 0.

    Parameters
    ----------
    chains : list of (n, 2) float64
        (row, column) of points of centre lines.
    support : (h, w) float32

    Returns
    -------
    float
    """
    low = support < UNSUPPORTED
    total = sum(length_of(chain) for chain in chains)
    if not total:
        return float(low.mean())
    bad = 0.0
    for chain in chains:
        middle = np.rint((chain[1:] + chain[:-1]) / 2).astype(int)
        y, x = np.clip(middle, 0, np.array(low.shape) - 1).T
        bad += float(np.hypot(*np.diff(chain, axis=0).T)[low[y, x]].sum())
    return bad / total


def support_on(support: NDArray[np.float32] | None, marks: list[NDArray[np.bool_]]) -> float:
    """Mean support on the marks, over the cell if there are none; NaN if it is not known."""
    if support is None:
        return float("nan")
    seen = support[np.logical_or.reduce(marks)] if marks else support
    return float(seen.mean(dtype=np.float64))


def isolated(
    tile: NDArray[np.float32], marks: list[NDArray[np.bool_]], busbars: Busbars | None
) -> tuple[float, float]:
    """Share of the cell that would be cut off, and its brightness relative to the rest.

    Parameters
    ----------
    tile : (h, w) float32
    marks : list of (h, w) bool
    busbars : Busbars or None
        Without them both are NaN.

    Returns
    -------
    tuple of two floats
    """
    if busbars is None:
        return float("nan"), float("nan")
    if not marks:
        return 0.0, float("nan")
    share = isolated_share(np.logical_or.reduce(marks), busbars)
    cut = share == 1
    border = max(round(_BORDER_CELLS * max(tile.shape)), 1)
    inside = np.zeros(tile.shape, bool)
    inside[border:-border, border:-border] = True
    cut &= inside
    lines = busbars.lines[:, None] if busbars.horizontal else busbars.lines[None]
    rest = (share == 0) & ~lines & inside
    known = bool(cut.any() and rest.any())
    brightness = tile[cut].mean() / max(float(tile[rest].mean()), 1e-9) if known else math.nan
    return float(share.mean(dtype=np.float64)), float(brightness)


def usual_brightness(images: Sequence[NDArray[np.float32]]) -> float:
    """Brightness of the cells of a module that work: the median over them.

    A cell works if its median is at least half of what nine tenths of the cells do not exceed. So
    dead cells are dark even where they are the majority.

    Parameters
    ----------
    images : (h, w) float32 each
        All cells.

    Returns
    -------
    float
    """
    level = np.array([np.median(image) for image in images])
    works = level >= _DARK_LEVEL * np.percentile(level, 90)
    bright = [image.ravel() for image, keep in zip(images, works, strict=True) if keep]
    return float(np.median(np.concatenate(bright)))


def dark_shares(
    tile: NDArray[np.float32], usual: float, cell_width_px: float
) -> tuple[float, float]:
    """Shares of the cell: all broad dark areas, and the largest connected one.

    Parameters
    ----------
    tile : (h, w) float32
    usual : float
        Usual brightness of the module in the units of ``tile``; less than half of it is dark.
    cell_width_px : float

    Returns
    -------
    tuple of two floats
    """
    border = max(round(_BORDER_CELLS * cell_width_px), 1)
    inside = tile[border:-border, border:-border]
    if not inside.size:
        return 0.0, 0.0
    dark = (inside < _DARK_LEVEL * usual).astype(np.uint8)
    size = 2 * (round(_DARK_MIN_WIDTH_CELLS * cell_width_px) // 2) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    broad = cv2.morphologyEx(dark, cv2.MORPH_OPEN, disc)
    areas = cv2.connectedComponentsWithStats(broad, connectivity=8)[2][1:, cv2.CC_STAT_AREA]
    return float(broad.mean()), float(areas.max(initial=0) / broad.size)
