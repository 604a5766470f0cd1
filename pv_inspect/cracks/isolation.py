"""What cracks would cut off from the busbars if no current crossed them.

Current leaves a cell along the fingers, thin lines across the busbars, to the next busbar on either
side. In the worst case a crack breaks every finger that it crosses: a point is cut off if cracks,
or the edge of the cell, lie between it and the busbars on both sides of its finger [1]_.

References
----------
.. [1] X. Chen et al., "Automatic Crack Segmentation and Feature Extraction in Electroluminescence
       Images of Solar Modules", IEEE Journal of Photovoltaics 13, 2023.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.cracks.flatten import CELL_PX, find_lines

__all__ = ["Busbars", "busbars_from_image", "busbars_from_map", "isolated_share"]

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

# A row belongs to a busbar if the mean of its busbar probability is at least this.
_LEVEL = 0.4


@dataclass(frozen=True, eq=False)
class Busbars:
    """Where the busbars of a cell lie; they go from edge to edge.

    Parameters
    ----------
    horizontal : bool
        Along rows of pixels, else along columns.
    lines : (n,) bool
        Rows (columns) that a busbar covers; n is the height (width) of the cell.
    """

    horizontal: bool
    lines: Mask

    @property
    def count(self) -> int:
        """Number of busbars."""
        return int((np.diff(self.lines.astype(np.int8), prepend=0) == 1).sum())


def busbars_from_map(probability: Image) -> Busbars | None:
    """Find busbars in the busbar probability of a cell, or in its mean over cells of one module.

    Parameters
    ----------
    probability : (h, w) float32

    Returns
    -------
    Busbars or None
        None if there are none.
    """
    rows, cols = probability.mean(1), probability.mean(0)
    horizontal = bool(rows.max() >= cols.max())
    lines = (rows if horizontal else cols) >= _LEVEL
    return Busbars(horizontal, lines) if lines.any() else None


def busbars_from_image(tile: Image) -> Busbars | None:
    """Find busbars as lines from edge to edge in the image of a cell.

    It is meant for the mean of all cells of a module: in a single cell, cracks and texture may
    look like a line.

    Parameters
    ----------
    tile : (h, w) float32
        Any brightness scale.

    Returns
    -------
    Busbars or None
    """
    h, w = tile.shape
    scale = CELL_PX / max(h, w)
    size = (max(round(w * scale), 8), max(round(h * scale), 8))
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    image = np.asarray(cv2.resize(tile, size, interpolation=way), np.float32)
    image = image / max(float(np.median(image)), 1e-6)
    found = [find_lines(image, axis) for axis in (0, 1)]
    if not (found[0].any() or found[1].any()):
        return None
    # Of both directions the one with the darker lines.
    depth = [
        float((1 - image.mean(1 - axis)[lines]).mean()) if lines.any() else -np.inf
        for axis, lines in enumerate(found)
    ]
    axis = int(np.argmax(depth))
    n = tile.shape[axis]
    lines = cv2.resize(found[axis].astype(np.uint8)[None], (n, 1), interpolation=cv2.INTER_NEAREST)
    return Busbars(axis == 0, np.asarray(lines[0] > 0))


def isolated_share(cracks: Mask, busbars: Busbars) -> NDArray[np.float32]:
    """Return the share of each pixel that cracks would cut off from every busbar.

    Parameters
    ----------
    cracks : (h, w) bool
    busbars : Busbars

    Returns
    -------
    (h, w) float32
        1 where it is cut off, 0 where it is not; 0.5 on the width of a crack that lies between the
        two, so that the area ends at the middle of the crack.
    """
    if not busbars.horizontal:
        turned = Busbars(True, busbars.lines)
        return np.ascontiguousarray(isolated_share(cracks.T, turned).T)
    cracks = cracks & ~busbars.lines[:, None]
    bars = np.broadcast_to(busbars.lines[:, None], cracks.shape)
    fed_above, free_above = _from_above(cracks, bars)
    fed_below, free_below = (part[::-1] for part in _from_above(cracks[::-1], bars[::-1]))
    free_below = np.where(free_below >= 0, len(cracks) - 1 - free_below, -1)
    cut = ~(fed_above | fed_below | cracks)
    # A pixel of a crack looks at the first ones above and below it that are none; there is
    # nothing cut off beyond the edge.
    share = np.zeros(cracks.shape, np.float32)
    for rows in (free_above, free_below):
        met = np.asarray(np.take_along_axis(cut, np.maximum(rows, 0), 0), bool)
        share += 0.5 * (met & (rows >= 0))
    return np.where(cracks, share, cut).astype(np.float32)


def _from_above(cracks: Mask, bars: Mask) -> tuple[Mask, NDArray[np.intp]]:
    """Whether each pixel is fed from above, and the row of the next one above that is no crack."""
    row = np.arange(cracks.shape[0])[:, None]

    def last(mask: Mask) -> NDArray[np.intp]:
        return np.maximum.accumulate(np.where(mask, row, -1), axis=0)

    return last(bars) > last(cracks), last(~cracks)
