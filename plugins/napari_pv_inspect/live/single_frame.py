"""A cell as the best single frame shows it: its own pixels, and interpolated. No Qt."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.observation.motion_blur import motion_of
from pv_inspect.reconstruction.single_frame import bicubic
from pv_inspect.registration.registration import Registration
from pv_inspect.review import Cell

__all__ = ["FramePanels", "best_frame", "contours", "frame_panels"]

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


def best_frame(inspection: Inspection, cell: Cell) -> int | None:
    """Return the frame that resolves a cell best; None if none shows all of it.

    A pixel and its motion blur add as squares; the frame in which both are the smallest part of
    the cell is the best.
    """
    registration, made = inspection.registration, inspection.reconstruction
    if registration is None or made is None:
        return None
    row, col = cell
    aspect = registration.layout.cell_aspect
    corners = np.array([[col, row], [col + 1, row], [col + 1, row + 1], [col, row + 1]], float)
    corners[:, 1] /= aspect
    height, width = inspection.sequence.shape
    scores = {}
    for i in np.flatnonzero(registration.used):
        px = registration.camera.project(registration.homographies[i], corners)
        if not np.isfinite(px).all() or (px < 0).any() or (px > [width - 1, height - 1]).any():
            continue
        area = cv2.contourArea(px.astype(np.float32))
        blur = 1.0 + float(np.sum(motion_of(*made.motion[i]) ** 2))
        scores[int(i)] = area / blur
    return max(scores, key=lambda i: scores[i], default=None)


def frame_panels(inspection: Inspection, cell: Cell) -> FramePanels:
    """Rectify a cell out of its best frame.

    Raises
    ------
    InspectionError
        If no frame shows the whole cell, or the frame can't be read any more.
    """
    frame = best_frame(inspection, cell)
    registration, made = inspection.registration, inspection.reconstruction
    if frame is None or registration is None or made is None:
        raise InspectionError("No frame shows the whole cell.")
    window = made.grid.window(*made.grid.cell_slices(*cell))
    return FramePanels(
        frame,
        inspection.sequence.names[frame],
        _nearest(inspection, registration, window, frame),
        bicubic(inspection.sequence, registration, window, frame),
    )


def _nearest(inspection: Inspection, registration: Registration, grid: HrGrid, frame: int) -> Image:
    offset, gain = float(registration.offset[frame]), float(registration.gain[frame])
    image = np.asarray((inspection.sequence.frame(frame).image - offset) / gain, np.float32)
    y, x = np.mgrid[: grid.shape[0], : grid.shape[1]].astype(np.float64)
    points = grid.to_module(np.stack([x, y], axis=-1))
    px = registration.camera.project(registration.homographies[frame], points)
    px = np.nan_to_num(px, nan=-10.0).astype(np.float32)
    found = cv2.remap(
        image, px[..., 0], px[..., 1], cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT
    )
    return np.asarray(found, np.float32)


def contours(mask: NDArray[np.bool_]) -> list[Points]:
    """Outlines of a mask, each (n, 2) as (x, y); pixel (i, j) covers [j, j + 1] x [i, i + 1]."""
    # OpenCV goes through the centres of pixels: of finer ones it keeps outside of thin cracks.
    fine = 4 if mask.size <= 400 * 400 else 2
    large = np.kron(mask, np.ones((fine, fine), bool)).astype(np.uint8)
    found, _ = cv2.findContours(large, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    return [(line[:, 0].astype(np.float64) + 0.5) / fine for line in found]
