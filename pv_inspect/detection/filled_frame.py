"""The module in a photograph that is cropped to its edge: there is no dark around it.

The image gets a dark margin; with it the bright area has an outline, of which the border of the
image is a part. The grid found in it must end on that border, or before a strip that is dark:
where the module goes on, the image shows a part of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.detection.grid_check import LIT
from pv_inspect.detection.outline import Outline, OutlineError, find_outlines
from pv_inspect.detection.single_frame import RUNS_OVER, Found, found_in_outline
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose

__all__ = ["hidden_sides", "module_to_the_edge"]

Array = NDArray[np.float64]

# Chosen on photographs of `python benchmarks/cropped_photographs.py --seeds 0 16`.
MARGIN_SHARE = 0.1
"""Width of the dark margin, share of the longer side of the image."""
AT_BORDER_PX = 4.0
"""An outline that comes so near to the border of the image is one of the cropped module."""
MOST_OUTSIDE_PX = 1.5
"""So far outside of the image the grid may end: about half of a gap between cells is cut away."""
MOST_OFF_CELLS, MOST_OFF_PX = 0.035, 1.0
"""So far from the outline a side of the grid may lie, the larger of the two. Right grids had up to
0.02 cells and 1.1 px, those that lie on busbars, and end elsewhere, 0.07 to 0.14 cells."""
BEYOND_PX = 2.5
"""So far outside of the grid it must be dark, where the image shows it."""


def module_to_the_edge(
    image: NDArray[np.float32],
    layout: ModuleLayout,
    inside: tuple[float, float] | None = None,
) -> Found:
    """Find the module in an image that ends where the module ends, on some sides or on all.

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
        If there is none, or if it goes on outside of the image.
    """
    for outline in _outlines_to_the_edge(image, inside):
        try:
            found = found_in_outline(image, layout, outline, to_the_edge=True)
        except OutlineError:
            continue
        most = max(MOST_OFF_CELLS, MOST_OFF_PX / found.pose.scale_px(layout.size))
        if _off_outline(outline, layout, found.pose) < most and _ends_in_image(
            image, layout, found.pose
        ):
            return found
    raise OutlineError(RUNS_OVER)


def _outlines_to_the_edge(
    image: NDArray[np.float32], inside: tuple[float, float] | None
) -> Iterator[Outline]:
    """Yield outlines of which the border of the image is a part, each once."""
    height, width = image.shape
    pad = max(8, round(MARGIN_SHARE * max(height, width)))
    dark = float(np.percentile(cv2.GaussianBlur(image, (0, 0), 1.0), 1))
    sides = (pad, pad, pad, pad)
    padded = cv2.copyMakeBorder(image, *sides, cv2.BORDER_CONSTANT, value=dark)
    shifted = None if inside is None else (inside[0] + pad, inside[1] + pad)
    seen: list[Array] = []
    for outline in find_outlines(np.asarray(padded, np.float32), shifted):
        points, corners = outline.points_px - pad, outline.corners_px - pad
        to_border = np.minimum(points, [width - 1, height - 1] - points).min()
        if to_border > AT_BORDER_PX or any(np.abs(corners - c).max() < 1 for c in seen):
            continue
        seen.append(corners)
        yield Outline(points, corners, cut=False)


def _ends_in_image(image: NDArray[np.float32], layout: ModuleLayout, pose: Pose) -> bool:
    """Whether the grid ends in the image or on its border, and no bright cells follow."""
    height, width = image.shape
    last = np.array([width - 1, height - 1])
    smooth = cv2.GaussianBlur(image, (0, 0), 0.5)
    background = float(np.percentile(smooth, 1))
    bright = float(np.percentile(smooth, 75))
    for line, outwards in _sides(layout):
        at = pose.project(line)
        if not np.isfinite(at).all() or -_to_border(at, image.shape).min() > MOST_OUTSIDE_PX:
            return False
        step = pose.project(line + 0.01 * np.array(outwards)) - at
        beyond = at + BEYOND_PX * step / np.linalg.norm(step, axis=1, keepdims=True)
        shown = beyond[np.all((beyond >= 0) & (beyond <= last), axis=1)].round().astype(int)
        level = (smooth[shown[:, 1], shown[:, 0]] - background) / max(bright - background, 1e-6)
        if level.size and np.mean(level > LIT) > 0.5:
            return False
    return True


def _off_outline(outline: Outline, layout: ModuleLayout, pose: Pose) -> float:
    """Median distance of the contour from the side of the grid that is farthest off, units."""
    (left, top), _, (right, bottom), _ = layout.outline
    x, y = pose.unproject(outline.points_px).T
    off = np.abs(np.stack([y - top, y - bottom, x - left, x - right]))
    nearest = np.argmin(np.nan_to_num(off, nan=np.inf), axis=0)
    sides = [off[side][nearest == side] for side in range(4)]
    if any(not len(side) for side in sides):
        return np.inf
    return max(float(np.median(side)) for side in sides)


def hidden_sides(layout: ModuleLayout, poses: Sequence[Pose], shape: tuple[int, int]) -> list[str]:
    """Say on which sides of the module no frame shows what lies outside of it.

    Parameters
    ----------
    layout : ModuleLayout
    poses : sequence of Pose
        Of the frames.
    shape : tuple of int
        (height, width) of a frame.

    Returns
    -------
    list of str
        The outer rows and columns there, in words. A frame shows the outside of a side if it does
        along half of it.
    """
    names = ("first row", "last row", "first column", "last column")
    hidden = []
    for name, (line, _) in zip(names, _sides(layout), strict=True):
        nearest = [np.nan_to_num(_to_border(pose.project(line), shape)) for pose in poses]
        if all(np.mean(near > BEYOND_PX) < 0.5 for near in nearest):
            hidden.append(name)
    return hidden


def _sides(layout: ModuleLayout) -> list[tuple[Array, tuple[float, float]]]:
    """Points along the top, bottom, left and right side of the module, and the way outwards."""
    (left, top), _, (right, bottom), _ = layout.outline
    share = np.linspace(0.02, 0.98, 12 * max(layout.rows, layout.cols))
    x, y = left + share * (right - left), top + share * (bottom - top)
    return [
        (np.column_stack([x, np.full_like(x, top)]), (0.0, -1.0)),
        (np.column_stack([x, np.full_like(x, bottom)]), (0.0, 1.0)),
        (np.column_stack([np.full_like(y, left), y]), (-1.0, 0.0)),
        (np.column_stack([np.full_like(y, right), y]), (1.0, 0.0)),
    ]


def _to_border(pixels: Array, shape: tuple[int, int]) -> Array:
    """Distance of points from the border of the image, negative outside of it, pixels."""
    height, width = shape
    inwards = np.minimum(pixels + 0.5, np.array([width, height]) - 0.5 - pixels)
    return np.asarray(inwards.min(axis=1))
