"""A cell as the best single frame shows it: its own pixels, and interpolated. No Qt."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.reconstruction.single_frame import best_frame, bicubic, nearest
from pv_inspect.review import Cell

__all__ = ["FramePanels", "contours", "frame_panels"]

Image = NDArray[np.float32]
Points = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FramePanels:
    """What one frame shows of a cell, on the HR pixels of the cell.

    Attributes
    ----------
    frame : int
    name : str
        Of its file.
    nearest, bicubic : (h, w) float32
        Every HR pixel as the LR pixel that it lies in, and interpolated; full scale = 1.
    """

    frame: int
    name: str
    nearest: Image
    bicubic: Image


def frame_panels(inspection: Inspection, cell: Cell) -> FramePanels:
    """Rectify a cell out of its best frame.

    Raises
    ------
    InspectionError
        If no frame shows the whole cell, or the frame can't be read any more.
    """
    registration, made = inspection.registration, inspection.reconstruction
    if registration is None or made is None:
        raise InspectionError("There is no module image yet.")
    frame = best_frame(registration, inspection.frames.shape, cell, made.motion)
    if frame is None:
        raise InspectionError("No frame in use shows the whole cell.")
    window = made.grid.window(*made.grid.cell_slices(*cell))
    return FramePanels(
        frame,
        inspection.frames.names[frame],
        nearest(inspection.frames, registration, window, frame),
        bicubic(inspection.frames, registration, window, frame),
    )


def contours(mask: NDArray[np.bool_]) -> list[Points]:
    """Outlines of a mask, each (n, 2) as (x, y); pixel (i, j) covers [j, j + 1] x [i, i + 1]."""
    # OpenCV goes through the centres of pixels: of finer ones it keeps outside of thin cracks.
    fine = 4 if mask.size <= 400 * 400 else 2
    large = np.kron(mask, np.ones((fine, fine), bool)).astype(np.uint8)
    found, _ = cv2.findContours(large, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    return [(line[:, 0].astype(np.float64) + 0.5) / fine for line in found]
