"""A module image on another grid of the same module."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.geometry.grid import HrGrid

__all__ = ["resampled"]

Image = NDArray[np.float32]


def resampled(image: Image, known: HrGrid, grid: HrGrid) -> Image:
    """Interpolate an image of a module onto another grid, bicubic.

    Parameters
    ----------
    image : (height, width) float32
    known : HrGrid
        Where its pixels lie.
    grid : HrGrid
        Where they are wanted; of the same pitch, it must lie within ``known`` at whole pixels.

    Returns
    -------
    (height, width) float32
        On ``grid``; beyond the image its last pixels go on.
    """
    # Pixels of the known image under the first pixels of the grid, and their pitch.
    x, y = known.to_pixels(grid.to_module(np.zeros(2)))
    pitch = known.pixels_per_unit / grid.pixels_per_unit
    height, width = grid.shape
    if pitch == 1.0:
        left, top = round(x), round(y)
        return image[top : top + height, left : left + width].copy()
    placed = cv2.warpAffine(
        image,
        np.array([[pitch, 0.0, x], [0.0, pitch, y]]),
        (width, height),
        flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.asarray(placed, np.float32)
