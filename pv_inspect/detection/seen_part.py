"""What a frame shows of a module, seen through the grid of its cells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.detection.grid_of_a_part import REACH, GridOfPart, bright_area
from pv_inspect.geometry.pose import Pose

__all__ = ["SAMPLES", "Part", "laid_together", "part_of", "part_of_module"]

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

SAMPLES = 12
"""Per cell, of the pictures that are compared."""
CLIP = 0.6
DARK = 0.12
"""Share of the usual light below which a place is none of the module. What is bright has 0.25 at
least, so that a dim cell that is bright in one frame is not dark in another."""


@dataclass(frozen=True)
class Part:
    """What one frame shows, seen through its own grid.

    Parameters
    ----------
    pose : Pose
        Of the plane of `pv_inspect.detection.grid_of_a_part.plane_of`.
    first : (2,) int64
        Cell (x, y) of that plane at which the pictures begin.
    details : (h, w) float32
        `SAMPLES` per cell: how the light differs from the mean cell.
    bright, dark, inside : (h, w) bool
        Whether a place is lit, or without any light, and whether the frame shows it.
    """

    pose: Pose
    first: NDArray[np.int64]
    details: Image
    bright: Mask
    dark: Mask
    inside: Mask


def part_of(image: Image, grid: GridOfPart, cell_aspect: float) -> Part:
    """See a frame through its grid."""
    height, width = image.shape
    pose = grid.pose
    cells = np.arange(2 * REACH + 1)
    x, y = (g.ravel() for g in np.meshgrid(cells + 0.5, cells + 0.5))
    pixels = np.nan_to_num(pose.project(np.column_stack([x, y / cell_aspect])), nan=-1e4)
    margin = float(np.linalg.norm(pose.jacobian_amid(image.shape) / [1.0, cell_aspect]))
    near = np.all((pixels > -margin) & (pixels < [width + margin, height + margin]), axis=1)
    first = np.array([x[near].min(), y[near].min()]).astype(np.int64)
    n = np.array([x[near].max(), y[near].max()]).astype(np.int64) - first + 1
    at_x, at_y = ((first[k] * SAMPLES + np.arange(n[k] * SAMPLES) + 0.5) / SAMPLES for k in (0, 1))
    points = np.stack(np.meshgrid(at_x, at_y / cell_aspect), axis=-1)
    lookup = np.nan_to_num(pose.project(points.reshape(-1, 2)), nan=-1e4)
    lookup = lookup.reshape(points.shape).astype(np.float32)
    inside = np.all((lookup >= 0) & (lookup <= [width - 1, height - 1]), axis=-1)
    smooth = cv2.GaussianBlur(image, (0, 0), max(margin / SAMPLES / 2.5, 0.7))
    seen, lit = (
        cv2.remap(picture, lookup[..., 0], lookup[..., 1], cv2.INTER_LINEAR)
        for picture in (smooth, bright_area(image).astype(np.float32))
    )
    bright = inside & (lit > 0.5)
    usual = float(np.median(seen[bright])) if bright.any() else 1.0
    relative = np.clip(seen / usual - 1, -CLIP, CLIP)
    of_cells = np.where(bright, relative, np.nan).reshape(n[1], SAMPLES, n[0], SAMPLES)
    with np.errstate(all="ignore"):
        count = np.isfinite(of_cells).sum(axis=(0, 2))
        mean = np.nansum(of_cells, axis=(0, 2)) / np.maximum(count, 1)
    details = np.where(bright, relative - np.tile(mean, (n[1], n[0])), 0).astype(np.float32)
    dark = inside & ~bright & (seen < DARK * usual)
    return Part(pose, first, details, bright, dark, inside)


def part_of_module(image: Image, pose: Pose, cell_aspect: float) -> Part:
    """See a frame through the pose of the module in it: the first cell is (`REACH`, `REACH`)."""
    first = np.array([[1.0, 0, -REACH], [0, 1, -REACH / cell_aspect], [0, 0, 1]])
    return part_of(image, GridOfPart(Pose(pose.camera, pose.homography @ first), 1.0), cell_aspect)


def laid_together(parts: Mapping[int, Part], group: Mapping[int, Array]) -> Part:
    """Lay the pictures of some frames over each other.

    Parameters
    ----------
    parts : mapping of frame number to Part
    group : mapping of frame number to (2,) float64
        Where cell (0, 0) of the planes of these frames lies on a common plane, cells (x, y).
    """
    if len(group) == 1:
        (k,) = group
        return parts[k]
    begin = {k: ((at + parts[k].first) * SAMPLES).round().astype(int) for k, at in group.items()}
    low = np.floor(np.min(list(begin.values()), axis=0) / SAMPLES).astype(np.int64)
    begin = {k: at - low * SAMPLES for k, at in begin.items()}
    size = np.max([at + parts[k].details.shape[::-1] for k, at in begin.items()], axis=0)
    total, lit, unlit, seen = (np.zeros(size[::-1], np.float32) for _ in range(4))
    for k, (x, y) in begin.items():
        part = parts[k]
        place = np.s_[y : y + part.details.shape[0], x : x + part.details.shape[1]]
        total[place] += part.details
        lit[place] += part.bright
        unlit[place] += part.dark
        seen[place] += part.inside
    pose = parts[next(iter(group))].pose
    details = np.asarray(total / np.maximum(lit, 1), np.float32)
    return Part(pose, low, details, 2 * lit > seen, 2 * unlit > seen, seen > 0)
