"""The module in frames that all cut it: the parts are put together by what their cells look like.

The grid of each frame is known up to whole cells (`pv_inspect.detection.grid_of_a_part`). How two
grids lie to each other, what both frames show says: the shift at which their cells agree, if no
other shift agrees nearly as well. Where all parts together end, on all four sides, is the module.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.detection.grid_of_a_part import REACH, GridOfPart, bright_area, plane_of
from pv_inspect.detection.outline import OutlineError
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose

__all__ = ["NO_PLACE", "SHOWN_TOGETHER", "Part", "part_of", "poses_together"]

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

# No search for these constants is on record: they were set by hand on seeds 0 to 3 of
# `python benchmarks/partial_views.py`.

SAMPLES = 12
"""Per cell, of the pictures that are compared."""
CLIP = 0.6
LEAST_OVERLAP_CELLS = 3.0
LEAST_CORRELATION = 0.35
CLEARER = 0.2
"""By so much a shift must correlate better than any that differs by more than `APART` cells."""
APART = 0.5
MOST_MISFIT = 0.3
"""Cells by which shifts around a loop of frames may contradict each other."""
UNEVEN_ENDS = 0.25 * SAMPLES
"""How much more or less than whole cells what is bright may span, samples."""
MOST_HIDDEN = 0.002
SHOWN_TOGETHER = "together they show"
BEYOND = 0.17
"""So far beyond the outer line it must be dark, cells."""
LEAST_DARK_SHARE = 0.3
NO_PLACE = (
    "which part of the module it shows can't be told: it fits no other frame at one place only"
)


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
    bright, inside : (h, w) bool
        Whether a place is lit, and whether the frame shows it.
    """

    pose: Pose
    first: NDArray[np.int64]
    details: Image
    bright: Mask
    inside: Mask


def part_of(image: Image, grid: GridOfPart, cell_aspect: float) -> Part:
    """See a frame through its grid."""
    height, width = image.shape
    pose = grid.pose
    plane = plane_of(cell_aspect)
    cells = np.arange(2 * REACH + 1)
    x, y = (g.ravel() for g in np.meshgrid(cells + 0.5, cells + 0.5))
    pixels = np.nan_to_num(pose.project(np.column_stack([x, y / cell_aspect])), nan=-1e4)
    margin = 1.0 * float(np.hypot(*np.ptp(pose.project(_corners(plane)), axis=0)))
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
    return Part(pose, first, details, bright, inside)


def _corners(plane: ModuleLayout) -> Array:
    middle = np.array(plane.size) / 2
    cell = np.array([1.0, 1.0 / plane.cell_aspect])
    return np.array([middle - cell / 2, middle + cell / 2])


def poses_together(parts: Mapping[int, Part], layout: ModuleLayout) -> dict[int, Pose]:
    """Find where the parts lie on the module.

    Parameters
    ----------
    parts : mapping of frame number to Part
    layout : ModuleLayout
        Without wide gaps.

    Returns
    -------
    dict of frame number to Pose
        Of the module; frames that fit no other one at one place only are missing.

    Raises
    ------
    OutlineError
        If what fits together is not the whole module, or contradicts itself.
    """
    places = _places(parts)
    if len(places) < 2:
        raise OutlineError("what they show does not fit together at one place only")
    corner, turned = _module(parts, places, layout)
    poses = {}
    for k, place in places.items():
        x, y = corner - place
        moved = np.array([[1.0, 0, x], [0, 1, y / layout.cell_aspect], [0, 0, 1]])
        pose = Pose(parts[k].pose.camera, parts[k].pose.homography @ moved)
        if turned:
            size = (float(layout.rows), float(layout.cols))
            pose = pose.turned(size, layout.size, 1)
        poses[k] = pose
    return poses


def _places(parts: Mapping[int, Part]) -> dict[int, Array]:
    """Where cell (0, 0) of each frame's plane lies on a common plane, cells (x, y)."""
    links = []
    for one, other in combinations(sorted(parts), 2):
        found = _shift(parts[one], parts[other])
        if found is not None:
            links.append((found[1], one, other, found[0]))
    groups = {k: {k: np.zeros(2)} for k in parts}
    for _, one, other, shift in sorted(links, key=lambda link: -link[0]):
        if other in groups[one]:
            continue
        first, second = groups[one], groups[other]
        move = first[one] + shift - second[other]
        first.update({k: place + move for k, place in second.items()})
        for k in second:
            groups[k] = first
    best = max(groups.values(), key=len, default={})
    for _, one, other, shift in links:
        if one in best and np.abs(best[one] + shift - best[other]).max() > MOST_MISFIT:
            raise OutlineError("what they show fits together in more than one way")
    return best


