"""The one place where (x, y) of the core becomes (row, col) of napari."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["in_frame", "segments_in_frame", "to_world"]

Array = NDArray[np.float64]


def to_world(points_xy: Array) -> Array:
    """Turn points (..., 2), (x, y), into (row, col)."""
    return np.asarray(points_xy, dtype=np.float64)[..., ::-1]


def in_frame(points_xy: Array, frame: int) -> Array:
    """Points (n, 2), (x, y) px, of one frame as (n, 3): (frame, row, col)."""
    world = to_world(points_xy)
    return np.column_stack([np.full(len(world), float(frame)), world])


def segments_in_frame(start_xy: Array, end_xy: Array, frame: int) -> Array:
    """Line segments between points (n, 2), (x, y) px, as napari vectors (n, 2, 3).

    Returns
    -------
    (n, 2, 3) float64
        [:, 0] start (frame, row, col), [:, 1] the way to the end (0, rows, cols).
    """
    start = in_frame(start_xy, frame)
    end = in_frame(end_xy, frame)
    return np.stack([start, end - start], axis=1)
