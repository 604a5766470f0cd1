"""The module as one frame shows it: what super-resolution is compared with."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.geometry.grid import HrGrid
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["bicubic"]

Image = NDArray[np.float32]


# HR rows that `bicubic` projects at a time.
_ROWS = 256


def bicubic(
    sequence: FrameSequence, registration: Registration, grid: HrGrid, frame: int
) -> NDArray[np.float32]:
    """Rectify one frame by bicubic interpolation: what there is without super-resolution.

    Parameters
    ----------
    sequence : FrameSequence
    registration : Registration
    grid : HrGrid
    frame : int

    Returns
    -------
    (height, width) float32
        On the module's intensity scale; 0 where the frame does not see the module plane.
    """
    offset, gain = float(registration.offset[frame]), float(registration.gain[frame])
    image = np.ascontiguousarray((sequence.frame(frame).image - offset) / gain, dtype=np.float32)
    height, width = grid.shape
    out = np.empty(grid.shape, np.float32)
    for top in range(0, height, _ROWS):
        y, x = np.mgrid[top : min(top + _ROWS, height), :width].astype(np.float64)
        points = grid.to_module(np.stack([x, y], axis=-1))
        px = registration.camera.project(registration.homographies[frame], points)
        px = np.nan_to_num(px, nan=-10.0).astype(np.float32)
        out[top : top + _ROWS] = cv2.remap(
            image, px[..., 0], px[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT
        )
    return out