def _shift(one: Part, other: Part) -> tuple[Array, float] | None:
    """Where the plane of another part lies on that of this one, and how clear this is."""
    shape = tuple(
        cv2.getOptimalDFTSize(a + b)
        for a, b in zip(one.details.shape, other.details.shape, strict=True)
    )

    def spectra(part: Part) -> tuple[Array, Array, Array]:
        mask = part.bright.astype(np.float64)
        values = np.where(part.bright, part.details, 0).astype(np.float64)
        return tuple(np.fft.rfft2(a, shape) for a in (mask, values, values**2))  # type: ignore[return-value]

    m1, f1, q1 = spectra(one)
    m2, f2, q2 = spectra(other)

    def correlated(a: Array, b: Array) -> Array:
        return np.asarray(np.fft.irfft2(a * np.conj(b), shape))

    n = np.maximum(correlated(m1, m2).round(), 1e-9)
    s1, s2 = correlated(f1, m2), correlated(m1, f2)
    covariance = correlated(f1, f2) - s1 * s2 / n
    v1 = np.maximum(correlated(q1, m2) - s1**2 / n, 0)
    v2 = np.maximum(correlated(m1, q2) - s2**2 / n, 0)
    enough = n > LEAST_OVERLAP_CELLS * SAMPLES**2
    if not enough.any():
        return None
    floor = 1e-3 * np.sqrt(v1[enough].max() * v2[enough].max()) + 1e-12
    score = np.where(enough, covariance / (np.sqrt(v1 * v2) + floor), -1.0)
    row, col = np.unravel_index(int(score.argmax()), score.shape)
    best = float(score[row, col])
    rows, cols = (np.arange(size) for size in shape)
    # Shifts wrap around: the other part may begin before this one.
    dy, dx = (
        np.minimum(np.abs(v - at), s - np.abs(v - at))
        for v, at, s in ((rows, row, shape[0]), (cols, col, shape[1]))
    )
    away = np.maximum(dy[:, None], dx[None]) > APART * SAMPLES
    second = float(score[away].max())
    if best < LEAST_CORRELATION or best - second < CLEARER:
        return None
    moved = [
        float(at if at < part else at - size)
        for at, part, size in (
            (col, one.details.shape[1], shape[1]),
            (row, one.details.shape[0], shape[0]),
        )
    ]
    return one.first + np.array(moved) / SAMPLES - other.first, best - second


def _module(
    parts: Mapping[int, Part], places: Mapping[int, Array], layout: ModuleLayout
) -> tuple[Array, bool]:
    """First cell (x, y) of the module on the common plane, and whether it lies on its side."""
    low = np.array([place + parts[k].first for k, place in places.items()]).min(axis=0)
    low = np.floor(low).astype(int) - 1
    high = max(
        int(np.ceil((place + parts[k].first).max() + max(parts[k].details.shape) / SAMPLES))
        for k, place in places.items()
    )
    size = (high - int(low.min()) + 2) * SAMPLES
    lit, seen = np.zeros((size, size), np.int32), np.zeros((size, size), np.int32)
    for k, place in places.items():
        x, y = ((place + parts[k].first - low) * SAMPLES).round().astype(int)
        height, width = parts[k].details.shape
        lit[y : y + height, x : x + width] += parts[k].bright
        seen[y : y + height, x : x + width] += parts[k].inside
    bright = 2 * lit > seen
    count, labels, stats, _ = cv2.connectedComponentsWithStats(
        bright.astype(np.uint8), connectivity=4
    )
    if count < 2:
        raise OutlineError("nothing in them is bright")
    largest = labels == 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
    # Outer borders say where cells begin even if busbars were taken for the borders inside.
    ends = np.array([_ends(largest), _ends(largest.T)])
    cols, rows = ((ends[:, 1] - ends[:, 0]) / SAMPLES).round().astype(int).tolist()
    together = f"{SHOWN_TOGETHER} {rows} rows x {cols} columns"
    if np.abs(ends[:, 1] - ends[:, 0] - SAMPLES * np.array([cols, rows])).max() > UNEVEN_ENDS:
        raise OutlineError(f"{together} and parts of cells")
    box = *ends[:, 0].round().astype(int).tolist(), *(ends[:, 1].round().astype(int).tolist())
    sides = _open_sides(bright, seen > 0, box)
    if sides:
        raise OutlineError(f"{together}, and not where the module ends {' and '.join(sides)}")
    hidden = 1 - (seen[box[1] : box[3], box[0] : box[2]] > 0).mean()
    if hidden > MOST_HIDDEN:
        raise OutlineError(f"{together}, but {100 * hidden:.0f} % of this are in no frame")
    turned = (rows, cols) != (layout.rows, layout.cols)
    if turned and ((cols, rows) != (layout.rows, layout.cols) or layout.cell_aspect != 1):
        raise OutlineError(f"{together}, not {layout.rows} x {layout.cols}")
    return ends.mean(axis=1) / SAMPLES - np.array([cols, rows]) / 2 + low, turned


def _ends(bright: Mask) -> tuple[float, float]:
    """Where what is bright begins and ends along x, samples: in the middle of its lines."""
    lines = bright[bright.sum(axis=1) > 0.5 * bright.sum(axis=1).max()]
    width = lines.shape[1]
    first, last = lines.argmax(axis=1), width - lines[:, ::-1].argmax(axis=1)
    return float(np.median(first)), float(np.median(last))


def _open_sides(bright: Mask, seen: Mask, box: tuple[int, int, int, int]) -> list[str]:
    """On which sides no frame shows the dark beyond the module."""
    left, top, right, bottom = box
    step = round(BEYOND * SAMPLES)
    dark = seen & ~bright
    beyond = {
        "on the left": dark[top:bottom, left - step],
        "on the right": dark[top:bottom, right - 1 + step],
        "at the top": dark[top - step, left:right],
        "at the bottom": dark[bottom - 1 + step, left:right],
    }
    return [side for side, line in beyond.items() if line.mean() < LEAST_DARK_SHARE]
