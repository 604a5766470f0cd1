"""Interrupted fingers: straight dark bars along the fingers of a cell that no crack has made.

A finger is a thin printed line across the busbars. Where it is interrupted, what it should feed
carries less current: a bar as wide as one or a few fingers are apart, exactly along the fingers,
that ends at the break and at a busbar, or fades towards the side that is still fed. Cracks wander
or cross the fingers. A bar that a detector marks as a crack is left to it: of the two a crack is
the worse thing to miss.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.cracks.flatten import CELL_PX
from pv_inspect.cracks.isolation import Busbars

__all__ = ["InterruptedFinger", "interrupted_fingers"]

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Widths of bars, pixels of `CELL_PX`: 0.6 to 5 mm of a cell of 156 mm.
_WIDTHS = (1, 2, 3, 4, 6, 8)
# Each side is compared over at least this width.
_FLANK = 3
# Least length, and the rim of the cell that is left out, in cell widths; least length in pixels of
# the tile: of fewer the direction can't be told, and dark grains that touch are taken for a bar.
_LEAST_LENGTH = 0.1
_RIM = 0.04
_LEAST_TILE_PX = 12
# Bars of two spans are one line if they are no further apart across and along, pixels of
# `CELL_PX`; along that includes the busbar.
_ALIGNED, _APART = 4, round(0.12 * CELL_PX)
# Pixels over which the contrast is averaged where a bar ends.
_ENDS_PX = 7
# The rest is chosen on labelled training cells, and on cells rendered over them and over simulated
# ones (benchmarks/crack_fingers.py). Contrast with the darker side, that of random places in the
# cell in robust standard deviations; of a bar's own contrast what its ends may fall to, and what
# this share of its pixels must have.
_LEAST_CONTRAST = 0.03
_LEAST_SIGMAS = 4.5
_END = 0.5
_FIRM, _FIRM_SHARE = 0.4, 0.8
# Brightness of the sides over the median of the cell: not within dark parts.
_LEAST_LEVEL = 0.5
# Most that a bar may lean over its length, pixels of `CELL_PX`, and how far it is looked for.
_MOST_LEAN, _LEANS = 1, 10
# Share of a bar on crack marks, dilated by so many cell widths, from which on it is left to them.
_MOST_MARKED, _NEAR_MARK = 0.2, 0.01
# Contrast where a bar can't be.
_NOWHERE = np.float32(-0.3)
_MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True)
class InterruptedFinger:
    """One dark bar along a finger.

    Parameters
    ----------
    rows, cols : (int, int)
        First and end pixel of the tile.
    length_px : float
        Length along the finger, pixels of the tile.
    contrast : float
        How much darker it is than its darker side, mean over its length, in [0, 1].
    """

    rows: tuple[int, int]
    cols: tuple[int, int]
    length_px: float
    contrast: float


@dataclass(frozen=True, eq=False)
class _Bar:
    """A candidate at the working size, fingers along rows of the array (axis 0)."""

    span: int
    first: int
    end: int
    left: int
    right: int
    column: int
    contrast: float
    response: Image

    @property
    def weight(self) -> float:
        return self.contrast * float(np.sqrt((self.end - self.first) * (self.right - self.left)))

    def meets(self, other: _Bar) -> bool:
        along = min(self.end, other.end) - max(self.first, other.first)
        across = min(self.right, other.right) - max(self.left, other.left)
        return along > 0 and across > -4

    def lean(self) -> int:
        """By how many pixels it leans over its length: where it is darkest."""
        rows = np.arange(self.first, self.end)
        way = np.linspace(-0.5, 0.5, len(rows))
        most = self.response.shape[1] - 1

        def darkness(lean: int) -> tuple[float, int]:
            at = np.clip(np.rint(self.column + lean * way).astype(int), 0, most)
            return float(self.response[rows, at].mean()), -abs(lean)

        return max(range(-_LEANS, _LEANS + 1), key=darkness)


def interrupted_fingers(
    tile: Image, busbars: Busbars, marks: Sequence[Mask] = ()
) -> list[InterruptedFinger]:
    """Find interrupted fingers in the image of a cell.

    Parameters
    ----------
    tile : (h, w) float32
        Any brightness scale.
    busbars : Busbars
        The fingers run across them.
    marks : sequence of (h, w) bool
        Crack marks; a bar on one is not returned.

    Returns
    -------
    list of InterruptedFinger
        The strongest first.

    Notes
    -----
    With I the image, C the mean of I over the width of a bar and L, R those beside it, the contrast
    of a bar at each pixel is 1 - C / min(L, R): positive only if *both* sides are brighter, which
    the edge of a crack's dark part and a slope are not.
    """
    scale = CELL_PX / max(tile.shape)
    size = (max(round(tile.shape[1] * scale), 8), max(round(tile.shape[0] * scale), 8))
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    image = np.asarray(cv2.resize(tile, size, interpolation=way), np.float32)
    if not busbars.horizontal:
        image = np.ascontiguousarray(image.T)
    least = round(max(_LEAST_LENGTH * CELL_PX, _LEAST_TILE_PX * scale))
    spans = _spans(busbars.lines, len(image), least)
    if not spans:
        return []
    found: list[_Bar] = []
    seen: list[_Bar] = []
    for bar in sorted(_candidates(image, spans, least), key=lambda bar: -bar.weight):
        if any(bar.meets(other) for other in seen):
            continue
        seen.append(bar)
        if abs(bar.lean()) <= _MOST_LEAN:
            found.append(bar)
    found = [bar for bar in found if not _goes_on(bar, seen)]
    on_tile = [_on_tile(bar, busbars.horizontal, 1 / scale, tile.shape) for bar in found]
    if not marks:
        return on_tile
    reach = 2 * max(round(_NEAR_MARK * max(tile.shape)), 1) + 1
    cracked = np.logical_or.reduce(list(marks)).astype(np.uint8)
    cracked = np.asarray(cv2.dilate(cracked, np.ones((reach, reach), np.uint8)), np.uint8)
    return [bar for bar in on_tile if _marked_share(bar, cracked) < _MOST_MARKED]


def _spans(lines: Mask, length: int, least: int) -> list[tuple[int, int]]:
    """Rows between busbars, and beyond the outer ones, that are long enough for a bar."""
    bars = cv2.resize(lines.astype(np.uint8)[:, None], (1, length), interpolation=cv2.INTER_NEAREST)
    wide = cv2.dilate(bars, np.ones((3, 1), np.uint8))[:, 0] > 0
    rim = round(_RIM / 2 * CELL_PX)
    wide[:rim] = wide[-rim:] = True
    edges = np.flatnonzero(np.diff(wide.astype(np.int8), prepend=1, append=1)).reshape(-1, 2)
    return [(int(a), int(b)) for a, b in edges if b - a > least]


def _candidates(image: Image, spans: list[tuple[int, int]], least: int) -> Iterator[_Bar]:
    """Runs of pixels along the fingers that are darker than both of their sides."""
    level = _LEAST_LEVEL * float(np.median(image))
    for width in _WIDTHS:
        response = _response(image, width, level)
        means = [_mean_along(response[a:b], least) for a, b in spans]
        whole = slice(least // 2, -(least // 2))
        places = np.concatenate([part[whole].ravel() for part in means])
        places = places[places > _NOWHERE / 2]
        if not places.size:
            continue
        middle = float(np.median(places))
        spread = _MAD_TO_SIGMA * float(np.median(np.abs(places - middle)))
        need = max(_LEAST_CONTRAST, middle + _LEAST_SIGMAS * spread)
        for span, ((first, end), long) in enumerate(zip(spans, means, strict=True)):
            columns = np.flatnonzero(long.max(axis=0) >= _END * need)
            part = response[first:end, columns]
            if not part.size:
                continue
            smooth = _mean_along(part, 3)
            dark = np.pad(_mean_along(part, _ENDS_PX) >= _END * need, ((1, 1), (0, 0)))
            step = np.diff(dark.astype(np.int8), axis=0).T
            starts, stops = (np.argwhere(step == sign) for sign in (1, -1))
            for (k, a), (_, b) in zip(starts, stops, strict=True):
                contrast = float(part[a:b, k].mean())
                if b - a < least or contrast < need:
                    continue
                if (smooth[a:b, k] > _FIRM * contrast).mean() < _FIRM_SHARE:
                    continue
                column, rows = int(columns[k]), (first + int(a), first + int(b))
                left = column - width // 2
                yield _Bar(span, *rows, left, left + width, column, contrast, response)


def _response(image: Image, width: int, level: float) -> Image:
    """Contrast of a bar of this width at each pixel with its darker side."""
    flank = max(_FLANK, width // 2)
    reach = width + flank + 2
    padded = cv2.copyMakeBorder(image, 0, 0, reach, reach, cv2.BORDER_REPLICATE)
    n = image.shape[1]

    def mean(first: int, over: int) -> Image:
        """Mean over pixels from ``first`` on, relative to the first one of the bar."""
        start = reach - width // 2 + first
        part = cv2.blur(padded, (over, 1), anchor=(0, 0), borderType=cv2.BORDER_REPLICATE)
        return np.asarray(part[:, start : start + n], np.float32)

    side = np.minimum(mean(-1 - flank, flank), mean(width + 1, flank))
    contrast = 1 - mean(0, width) / np.maximum(side, np.float32(1e-9))
    contrast = np.where(side >= level, np.maximum(contrast, _NOWHERE), _NOWHERE)
    rim = round(_RIM * CELL_PX)
    contrast[:, :rim] = contrast[:, -rim:] = _NOWHERE
    return np.asarray(contrast, np.float32)


def _mean_along(values: Image, n: int) -> Image:
    mean = cv2.blur(np.ascontiguousarray(values), (1, n), borderType=cv2.BORDER_REPLICATE)
    return np.asarray(mean, np.float32)


def _goes_on(bar: _Bar, bars: list[_Bar]) -> bool:
    """Whether it goes on beyond a busbar: a crack may do so, or a gap; each break is by itself."""
    return any(
        other.span != bar.span
        and abs(other.column - bar.column) <= _ALIGNED
        and max(other.first - bar.end, bar.first - other.end) <= _APART
        for other in bars
    )


def _on_tile(bar: _Bar, horizontal: bool, unit: float, shape: tuple[int, ...]) -> InterruptedFinger:
    along = (round(bar.first * unit), round(bar.end * unit))
    across = (round(bar.left * unit), max(round(bar.right * unit), round(bar.left * unit) + 1))
    rows, cols = (along, across) if horizontal else (across, along)
    return InterruptedFinger(
        (rows[0], min(rows[1], shape[0])),
        (cols[0], min(cols[1], shape[1])),
        (bar.end - bar.first) * unit,
        bar.contrast,
    )


def _marked_share(bar: InterruptedFinger, cracked: NDArray[np.uint8]) -> float:
    part = cracked[slice(*bar.rows), slice(*bar.cols)]
    along = 0 if bar.rows[1] - bar.rows[0] < bar.cols[1] - bar.cols[0] else 1
    return float(part.any(axis=along).mean()) if part.size else 0.0
