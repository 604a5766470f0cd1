"""The module as one frame shows it: what super-resolution is compared with."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.geometry.grid import HrGrid
from pv_inspect.observation.motion_blur import motion_of
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["best_frame", "bicubic", "nearest"]

Image = NDArray[np.float32]


# HR rows that are projected at a time.
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
    return _rectified(sequence, registration, grid, frame, cv2.INTER_CUBIC)


def nearest(
    sequence: FrameSequence, registration: Registration, grid: HrGrid, frame: int
) -> NDArray[np.float32]:
    """Rectify one frame without interpolation: the pixels that the camera has delivered.

    Parameters and result are those of `bicubic`.
    """
    return _rectified(sequence, registration, grid, frame, cv2.INTER_NEAREST)


def best_frame(
    registration: Registration,
    shape: tuple[int, int],
    cell: tuple[int, int],
    motion: Sequence[tuple[float, float]] | None = None,
) -> int | None:
    """Return the frame that resolves a cell best.

    A pixel and its motion blur add as squares; the frame in which both are the smallest part of
    the cell is the best.

    Parameters
    ----------
    registration : Registration
    shape : tuple of int
        (height, width) of a frame.
    cell : (row, col)
        From 0.
    motion : sequence of (float, float), optional
        Length (LR pixels) and direction (degrees) of the motion of every frame, as
        `Reconstruction.motion` has it; still frames if not given.

    Returns
    -------
    int or None
        None if no frame in use shows all of the cell.
    """
    corners = registration.layout.cell_corners(*cell)
    height, width = shape
    scores = {}
    for i in np.flatnonzero(registration.used):
        px = registration.camera.project(registration.homographies[i], corners)
        if not np.isfinite(px).all() or (px < 0).any() or (px > [width - 1, height - 1]).any():
            continue
        area = cv2.contourArea(px.astype(np.float32))
        blur = 0.0 if motion is None else float(np.sum(motion_of(*motion[int(i)]) ** 2))
        scores[int(i)] = area / (1.0 + blur)
    return max(scores, key=lambda i: scores[i], default=None)


def _rectified(
    sequence: FrameSequence,
    registration: Registration,
    grid: HrGrid,
    frame: int,
    interpolation: int,
) -> Image:
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
            image, px[..., 0], px[..., 1], interpolation, borderMode=cv2.BORDER_CONSTANT
        )
    return out
