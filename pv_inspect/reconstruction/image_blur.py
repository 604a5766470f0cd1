"""How blurred a module image is, measured at the edges of its cells.

The PSF of one photograph can't be told from its pixels, and a photograph out of focus agrees with
any PSF that is assumed. But every cell ends at a sharp edge, mostly at a narrow dark gap: how
softly the image shows it is what blur is left, whatever the frames and the prior have made of it.
What blurred the frames, before any image is made, is measured by
`pv_inspect.reconstruction.border_blur`.
"""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from pv_inspect.geometry.grid import HrGrid

__all__ = ["image_blur"]

Array = NDArray[np.float64]
Image = NDArray[np.float32]

# Reach of a profile across an edge and its samples, cell widths; share of the edge that is looked
# at, without the corners; pieces of it, so that a bent edge does not look blurred.
_REACH, _SAMPLES = 0.1, 81
_ALONG = (0.08, 0.92)
_PIECES = 3
# Blur, widths of gaps and places of an edge that are tried, cell widths. Gaps are 2 to 5 mm.
_BLURS = np.geomspace(0.003, 0.06, 19)
_GAPS = (0.0, 0.008, 0.014, 0.02, 0.028, 0.036, 0.046, 0.06)
_PLACES = np.linspace(-0.03, 0.03, 13)
# Fainter edges, in parts of the brightness beside them, are not measured.
_LEAST_CONTRAST = 0.15
_LEAST_EDGES = 4


def image_blur(image: Image, grid: HrGrid) -> Image:
    """Measure the blur of a module image around every cell.

    Parameters
    ----------
    image : (height, width) float32
    grid : HrGrid

    Returns
    -------
    (rows, cols) float32
        Standard deviation, cell widths: the median over the pieces of the edges of a cell and its
        neighbours, of the module where too few can be measured; NaN if none can.

    Notes
    -----
    A profile across an edge is ``a + b x + c S(x / s) - d G(x)``: a slope, a step S between two
    sides (normal distribution) and a gap G (box), both blurred with the standard deviation s. The
    s, width and place of the gap with the least squares are taken from a table. Wafers have soft
    edges of their own: a sharp image gives about 0.007.
    """
    rows, cols = grid.layout.rows, grid.layout.cols
    profiles = np.array(
        [_profiles(image, grid, row, col) for row, col in np.ndindex(rows, cols)], np.float64
    ).reshape(rows, cols, -1, _SAMPLES)
    found = _fitted(profiles.reshape(-1, _SAMPLES)).reshape(rows, cols, -1)
    whole = found[np.isfinite(found)]
    if whole.size < _LEAST_EDGES:
        return np.full((rows, cols), np.nan, np.float32)
    out = np.empty((rows, cols), np.float32)
    for row, col in np.ndindex(rows, cols):
        around = found[max(row - 1, 0) : row + 2, max(col - 1, 0) : col + 2]
        seen = around[np.isfinite(around)]
        out[row, col] = np.median(seen if seen.size >= _LEAST_EDGES else whole)
    return out


def _profiles(image: Image, grid: HrGrid, row: int, col: int) -> list[Image]:
    """Profiles across the pieces of the four edges of a cell, from left or top on."""
    layout = grid.layout
    across = np.linspace(-_REACH, _REACH, _SAMPLES)[:, None]
    gap_x, gap_y = (gap / 2 for gap in layout.cell_gap)
    left, top = float(layout.col_starts[col]), float(layout.row_starts[row])
    right, bottom = left + float(layout.widths[col]), top + float(layout.heights[row])
    found: list[Image] = []
    for low, high, first, last, upright in (
        (top, bottom, left + gap_x, right - gap_x, True),
        (left, right, top + gap_y, bottom - gap_y, False),
    ):
        n = max(round((high - low) * grid.pixels_per_unit), 2 * _PIECES)
        along = low + (high - low) * np.linspace(*_ALONG, n)[None]
        for edge in (first, last):
            points = (edge + across + 0 * along, along + 0 * across)
            places = grid.to_pixels(np.stack(points if upright else points[::-1], axis=-1))
            x, y = np.moveaxis(places.astype(np.float32), -1, 0)
            seen = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            parts = np.array_split(np.asarray(seen, np.float32), _PIECES, axis=1)
            found += [np.asarray(np.median(part, axis=1), np.float32) for part in parts]
    return found


def _fitted(profiles: Array) -> Array:
    """Blur of every profile (n, samples); NaN where there is no edge."""
    blurs, shapes, spaces = _table()
    explained = np.zeros((len(blurs), len(profiles)))
    for axis in range(spaces.shape[1]):
        explained += (spaces[:, axis] @ profiles.T) ** 2
    best = explained.argmax(axis=0)
    found = np.full(len(profiles), np.nan)
    for k, profile in enumerate(profiles):
        base, _, step, gap = np.linalg.lstsq(shapes[best[k]].T, profile, rcond=None)[0]
        contrast = max(gap / max(base, 1e-6), abs(step) / max(base + abs(step) / 2, 1e-6))
        if contrast >= _LEAST_CONTRAST:
            found[k] = blurs[best[k]]
    return found


@cache
def _table() -> tuple[Array, Array, Array]:
    """Blur (n,), the four parts (n, 4, samples) of every profile, and the same orthonormal."""
    at = np.linspace(-_REACH, _REACH, _SAMPLES)
    blurs, shapes = [], []
    for blur in _BLURS:
        for gap in _GAPS:
            for place in _PLACES:
                x = at - place
                dip = ndtr((x + gap / 2) / blur) - ndtr((x - gap / 2) / blur)
                if not gap:
                    dip = np.exp(-((x / blur) ** 2) / 2)
                blurs.append(blur)
                shapes.append([np.ones_like(x), x / _REACH, ndtr(x / blur) - 0.5, -dip])
    parts = np.array(shapes)
    spaces = np.linalg.qr(parts.transpose(0, 2, 1))[0].transpose(0, 2, 1)
    return np.array(blurs), parts, np.ascontiguousarray(spaces)
