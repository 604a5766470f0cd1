"""Training cells of other makers, rendered over real ones: metallisation, outline, inactive parts.

Real cells with labelled cracks show one family of modules. Here they get other busbars and wires,
resolved finger grids, interrupted fingers, chipped corners and dark surrounds; none of these is a
crack, and the labels say so. Lengths are shares of the cell's longer side, `CELL_PX`; "156 mm" is
that side of the wafer.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.cracks.classes import BUSBAR, CLASSES, CRACK
from pv_inspect.cracks.network import CELL_PX

__all__ = ["Diversity", "busbars_run_along_rows", "with_fingers", "with_other_metal"]

Image = NDArray[np.float32]
Label = NDArray[np.uint8]

_DARK = CLASSES.index("dark")
_SIDE_MM = 156.0
# A line of pixels belongs to a busbar if this share of it is labelled so.
_BUSBAR_SHARE = 0.3


@dataclass(frozen=True)
class Diversity:
    """How often a drawn cell gets what (shares of the cells).

    Parameters
    ----------
    busbars : float
        Other busbars, 0 to 16, in place of its own.
    fingers : float
        A finger grid that is resolved, 0.8 to 2 mm pitch.
    interruptions : float
        Interrupted fingers.
    chips : float
        Chipped corners and edges: inactive, class "dark".
    surrounds : float
        Dark surroundings within the tile.
    corners : float
        Large cut corners, straight or round.
    """

    busbars: float = 0.35
    fingers: float = 0.35
    interruptions: float = 0.4
    chips: float = 0.12
    surrounds: float = 0.2
    corners: float = 0.2


def busbars_run_along_rows(label: Label) -> bool:
    """Whether the labelled busbars of a cell run along its rows of pixels; true if it has none."""
    bars = label == BUSBAR
    return bool(bars.mean(1).max() >= bars.mean(0).max())


def with_other_metal(
    image: Image, label: Label, rng: np.random.Generator, share: Diversity
) -> tuple[Image, Label]:
    """Give a cell other busbars and interrupted fingers, chips and surrounds.

    Parameters
    ----------
    image : (h, w) float32
    label : (h, w) uint8
    rng : numpy Generator
    share : Diversity

    Returns
    -------
    image : (h, w) float32
    label : (h, w) uint8
    """
    turned = not busbars_run_along_rows(label)
    if turned:
        image, label = np.ascontiguousarray(image.T), np.ascontiguousarray(label.T)
    if rng.random() < share.busbars:
        image, label = _other_busbars(image, label, rng)
    if rng.random() < share.interruptions:
        image = _interrupted(image, label, rng)
    if turned:
        image, label = np.ascontiguousarray(image.T), np.ascontiguousarray(label.T)
    if rng.random() < share.corners:
        image, label = _large_corners(image, label, rng)
    if rng.random() < share.chips:
        image, label = _chipped(image, label, rng)
    if rng.random() < share.surrounds:
        image, label = _surrounded(image, label, rng)
    return image, label


def with_fingers(image: Image, label: Label, rng: np.random.Generator) -> Image:
    """Draw a finger grid across the busbars: pitch 0.8 to 2 mm, mostly faint.

    The pixels integrate over the fingers, so that a pitch of not much more than a pixel shows as
    moire, as it does in photographs.
    """
    upright = busbars_run_along_rows(label)
    h, w = image.shape
    pitch = rng.uniform(0.8, 2.0) / _SIDE_MM * CELL_PX
    duty = rng.uniform(0.05, 0.5)
    depth = float(np.exp(rng.uniform(np.log(0.04), np.log(0.6))))
    slope = rng.normal(0, 0.006)
    y, x = np.mgrid[:h, :w].astype(np.float32)
    at = (x + slope * y if upright else y + slope * x) + rng.uniform(0, pitch)
    blur = rng.uniform(0.0, 0.35) * pitch

    def covered(position: Image) -> Image:
        """Integral of the finger pattern from 0 on, in pixels."""
        n = np.floor(position / pitch)
        return np.asarray(
            n * duty * pitch + np.minimum(position - n * pitch, duty * pitch), np.float32
        )

    reach = np.float32(0.5 + blur)
    shade = (covered(at + reach) - covered(at - reach)) / (2 * reach)
    # Prints differ from finger to finger and along them.
    uneven = np.ones((h, w), np.float32)
    if rng.random() < 0.5:
        n = int(np.ceil((w if upright else h) / pitch)) + 2
        gains = rng.normal(1, rng.uniform(0, 0.5), n).clip(0, 2).astype(np.float32)
        uneven = gains[np.clip((at / pitch).astype(int), 0, n - 1)]
    return np.asarray(image * (1 - np.float32(depth) * np.clip(shade * uneven, 0, 1)), np.float32)


def _other_busbars(image: Image, label: Label, rng: np.random.Generator) -> tuple[Image, Label]:
    """Fill the busbars, which run along rows, from their sides and draw others."""
    h, w = image.shape
    rows = (label == BUSBAR).mean(1) >= _BUSBAR_SHARE
    rows = np.convolve(rows, np.ones(5), "same") > 0
    good, bad = np.flatnonzero(~rows), np.flatnonzero(rows)
    image, label = image.copy(), label.copy()
    if bad.size and good.size > 8:
        after = np.clip(np.searchsorted(good, bad), 1, good.size - 1)
        a, b = good[after - 1], good[after]
        part = np.clip((bad - a) / np.maximum(b - a, 1), 0, 1).astype(np.float32)[:, None]
        # Mirrored from either side: the grain goes on.
        up = image[np.clip(2 * a - bad, 0, h - 1)]
        down = image[np.clip(2 * b - bad, 0, h - 1)]
        image[bad] = up * (1 - part) + down * part
    label[label == BUSBAR] = 0
    n = int(rng.integers(0, 17))
    if not n:
        return image, label
    wire = n >= 7 and rng.random() < 0.8
    width = rng.uniform(0.25, 0.6) if wire else rng.uniform(0.5, 2.2) * min(1.0, 4 / n)
    width *= CELL_PX / _SIDE_MM
    depth = rng.uniform(0.15, 0.9)
    # Of a cut cell the busbars run along the cut or across it: their pitch is that of the wafer.
    pitch = CELL_PX / n if rng.random() < 0.5 else h / n
    y = np.arange(h, dtype=np.float32)[:, None]
    from_next = np.abs((y + rng.normal(0, 1.0)) % pitch - pitch / 2)
    line = np.clip(width / 2 - from_next + 0.5, 0, min(width, 1.0))
    if wire:
        line = np.maximum(line, 0.3 * np.exp(-((from_next / (1.5 * width + 0.5)) ** 2)))
    along = np.ones(w, np.float32)
    if rng.random() < 0.3:  # pads, or a dashed front side
        period = rng.uniform(0.06, 0.3) * CELL_PX
        on = (np.arange(w) + rng.uniform(0, period)) % period < rng.uniform(0.3, 0.8) * period
        along = np.where(on, 1.0, rng.uniform(0.2, 0.7)).astype(np.float32)
    image = np.asarray(image * (1 - depth * line * along[None]), np.float32)
    bars = np.broadcast_to(from_next <= max(width / 2, 0.75), (h, w))
    label[bars & ((label != CRACK) if width < 1.5 else True)] = BUSBAR
    return image, label


def _interrupted(image: Image, label: Label, rng: np.random.Generator) -> Image:
    """Short dark bars along the fingers, from a busbar or between two breaks: no cracks.

    Fingers run along columns here. A dead piece ends where the next busbar feeds the finger.
    """
    h, w = image.shape
    bars = (label == BUSBAR).mean(1) >= _BUSBAR_SHARE
    edges = np.flatnonzero(np.diff(bars.astype(np.int8), prepend=0, append=0))
    ends = np.unique(np.concatenate([[0], edges, [h]])).astype(float)
    value = np.ones((h, w), np.float32)
    y, x = np.arange(h, dtype=np.float32)[:, None], np.arange(w, dtype=np.float32)[None]
    crowd = rng.random() < 0.2
    near = rng.uniform(0, w)
    for _ in range(1 + int(rng.poisson(12 if crowd else 2))):
        k = int(rng.integers(len(ends) - 1))
        top, bottom = ends[k], ends[k + 1]
        span = bottom - top
        kind = rng.random()
        first, last = np.sort(rng.uniform(0, 1, 2)) * span + top
        if kind < 0.35:
            first = top
        elif kind < 0.7:
            last = bottom
        elif kind < 0.8:
            first, last = top, bottom
        last = max(last, first + 3)
        pitch = rng.uniform(0.8, 2.5) / _SIDE_MM * CELL_PX
        width = pitch * rng.choice([1, 1, 1, 2, 3])
        x0 = near + rng.normal(0, 0.08 * w) if crowd else rng.uniform(-2, w)
        across = np.clip(np.minimum(x - x0, x0 + width - x) + 0.5, 0, 1)
        soft = max(rng.uniform(0.3, 0.15 * max(span, 3)), 0.3)
        along = np.clip(np.minimum(y - first, last - y) / soft + 0.5, 0, 1)
        depth = np.float32(np.exp(rng.uniform(np.log(0.06), np.log(0.75))))
        value *= 1 - depth * across * along
    return np.asarray(image * value, np.float32)


def _large_corners(image: Image, label: Label, rng: np.random.Generator) -> tuple[Image, Label]:
    """Pseudo-square wafers: corners cut straight or round, more of them than usual."""
    h, w = image.shape
    y, x = np.mgrid[:h, :w].astype(np.float32)
    if rng.random() < 0.5:
        radius = rng.uniform(1.2, 1.36) * max(h, w) / 2
        edge = np.float32(radius) - np.hypot(x - (w - 1) / 2, y - (h - 1) / 2)
        if min(h, w) < 0.8 * max(h, w):  # a cut cell has two of the four corners
            middle = rng.choice([0.0, 1.0])
            long_x = w > h
            centre = ((w - 1) / 2, middle * (h - 1)) if long_x else (middle * (w - 1), (h - 1) / 2)
            edge = np.float32(radius) - np.hypot(x - centre[0], y - centre[1])
    else:
        size = np.float32(rng.uniform(0.06, 0.17) * CELL_PX)
        four = [x + y, w - 1 - x + y, x + h - 1 - y, w - 1 - x + h - 1 - y]
        edge = np.asarray(np.minimum.reduce(four) - size, np.float32)
    kept = np.clip(edge / rng.uniform(0.7, 4) + 0.5, 0, 1)
    level = rng.uniform(0, 0.3)
    return (
        np.asarray(image * (level + (1 - level) * kept), np.float32),
        np.where(kept < 0.5, np.uint8(0), label),
    )


def _chipped(image: Image, label: Label, rng: np.random.Generator) -> tuple[Image, Label]:
    """A piece of a corner or an edge is broken off or carries no current."""
    h, w = image.shape
    points = []
    a, b = rng.uniform(0.04, 0.3, 2) * CELL_PX
    n = int(rng.integers(2, 6))
    for part in np.linspace(0, 1, n):
        jitter = rng.normal(0, 0.15) if 0 < part < 1 else 0.0
        points.append((a * (1 - part) * (1 + jitter), b * part * (1 + jitter)))
    corner = np.array([(-9, -9), (points[0][0], -9), *points, (-9, points[-1][1])])
    mask = np.zeros((h, w), np.uint8)
    cv2.fillPoly(mask, [np.round(corner).astype(np.int32)], 1)
    mask = mask[:: rng.choice([1, -1]), :: rng.choice([1, -1])]
    soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), rng.uniform(0.4, 1.5))
    level = np.float32(rng.uniform(0, 0.3))
    chip = mask > 0
    label = np.where(chip & (label != BUSBAR), np.uint8(_DARK), label)
    return np.asarray(image * (1 - (1 - level) * soft), np.float32), np.asarray(label, np.uint8)


def _surrounded(image: Image, label: Label, rng: np.random.Generator) -> tuple[Image, Label]:
    """The cell shrunk within its tile, with a dark surround as of a photograph of one cell."""
    h, w = image.shape
    left, right = rng.uniform(0, 0.09, 2) * CELL_PX
    top, bottom = rng.uniform(0, 0.09, 2) * CELL_PX
    scale_x, scale_y = (w - left - right) / w, (h - top - bottom) / h
    if min(scale_x, scale_y) < 0.5:
        return image, label
    matrix = np.array([[scale_x, 0, left], [0, scale_y, top]])
    level = float(rng.uniform(0, 0.3) * np.median(image))
    edge = cv2.BORDER_CONSTANT
    moved = cv2.warpAffine(
        image, matrix, (w, h), flags=cv2.INTER_LINEAR, borderMode=edge, borderValue=level
    )
    classes = cv2.warpAffine(label, matrix, (w, h), flags=cv2.INTER_NEAREST)
    return np.asarray(moved, np.float32), np.asarray(classes, np.uint8)
