"""Pictures of the cells for the gallery: one contrast for all, cracks in orange. No Qt."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from napari_pv_inspect.appearance import CRACK_RGB, contrast_limits
from pv_inspect.cells import CellTiles
from pv_inspect.cracks import CrackMap

__all__ = ["cell_pictures"]


def cell_pictures(tiles: CellTiles, cracks: CrackMap | None, opacity: float) -> NDArray[np.uint8]:
    """Tiles as pictures (rows, cols, h, w, 3).

    One contrast for the whole module: a dark cell has to look dark beside the others.

    Parameters
    ----------
    tiles : CellTiles
    cracks : CrackMap, optional
        Marked where its probability passes its threshold.
    opacity : float
        Of the mark, 0 to 1.
    """
    low, high = contrast_limits(tiles.images)
    grey = np.clip((tiles.images - low) / (high - low), 0.0, 1.0)
    pictures = np.repeat(grey[..., None], 3, axis=-1)
    if cracks is not None and opacity > 0:
        colour = np.array(CRACK_RGB, dtype=np.float32)
        for row, col in np.ndindex(*tiles.images.shape[:2]):
            cracked = cracks.probability[tiles.grid.cell_slices(row, col)] >= cracks.threshold
            picture = pictures[row, col]
            picture[cracked] = (1 - opacity) * picture[cracked] + opacity * colour
    return np.asarray(np.round(pictures * 255), dtype=np.uint8)
