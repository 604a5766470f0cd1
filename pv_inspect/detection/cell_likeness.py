"""How much what lies in the meshes of a grid looks like cells.

Cells are alike in their fine structure, but each is of its own brightness, to its very borders.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose

__all__ = ["CellLikeness", "cell_likeness"]

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

# No search for these constants is on record: they were set by hand on seeds 0 to 3 and 20 to 31 of
# `python benchmarks/partial_views.py`.

SAMPLES = 32
"""Per cell, where cells are compared: the first of six busbars lies a twelfth of a cell away."""
LEAST_CELLS = 3
WHOLLY = 0.97
PER_STRETCH, PER_CELL = 3.0, 0.3
"""How much an aspect that is off by a factor e, and a share of the cells, count."""
MARGIN = SAMPLES // 8
INNER = slice(MARGIN, -MARGIN)
AWAY = 1
"""Samples to both sides of a line at which the brightness is compared."""
LEAST_RATIOS, LEAST_VARIED = 6, 1e-4
MOST_OWN = 0.7


@dataclass(frozen=True)
class CellLikeness:
    """What speaks for and against the meshes of a grid being cells.

    Parameters
    ----------
    score : float
        Of all together, higher is better.
    own : tuple of float
        Logarithm of how much more the brightness varies from mesh to mesh across the grid's lines
        than across any other place: upright lines, level ones. 0 if too little is seen.
    ends : tuple of float
        Where it varies most, meshes (x, y) beside the lines; 0 where these are in place.
    """

    score: float
    own: tuple[float, float]
    ends: tuple[float, float]


def cell_likeness(
    image: Image, bright: Mask, pose: Pose, plane: ModuleLayout
) -> CellLikeness | None:
    """Compare what lies in the meshes of a grid.

    Busbars taken for borders make meshes that are not alike, or of another aspect, or that end
    where the brightness does not change.

    Parameters
    ----------
    image : (height, width) float32
    bright : (height, width) bool
        What belongs to the module.
    pose : Pose
    plane : ModuleLayout
        Holds more cells than the frame.

    Returns
    -------
    CellLikeness or None
        None if too few whole cells are seen.
    """
    x, y = (plane.cell_centres() * [1.0, plane.cell_aspect]).T
    pixels = np.nan_to_num(pose.project(plane.cell_centres()), nan=-1e4)
    height, width = image.shape
    seen = np.all((pixels >= 0) & (pixels <= [width - 1, height - 1]), axis=1)
    if seen.sum() < LEAST_CELLS:
        return None
    sampled = []
    for values in (x[seen] - 0.5, y[seen] - 0.5):
        first, n = round(values.min()), round(values.max() - values.min()) + 1
        sampled.append(first + (np.arange(n * SAMPLES) + 0.5) / SAMPLES)
    points = np.stack(np.meshgrid(sampled[0], sampled[1] / plane.cell_aspect), axis=-1)
    lookup = np.nan_to_num(pose.project(points.reshape(-1, 2)), nan=-1e4)
    lookup = lookup.reshape(points.shape).astype(np.float32)
    smooth = cv2.GaussianBlur(image, (0, 0), 1.0)
    grey, lit = (
        np.asarray(cv2.remap(picture, lookup[..., 0], lookup[..., 1], cv2.INTER_LINEAR), np.float32)
        for picture in (smooth, bright.astype(np.float32))
    )
    n_y, n_x = (len(s) // SAMPLES for s in sampled[::-1])
    meshes, lights = (
        a.reshape(n_y, SAMPLES, n_x, SAMPLES).transpose(0, 2, 1, 3).reshape(-1, SAMPLES, SAMPLES)
        for a in (grey, lit)
    )
    meshes = meshes[lights.mean(axis=(1, 2)) > WHOLLY]
    if len(meshes) < LEAST_CELLS:
        return None
    cell_area = float(np.abs(np.linalg.det(pose.jacobian_amid(image.shape))))
    # Where few meshes count, many cells are left out.
    area = len(meshes) * cell_area / max(float(bright.sum()), 1.0)
    stretch = abs(np.log(pose.aspect))
    (own_x, end_x), (own_y, end_y) = _own_brightness(grey, lit), _own_brightness(grey.T, lit.T)
    score = _alike(meshes) - _uneven(meshes) - PER_STRETCH * stretch + PER_CELL * min(area, 1.0)
    return CellLikeness(float(score + own_x + own_y), (own_x, own_y), (end_x, end_y))


def _alike(meshes: Image) -> float:
    """Correlation of the fine structure of a mesh with the mean of all others."""
    n = len(meshes)
    fine = np.clip(meshes / meshes.mean(axis=(1, 2), keepdims=True) - 1, -0.5, 0.5).reshape(n, -1)
    others = (fine.sum(axis=0) - fine) / (n - 1)
    return float(np.median([np.corrcoef(a, b)[0, 1] for a, b in zip(fine, others, strict=True)]))


def _uneven(meshes: Image) -> float:
    """How much the brightness varies within meshes, as a share of what it varies altogether."""
    n = len(meshes)
    inner = meshes[:, INNER, INNER]
    half = SAMPLES // 2 - MARGIN
    quarters = np.log(np.maximum(inner.reshape(n, 2, half, 2, half).mean(axis=(2, 4)), 1e-6))
    return float(quarters.reshape(n, 4).var(axis=1).mean() / (quarters.var() + 1e-12))


def _own_brightness(grey: Image, lit: Image) -> tuple[float, float]:
    """Whether the brightness changes from cell to cell at the upright lines of a grid, and where.

    Across a border it does so by another ratio in each row, across a busbar by the same in all.
    """
    rows, cols = (n // SAMPLES for n in grey.shape)
    strips, share = (
        picture.reshape(rows, SAMPLES, cols * SAMPLES)[:, INNER].mean(axis=1)
        for picture in (grey, lit)
    )
    apart = 2 * AWAY
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.log(strips[:, apart:] / strips[:, :-apart])
    whole = cv2.erode(share, np.ones((1, 2 * apart + 1), np.uint8))[:, AWAY:-AWAY]
    ratio = np.where((whole > WHOLLY) & np.isfinite(ratio), ratio, np.nan)
    place = (np.arange(ratio.shape[1]) + AWAY) % SAMPLES
    varied = np.zeros(SAMPLES)
    for k in range(SAMPLES):
        values = ratio[:, place == k]
        values = values[np.isfinite(values)]
        if values.size < LEAST_RATIOS:
            return 0.0, 0.0
        varied[k] = np.median(np.abs(values - np.median(values))) + LEAST_VARIED
    # The lines lie between the last sample and the first; blur carries them one sample further.
    here, elsewhere = varied[[-1, 0]].max(), varied[2:-2].max()
    own = float(np.clip(np.log(here / elsewhere), -MOST_OWN, MOST_OWN))
    if own >= 0:
        return own, 0.0
    # Both samples at a border see the change.
    k = int(varied.argmax())
    beside = k + 1 if varied[(k + 1) % SAMPLES] > varied[k - 1] else k - 1
    weights = varied[[k, beside % SAMPLES]]
    end = (float(np.average([k, beside], weights=weights)) + 0.5) / SAMPLES
    return own, end - round(end)
