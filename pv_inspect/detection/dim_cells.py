"""Modules of which many cells are dead: their outline is that of all that is not background."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.detection.grid_check import cell_levels, is_lit
from pv_inspect.detection.outline import OutlineError
from pv_inspect.detection.single_frame import Found, find_module
from pv_inspect.geometry.layout import ModuleLayout

__all__ = ["module_with_dim_cells"]

Image = NDArray[np.float32]

MIN_DIM_SHARE = 0.1
"""Where fewer cells are dim, the outline of the bright ones holds the module, or none of them does:
another outline would only be a further trial for wrong rows and columns."""
DIM_SIGMA = 6.0
"""Least height of dim cells above the background, in spreads of the background."""


def module_with_dim_cells(
    image: Image, layout: ModuleLayout, inside: tuple[float, float] | None = None
) -> Found:
    """Find a module in one frame of which about half of the cells are nearly dead.

    Parameters
    ----------
    image : (height, width) float32
    layout : ModuleLayout
    inside : tuple of float, optional
        (x, y) of a point in the wanted module, LR pixels.

    Returns
    -------
    Found

    Raises
    ------
    OutlineError
        If there is none, or if few of its cells are dim (`find_module` is for these).
    """
    found = find_module(image, layout, inside, outlined=_up_to_dim(image))
    if is_lit(cell_levels(image, layout, found.pose)).mean() > 1 - MIN_DIM_SHARE:
        raise OutlineError("no module with dim cells")
    return found


def _up_to_dim(image: Image) -> Image:
    """Image in which bright cells are no brighter than dim ones.

    Raises
    ------
    OutlineError
        If nothing is between the background and what is bright.
    """
    smooth = np.asarray(cv2.GaussianBlur(image, (0, 0), 1.5), np.float32)
    dark = smooth[smooth < _split(smooth)]
    split = _split(dark)
    background, dim = dark[dark < split], dark[dark >= split]
    if background.size and dim.size:
        level = float(np.median(background))
        spread = 1.4826 * float(np.median(np.abs(background - level)))
        top = float(np.median(dim))
        if top - level > DIM_SIGMA * spread:
            return np.minimum(image, np.float32(top))
    raise OutlineError("no dim cells")


def _split(values: NDArray[np.float32]) -> float:
    """Threshold between two classes of values, after Otsu."""
    if not values.size:
        return 0.0
    low, high = (float(v) for v in np.percentile(values, [1, 99]))
    scaled = (255 * np.clip((values - low) / max(high - low, 1e-6), 0, 1)).astype(np.uint8)
    threshold, _ = cv2.threshold(scaled, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    return float(low + threshold / 255 * (high - low))
