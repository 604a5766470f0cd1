"""Parts of a cell that are electrically cut off: dark areas with a sharp, straight edge.

A part without current is dark as a whole and ends at a crack, so that the brightness falls within
the width of a line; grain, shading and stray darkness end softly or raggedly. What belongs to the
outline of the cell or of its tile is no such part: corners that were cut off the wafer lie
opposite one another, and a dark margin runs along a whole side.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["LEAST_BLOCK", "cut_off_blocks", "with_block_edges"]

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Longer side of the cell that is looked at, pixels; lengths below are shares of it.
_SIDE = 128
# Least share of the cell: the least part that counts as cut off in the class rule.
LEAST_BLOCK = 0.01
# Dark lines (busbars, cracks, fingers) are thinner.
_LEAST_WIDTH = 0.05
# Levels relative to the bright part of the cell at which dark areas are looked for.
_LEVELS = (0.3, 0.4, 0.5)
# The rest of these is chosen on labelled training cells and rendered cells
# (benchmarks/crack_blocks.py): brightness inside over that just outside, share of the edge where
# the brightness falls by half of the step, share of it in straight pieces, area of the part over
# that of its convex hull.
_MOST_BRIGHT = 0.4
_LEAST_SHARP = 0.7
_LEAST_STRAIGHT = 0.6
_LEAST_SOLID = 0.7
# So much more of a part that does not reach the border.
_INNER = 0.1
# Half of the width over which the edge is judged, length of a straight piece, its tolerance.
_REACH, _PIECE, _TOLERANCE = 0.03, 0.08, 0.015
# Outline: margin of a tile that was cut a bit large, legs of a cut corner, rim of the cell.
_MARGIN, _CORNER, _RIM = 0.12, 0.25, 0.035
# Width of the marks that an edge gets, cell widths.
_EDGE_WIDTH = 0.01
# Of a corner that is not cut this much, inside of the rim, is brighter than this.
_TIP, _TIP_LEVEL = 0.04, 0.8
_MOST_WAVY, _MOST_SLANT = 0.01, 0.05


def cut_off_blocks(tile: Image) -> Mask:
    """Find the parts of a cell that are electrically cut off, or broken off.

    Parameters
    ----------
    tile : (h, w) float32
        One cell, any brightness scale.

    Returns
    -------
    (h, w) bool
        Dark areas of at least `LEAST_BLOCK` of the cell. Empty for a cell without light.
    """
    none = np.zeros(tile.shape, bool)
    scale = _SIDE / max(tile.shape)
    size = (max(round(tile.shape[1] * scale), 8), max(round(tile.shape[0] * scale), 8))
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    image = cv2.resize(np.asarray(tile, np.float32), size, interpolation=way)
    image = cv2.GaussianBlur(image, (0, 0), 0.7)
    edge = round(_RIM * _SIDE)
    bright = float(np.percentile(image[edge:-edge, edge:-edge], 70))
    if not bright > 0:
        return none
    # Dark lines out: lighter than themselves within their width.
    image = cv2.morphologyEx(image / np.float32(bright), cv2.MORPH_CLOSE, _disc(_LEAST_WIDTH))
    image = np.asarray(image, np.float32)
    if image.min() >= _LEVELS[-1]:
        return none
    inside = _within_margins(np.asarray(image, np.float32))
    cell = np.asarray(image[inside], np.float32)
    if min(cell.shape) < 2 * edge + 8:
        return none
    found = np.zeros(image.shape, bool)
    for level in _LEVELS:
        dark = _opened(cell < level)
        n_labels, labels, facts, _ = cv2.connectedComponentsWithStats(
            dark.astype(np.uint8), connectivity=4
        )
        for k in range(1, n_labels):
            if LEAST_BLOCK * dark.size <= facts[k, cv2.CC_STAT_AREA] <= 0.5 * dark.size:
                part = labels == k
                if not _is_cut_corner(part, cell) and _cut_off(part, cell):
                    found[inside] |= part
    if not found.any():
        return none
    whole = cv2.resize(found.astype(np.float32), tile.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(whole >= 0.5)


def with_block_edges(
    probability: Image, blocks: Mask, threshold: float, cell_width_px: float
) -> Image:
    """Mark the edge of cut-off parts: there is a crack along it, or the cell is broken.

    Parameters
    ----------
    probability : (h, w) float32
        Crack probability that a detector gives.
    blocks : (h, w) bool
        Of `cut_off_blocks`.
    threshold : float
        The probability that the edge gets at least.
    cell_width_px : float

    Returns
    -------
    (h, w) float32
    """
    if not blocks.any():
        return probability
    rim = max(round(_RIM * cell_width_px), 1)
    padded = np.pad(blocks, 1, mode="edge").astype(np.uint8)
    line = padded - cv2.erode(padded, np.ones((3, 3), np.uint8))
    edge = np.asarray(line[1:-1, 1:-1], np.uint8)
    edge[:rim] = edge[-rim:] = 0
    edge[:, :rim] = edge[:, -rim:] = 0
    width = max(round(_EDGE_WIDTH * cell_width_px), 1)
    wide = cv2.dilate(edge, np.ones((width, width), np.uint8))
    value = np.maximum(probability, np.float32(threshold))
    return np.where(wide > 0, value, probability)


def _disc(share: float) -> NDArray[np.uint8]:
    size = 2 * (round(share * _SIDE) // 2) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), np.uint8)


def _opened(dark: Mask) -> Mask:
    """Without what is thinner than a disc; the border of the image cuts nothing."""
    disc = _disc(_LEAST_WIDTH)
    pad = len(disc)
    wide = np.pad(dark.astype(np.uint8), pad, mode="edge")
    return np.asarray(cv2.morphologyEx(wide, cv2.MORPH_OPEN, disc)[pad:-pad, pad:-pad] > 0)


def _within_margins(image: Image) -> tuple[slice, slice]:
    """Part of a tile without the dark margins that run along whole sides."""
    dark = image < _LEVELS[-1]
    top, bottom, left, right = map(_margin, (dark, dark[::-1], dark.T, dark.T[::-1]))
    return slice(top, image.shape[0] - bottom), slice(left, image.shape[1] - right)


def _margin(dark: Mask) -> int:
    """Width of the dark margin at the top, 0 if what is dark there is no margin.

    A margin is narrow and ends at the edge of the cell, which is straight and about parallel to
    that of the tile; a part that a crack cuts off along a whole side has a wavy or slanted edge.
    """
    lines = dark.mean(1) >= 0.85
    width = len(lines) if lines.all() else int(np.argmin(lines))
    if not 0 < width <= _MARGIN * _SIDE:
        return 0
    reach = np.argmin(np.vstack([dark[: 3 * width], np.zeros((1, dark.shape[1]), bool)]), axis=0)
    rim = dark.shape[1] // 4  # the corners may be cut
    reach = reach[rim:-rim].astype(np.float64)
    x = np.arange(len(reach), dtype=np.float64)
    slope, middle = np.polyfit(x, reach, 1)
    wavy = float(np.percentile(np.abs(reach - slope * x - middle), 60))
    return 0 if wavy > _MOST_WAVY * _SIDE or abs(slope) > _MOST_SLANT else width


def _is_cut_corner(part: Mask, cell: Image) -> bool:
    """Whether a part lies in one corner and another corner is cut: the outline of the wafer.

    Corners are cut unequally: of a small one nobody can tell whether it was cut or broke off.
    """
    reach = round(_CORNER * _SIDE)
    flipped = []
    for axis in (0, 1):
        at = np.flatnonzero(part.any(1 - axis))
        first, last = at[-1] < reach, at[0] >= part.shape[axis] - reach
        if not (first or last):
            return False
        flipped.append(bool(last))
    rim, size = round(_RIM * _SIDE), round(_TIP * _SIDE)
    y, x = np.mgrid[:size, :size]
    tip = x + y < size
    here = (flipped[0], flipped[1])
    for other in product((False, True), repeat=2):
        if other == here:
            continue
        upright = cell[:: -1 if other[0] else 1, :: -1 if other[1] else 1]
        if np.median(upright[rim : rim + size, rim : rim + size][tip]) < _TIP_LEVEL:
            return True
    return False


def _cut_off(part: Mask, cell: Image) -> bool:
    edge = _edge_of(part, cell)
    return edge is not None and edge.of_block


@dataclass(frozen=True)
class Edge:
    """What the edge of a dark part looks like where it meets the rest of the cell.

    Parameters
    ----------
    sharp, straight : float
        Shares of it.
    length : float
        Of the cell's longer side.
    solid : float
        Area of the part over that of its convex hull.
    ratio : float
        Brightness inside over that just outside.
    at_border : bool
        Whether the part reaches the border of the cell.
    """

    sharp: float
    straight: float
    length: float
    solid: float
    ratio: float
    at_border: bool

    @property
    def of_block(self) -> bool:
        """Whether it is that of a part that is cut off."""
        more = 0.0 if self.at_border else _INNER
        return (
            self.ratio <= _MOST_BRIGHT
            and self.sharp >= _LEAST_SHARP + more
            and self.straight >= _LEAST_STRAIGHT + more
            and self.solid >= _LEAST_SOLID
            and self.length >= _PIECE
        )


def _edge_of(part: Mask, cell: Image) -> Edge | None:
    """Measure the edge of a dark part; None if it has none within the cell."""
    h, w = part.shape
    rim = round(_RIM * _SIDE)
    y, x = np.mgrid[:h, :w]
    to_border = np.minimum(np.minimum(y, h - 1 - y), np.minimum(x, w - 1 - x))
    at_border = bool((to_border[part] <= rim).any())
    mask = part.astype(np.uint8)
    padded = np.pad(mask, 1, mode="edge")
    eroded = cv2.erode(padded, np.ones((3, 3), np.uint8))[1:-1, 1:-1]
    edge = np.argwhere((mask > eroded) & (to_border > rim))
    around = cv2.dilate(mask, _disc(4 * _REACH)) - cv2.dilate(mask, _disc(2 * _REACH))
    outside = cell[(around > 0) & (to_border > rim)]
    if len(edge) < _PIECE * _SIDE or outside.size < 0.05 * len(edge):
        return None
    deep = cv2.erode(padded, _disc(_REACH))[1:-1, 1:-1] > 0
    dark = float(np.median(cell[deep if deep.any() else part]))
    light = float(np.median(outside))
    if light <= dark:
        return None
    soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 2.0, borderType=cv2.BORDER_REPLICATE)
    out = -np.stack([cv2.Sobel(soft, cv2.CV_32F, 0, 1), cv2.Sobel(soft, cv2.CV_32F, 1, 0)], -1)
    normal = np.asarray(out[tuple(edge.T)], np.float64)
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-6)
    sides = [_sampled(cell, edge + step * _REACH * _SIDE * normal) for step in (1, -1)]
    fall = (sides[0] - sides[1]) / (light - dark)
    contours = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    contour = np.asarray(max(contours, key=cv2.contourArea), np.int32)
    hull = cv2.contourArea(cv2.convexHull(contour))
    return Edge(
        sharp=float((fall >= 0.5).mean()),
        straight=_straight(contour, part.shape, rim),
        length=len(edge) / _SIDE,
        solid=float(cv2.contourArea(contour) / max(hull, 1.0)),
        ratio=dark / light,
        at_border=at_border,
    )


def _sampled(image: Image, at: NDArray[np.float64]) -> Image:
    """Values at (row, column)."""
    points = np.asarray(at, np.float32)[:, None]
    values = cv2.remap(
        image, points[..., 1], points[..., 0], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(values[:, 0], np.float32)


def _straight(contour: NDArray[np.int32], shape: tuple[int, ...], rim: int) -> float:
    """Share of the inner edge that lies in straight pieces."""
    corners = cv2.approxPolyDP(contour, _TOLERANCE * _SIDE, True)[:, 0].astype(np.float64)
    ends = np.roll(corners, -1, axis=0)
    length = np.hypot(*(ends - corners).T)
    along = np.linspace(0, 1, 9)[:, None, None]
    points = corners * (1 - along) + ends * along
    high = np.array(shape[::-1]) - 1 - rim
    inner = ((points > rim) & (points < high)).all(-1).mean(0) * length
    return float(inner[length >= _PIECE * _SIDE].sum() / max(inner.sum(), 1e-9))
