"""Dark lines across a module: candidates for the gaps between its cells.

Seen through the pose of its outline the module is a rectangle in which gaps, and busbars, are
straight dark lines.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.geometry.pose import Pose

__all__ = ["along", "columns_at", "line_profiles", "rectified", "unit_corners"]

Array = NDArray[np.float64]

RECTIFIED_PX = (300, 2400)
"""Least and largest number of samples across the lines."""
SAMPLES_PER_PX = 1.5
SAMPLES_ALONG = 240
BANDS = 6
"""Parts along the lines, in each of which they count as straight."""
SHALLOW_BANDS = 2
"""Bands in which a gap need not show: a few cells are dead. A crack ends sooner."""
VALLEYS_PX = (2.5, 5.0)
"""Distances at which a dark line is compared with what is beside it, LR pixels."""


def unit_corners(pose: Pose) -> NDArray[np.float32]:
    """Corners of the unit square in the frame, (4, 2) pixels, clockwise from the top left."""
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    return np.nan_to_num(pose.project(square)).astype(np.float32)


def rectified(
    image: NDArray[np.float32], pose: Pose, side_px: float, upright: bool
) -> NDArray[np.float32]:
    """See the module as a rectangle whose columns run along the lines that are sought."""
    fine = int(np.clip(SAMPLES_PER_PX * side_px, *RECTIFIED_PX))
    across, down = np.meshgrid(
        (np.arange(fine) + 0.5) / fine, (np.arange(SAMPLES_ALONG) + 0.5) / SAMPLES_ALONG
    )
    points = np.stack([across, down] if upright else [down, across], axis=-1).reshape(-1, 2)
    lookup = np.nan_to_num(pose.project(points), nan=-1e4).astype(np.float32)
    lookup = lookup.reshape(*across.shape, 2)
    seen = cv2.remap(
        image, lookup[..., 0], lookup[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(seen, np.float32)


def line_profiles(module: NDArray[np.float32], lr_px: float) -> NDArray[np.float32]:
    """How dark the line at each column is against its surroundings, 0 to 1, in bands along it.

    The lines are a little bent yet, because the pose is that of the outline alone: within a band
    that does not matter. `lr_px` is the number of columns per LR pixel.
    """
    smooth = cv2.blur(module, (max(1, round(lr_px)) | 1, 3))
    depth = np.zeros(module.shape, np.float32)
    for distance in VALLEYS_PX:
        step = max(1, round(distance * lr_px))
        padded = cv2.copyMakeBorder(smooth, 0, 0, step, step, cv2.BORDER_REPLICATE)
        beside = np.minimum(padded[:, : -2 * step], padded[:, 2 * step :])
        depth = np.maximum(depth, 1 - smooth / np.maximum(beside, 1e-4))
    tolerance = 2 * max(1, round(0.5 * lr_px)) + 1
    depth = np.asarray(cv2.dilate(depth, np.ones((1, tolerance), np.uint8)), np.float32)
    bands = [np.median(band, axis=0) for band in np.array_split(depth, BANDS)]
    return np.asarray(bands, np.float32)


def along(profiles: NDArray[np.float32], reach: float) -> Array:
    """Depth of the line within `reach` of each column, which must hold along most of its length."""
    kernel = np.ones((1, 2 * round(reach) + 1), np.uint8)
    near = np.asarray(cv2.dilate(profiles, kernel), np.float64)
    return np.asarray(np.partition(near, SHALLOW_BANDS, axis=0)[SHALLOW_BANDS])


def columns_at(place: Array, width: int) -> NDArray[np.int64]:
    """Columns of a picture at these shares of its width."""
    return np.minimum((place * width).astype(np.int64), width - 1)
