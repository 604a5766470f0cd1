"""How well each number of cells fits the dark lines of a module, along one direction.

Seen as a rectangle the gaps between n cells are dark lines at k / n of its width. Busbars are dark
lines too, in one direction; they are less dark, not evenly spaced together with the gaps, or make
cells of an unlikely aspect.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.geometry.pose import Pose

__all__ = ["FINER", "LineScores", "line_scores", "rectified_module"]

Array = NDArray[np.float64]

# No search for these constants is on record: they were chosen by hand. What they give is shown by
# tests/detection/test_layout_guess.py on simulated modules, and on photographs by
# `python benchmarks/field.py FOLDER --guess`.

MIN_CELL_PX = 8.0
"""Smaller cells are not looked for, LR pixels."""
MAX_CELLS = 60
RECTIFIED_PX = (300, 2400)
"""Least and largest number of samples across the lines."""
SAMPLES_PER_PX = 1.5
SAMPLES_ALONG = 240
BANDS = 6
"""Parts along the lines, in each of which they count as straight."""
BETWEEN = np.arange(0.15, 0.851, 0.05)
"""Places in a cell, in its widths, where lines would be busbars."""
FINER = (2, 3, 4, 5)
"""Numbers of parts that the lines in a cell may seem to divide it into."""
BUSBAR_WEIGHT = 0.25
"""What lines that lie symmetrically in the cells take from the score, in parts of their depth."""
VALLEYS_PX = (2.5, 5.0)
"""Distances at which a dark line is compared with what is beside it, LR pixels."""
SHALLOW_BANDS = 2
"""Bands in which a gap need not show: a few cells are dead. A crack ends sooner."""
MIN_DEPTH = 0.05
"""Shallower lines are none, in parts of the light beside them."""


@dataclass(frozen=True)
class LineScores:
    """How well each number of cells n fits along one direction.

    `base` (n,) is the score, 0 to 1; `finer` (n, m) the depth of the lines that would divide each
    cell into `FINER` [m] ones.
    """

    base: Array
    finer: Array


def rectified_module(
    image: NDArray[np.float32], pose: Pose, side_px: float, upright: bool
) -> NDArray[np.float32]:
    """See the module as a rectangle whose columns run along the lines that are sought."""
    fine = int(np.clip(SAMPLES_PER_PX * side_px, *RECTIFIED_PX))
    across, along = np.meshgrid(
        (np.arange(fine) + 0.5) / fine, (np.arange(SAMPLES_ALONG) + 0.5) / SAMPLES_ALONG
    )
    points = np.stack([across, along] if upright else [along, across], axis=-1).reshape(-1, 2)
    lookup = np.nan_to_num(pose.project(points), nan=-1e4).astype(np.float32)
    lookup = lookup.reshape(*across.shape, 2)
    rectified = cv2.remap(
        image, lookup[..., 0], lookup[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(rectified, np.float32)


def _line_profiles(rectified: NDArray[np.float32], lr_px: float) -> NDArray[np.float32]:
    """How dark the line at each column is against its surroundings, 0 to 1, in bands along it.

    The lines are a little bent yet, because the pose is that of the outline alone: within a band
    that does not matter. `lr_px` is the number of columns per LR pixel.
    """
    smooth = cv2.blur(rectified, (max(1, round(lr_px)) | 1, 3))
    depth = np.zeros(rectified.shape, np.float32)
    for distance in VALLEYS_PX:
        step = max(1, round(distance * lr_px))
        padded = cv2.copyMakeBorder(smooth, 0, 0, step, step, cv2.BORDER_REPLICATE)
        beside = np.minimum(padded[:, : -2 * step], padded[:, 2 * step :])
        depth = np.maximum(depth, 1 - smooth / np.maximum(beside, 1e-4))
    tolerance = 2 * max(1, round(0.5 * lr_px)) + 1
    depth = np.asarray(cv2.dilate(depth, np.ones((1, tolerance), np.uint8)), np.float32)
    bands = [np.median(band, axis=0) for band in np.array_split(depth, BANDS)]
    return np.asarray(bands, np.float32)


def line_scores(rectified: NDArray[np.float32], side_px: float) -> LineScores:
    """Score every number of cells n from 0 to `MAX_CELLS` along x.

    Relative to the deepest lines there are, the score is the depth of the shallower lines at k / n,
    less what differs between one cell and the next, less a little for other lines in the cells.
    """
    width = rectified.shape[1]
    profiles = _line_profiles(rectified, width / side_px)
    base = np.zeros(MAX_CELLS + 1)
    depths = np.zeros(MAX_CELLS + 1)
    finer = np.zeros((MAX_CELLS + 1, len(FINER)))
    for n in range(2, int(min(MAX_CELLS, side_px / MIN_CELL_PX)) + 1):
        lines = _along(profiles, 0.1 * width / n)[_columns(np.arange(1, n) / n, width)]
        depths[n] = np.quantile(lines, 0.15)
        within = _along(profiles, 0.03 * width / n)

        def typical(phase: Array, n: int = n, within: Array = within) -> tuple[Array, Array]:
            cells = np.arange(n)
            one = within[_columns((cells + phase[:, None]) / n, width)]
            other = within[_columns((cells + 1 - phase[:, None]) / n, width)]
            either = np.quantile(np.maximum(one, other), 0.4, axis=1)
            return np.quantile(one, 0.4, axis=1), either

        one, either = typical(BETWEEN)
        # Busbars lie symmetrically in a cell: half cells see them now on this side, now on that.
        mirrored = np.maximum(one, one[::-1])
        base[n] = depths[n] - (either - mirrored).max() - BUSBAR_WEIGHT * mirrored.max()
        for k, factor in enumerate(FINER):
            finer[n, k] = typical(np.arange(1, factor) / factor)[0].min()
    for k, factor in enumerate(FINER):
        # Lines that make no even grid of their own are busbars, however dark.
        even = np.zeros_like(base)
        even[: MAX_CELLS // factor + 1] = base[::factor][: MAX_CELLS // factor + 1]
        finer[:, k] = np.clip(np.minimum(finer[:, k], even), 0, None)
    deepest = float(depths.max())
    if deepest < MIN_DEPTH:
        return LineScores(np.zeros_like(base), np.zeros_like(finer))
    return LineScores(np.clip(base / deepest, 0, 1), finer / deepest)


def _along(profiles: NDArray[np.float32], reach: float) -> Array:
    """Depth of the line within `reach` of each column, which must hold along most of its length."""
    kernel = np.ones((1, 2 * round(reach) + 1), np.uint8)
    near = np.asarray(cv2.dilate(profiles, kernel), np.float64)
    return np.asarray(np.partition(near, SHALLOW_BANDS, axis=0)[SHALLOW_BANDS])


def _columns(place: Array, width: int) -> NDArray[np.int64]:
    return np.minimum((place * width).astype(np.int64), width - 1)
