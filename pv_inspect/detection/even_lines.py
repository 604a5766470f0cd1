"""Evenly spaced dark lines in a part of a frame: candidates for the borders between cells."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.detection.line_profiles import along, line_profiles

__all__ = ["EvenLines", "even_lines"]

Array = NDArray[np.float64]
Image = NDArray[np.float32]

# No search for these constants is on record: they were set by hand on seeds 0 to 3 and 20 to 31 of
# `python benchmarks/partial_views.py`.

MOST_TURNED_DEG, STEP_DEG = 24, 2
LEAST_CELL_PX, LEAST_LINES = 14, 2.2
NARROW_REACH_PX, LINE_REACH_PX = 1.0, 3.0
"""So far to its sides a line may be seen: where its direction is sought, and where its place is."""
EACH_SIDE = 3
"""Lines on either side of the middle that count. Perspective and the lens space them unevenly, and
among many lines an error of the period adds up; and of all periods as many are asked."""
PERIOD_STEP_PX = 1.0
"""The outermost lines are then at most 1.5 px beside where a period puts them."""
DEPTH_QUANTILE = 0.2
PER_STEP = 4.0
"""How much a step of the brightness counts beside the depth of a line."""
LEAST_SHARE_OF_DEPTH = 0.5
SAME_PERIOD, SAME_PHASE_PX = 0.05, 3.0
"""Lines that differ by less (period: share) are the same ones."""


@dataclass(frozen=True)
class EvenLines:
    """Evenly spaced dark lines: normal . p = offset + k period.

    Parameters
    ----------
    normal : (2,) float64
        Unit vector across the lines.
    offset : float
        Of the line nearest to the middle of the window, pixels.
    period : float
        Pixels.
    score : float
        Depth of the lines, more if the brightness differs on their two sides.
    """

    normal: Array
    offset: float
    period: float
    score: float


def even_lines(
    image: Image, centre: tuple[float, float], half: int, upright: bool
) -> list[EvenLines]:
    """Find evenly spaced dark lines in a window, in the direction in which they are sharpest.

    Parameters
    ----------
    image : (height, width) float32
    centre : tuple of float
        (x, y) of the middle of the window, pixels.
    half : int
        Half of its side, pixels.
    upright : bool
        Whether the lines run from top to bottom, give or take 24 degrees, or from left to right.

    Returns
    -------
    list of EvenLines
        All that are about as deep as the deepest ones, best first.
    """
    sharpest = -1.0
    profiles, steps, normal = (np.zeros(0), np.zeros(0)), np.zeros(0), np.zeros(0)
    for degrees in range(-MOST_TURNED_DEG, MOST_TURNED_DEG + 1, STEP_DEG):
        turn = np.radians(degrees)
        x, y = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
        if not upright:
            x, y = y, -x
        # Columns of the window run along the lines.
        to_image = np.column_stack([x, y, centre - half * (x + y)]).astype(np.float32)
        size = (2 * half + 1, 2 * half + 1)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        window = np.asarray(
            cv2.warpAffine(image, to_image, size, flags=flags, borderMode=cv2.BORDER_REPLICATE),
            np.float32,
        )
        bands = line_profiles(window, 1.0)
        # Lines are sharp where the window is turned right. Noise, which is sharpest where it is not
        # turned at all, makes all places look a little darker than what is beside them.
        narrow = along(bands, NARROW_REACH_PX)
        sharp = float(np.square(np.maximum(narrow - np.median(narrow), 0)).mean())
        if sharp > sharpest:
            sharpest, normal = sharp, x
            profiles, steps = (along(bands, LINE_REACH_PX), narrow), _steps(window)
    return _combs(*profiles, steps, normal, float(normal @ centre) - half)


def _steps(window: Image) -> Array:
    """How much the brightness differs on both sides of each column: it does between two cells."""
    smooth = cv2.blur(window, (5, 3))
    padded = cv2.copyMakeBorder(smooth, 0, 0, 6, 6, cv2.BORDER_REPLICATE)
    one, other = padded[:, :-12], padded[:, 12:]
    change = (other - one) / np.maximum(other + one, 1e-4)
    bands = [np.abs(np.median(band, axis=0)) for band in np.array_split(change, 6)]
    return np.asarray(np.median(bands, axis=0), np.float64)


def _combs(
    profile: Array, narrow: Array, steps: Array, normal: Array, origin: float
) -> list[EvenLines]:
    found: list[EvenLines] = []
    middle = len(profile) // 2
    deepest = max(float(narrow.max()), 1e-9)
    near = range(-round(LINE_REACH_PX), round(LINE_REACH_PX) + 1)
    for period in np.arange(LEAST_CELL_PX, len(profile) / LEAST_LINES, PERIOD_STEP_PX):
        phases = middle + np.arange(round(period)) - round(period) // 2
        k = np.arange(-EACH_SIDE, EACH_SIDE + 1)
        at = np.round(phases[:, None] + period * k).astype(np.int64)
        inside = (at >= 0) & (at < len(profile))
        at = np.clip(at, 0, len(profile) - 1)
        count = inside.sum(axis=1)
        depths = np.sort(np.where(inside, profile[at], np.inf), axis=1)
        depth = depths[np.arange(len(at)), (DEPTH_QUANTILE * count).astype(np.int64)]
        step = (steps[at] * inside).sum(axis=1) / count
        # Within reach of the lines are many periods; that on the lines themselves is meant.
        sharp = (narrow[at] * inside).sum(axis=1) / count / deepest
        scores = depth * (1 + PER_STEP * step) * (1 + sharp) * np.sqrt(count)
        # All places within reach of a line are as deep: the middle of them is meant.
        blurred = np.mean([np.roll(scores, d) for d in near], axis=0)
        around = [np.roll(blurred, d) for d in near if d]
        found += [
            EvenLines(normal, origin + float(phases[n]), float(period), float(scores[n]))
            for n in np.flatnonzero(blurred >= np.max(around, axis=0))
        ]
    found.sort(key=lambda lines: -lines.score)
    distinct: list[EvenLines] = []
    for lines in found:
        if lines.score < LEAST_SHARE_OF_DEPTH * found[0].score:
            break
        if not any(_same(lines, other) for other in distinct):
            distinct.append(lines)
    return distinct


def _same(one: EvenLines, other: EvenLines) -> bool:
    if abs(one.period / other.period - 1) > SAME_PERIOD:
        return False
    apart = (one.offset - other.offset) / other.period
    return abs(apart - round(apart)) * other.period < SAME_PHASE_PX
