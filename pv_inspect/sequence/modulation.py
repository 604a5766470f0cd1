"""Which frames were taken with current and which without, from their levels alone.

By daylight the module glows by some per cent of the light that it reflects. Its current is switched
on and off between the frames, and the level inside the module goes with it, while the level around
it does not. Both are read off small pictures of the frames; how bright the day is, and the gain of
the camera, drop out in their ratio.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.sequence.frame_motion import motion_between
from pv_inspect.sequence.values import Raw

__all__ = ["LevelPictures", "Modulation", "find_modulation"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_PICTURE = (96, 128)
# Rows and columns of the blocks whose levels are followed from frame to frame.
_BLOCKS = (6, 8)
_FILLER = 1e30
# Directions in which the levels change that are looked at: something else may change more.
_DIRECTIONS = 2
# Frames from which on the drift of the daylight is taken as a line, and as a parabola.
_LINE, _PARABOLA = 6, 10
# A frame that is further from both levels, as a share of the step between them, is neither.
_NEITHER = 0.3
# More frames than this share of all that are neither make it no modulation.
_FEW_NEITHER = 0.15
# What follows was chosen with `benchmarks/daylight.py --detector` on seeds 0 to 8, 9 sequences of
# each of 14 kinds; seeds 100 to 107 were kept aside (nothing found that is not there, none wrong).
# The step over the scatter of the levels about it: asked for, and found without being asked for.
_CLEAR_IF_ASKED, _CLEAR = 6.0, 8.0
# The step outside of the module over that inside, at most.
_QUIET_OUTSIDE = 0.25
# Share of the modulated picture that is one piece, at least.
_ONE_PIECE = 0.8
_LEAST_AROUND = 0.03
_LEAST_AREA, _LARGEST_AREA = 0.1, 0.9
# A module fills its convex hull, but for dark cells; what only moved is a seam along its border.
_SOLID = 0.8
# By day the module glows less than this many times the light that it reflects.
_LARGEST_SHARE = 2.0
# By day the surroundings are as bright as the module without current (this quantile of them), at
# night they are not. So many switches are no chance.
_BRIGHT_SURROUNDINGS = 90.0
_LEAST_SWITCHES = 3


@dataclass
class LevelPictures:
    """Small pictures of the frames in stored values, taken while they are read one by one."""

    _pictures: list[NDArray[np.float32]] = field(default_factory=list)

    def add(self, raw: Raw) -> None:
        """Take note of the next frame, (height, width)."""
        if raw.dtype.kind == "f":
            raw = np.where(np.abs(raw) < _FILLER, raw, np.float32(0))
        small = cv2.resize(raw, _PICTURE[::-1], interpolation=cv2.INTER_AREA)
        self._pictures.append(np.asarray(small, np.float32))

    def of(self, frames: Sequence[int]) -> NDArray[np.float32]:
        """Return the pictures of some frames, (n_frames, 96, 128), stored values."""
        return np.array([self._pictures[k] for k in frames])


@dataclass(frozen=True, eq=False)
class Modulation:
    """The current of every frame.

    Parameters
    ----------
    current : tuple of bool or None
        On, off, or neither.
    region : (96, 128) bool
        Where the frames get brighter with the current.
    share : float
        By how much, as a share of the level without it.
    clearness : float
        The step of the level over its scatter; infinite for up to four frames.
    certain : bool
        Whether it is clear enough to be used without being asked for.
    """

    current: tuple[bool | None, ...]
    region: Mask
    share: float
    clearness: float
    certain: bool

    @property
    def switches(self) -> int:
        """How often the current was switched on or off."""
        known = [state for state in self.current if state is not None]
        return sum(a != b for a, b in pairwise(known))


def find_modulation(pictures: NDArray[np.float32], wanted: bool = False) -> Modulation | None:
    """Find the frames with current and those without.

    Parameters
    ----------
    pictures : (n_frames, 96, 128) float32
        Of `LevelPictures`; frames in the order in which they were taken.
    wanted : bool
        Look closely even if nothing looks like it at first.

    Returns
    -------
    Modulation or None
        None if no part of the frames gets brighter and darker as a whole.

    Notes
    -----
    The logarithms of the levels of 6 x 8 blocks are followed from frame to frame. The directions
    in which they jump or differ most may be the current's; along it every frame is a parabola (the
    day) plus a step. With a camera that sets its own gain the common part of all blocks is taken
    out first. Where the pictures, as they are or shifted onto each other, hint at a step, or it is
    wanted, they are registered, and what is found then counts, the clearest first.
    """
    if len(pictures) < 2 or float(pictures.max()) <= 0:
        return None
    floor = 1e-4 * float(pictures.max())
    taken = np.maximum(pictures.astype(np.float64), floor)
    # The registration takes a second: most sequences do not get there.
    if not (wanted or _candidates(taken) or _candidates(_shifted(taken))):
        return None
    return max(_candidates(_registered(taken)), key=_rank, default=None)


def _candidates(pictures: Array) -> list[Modulation]:
    """Return what may be a switched current."""
    levels = np.log(_blocks(pictures))
    found: list[Modulation] = []
    for own_gain in (False, True):
        x = levels - levels.mean(axis=1, keepdims=True) if own_gain else levels
        directions = [
            np.linalg.svd(changes, full_matrices=False)[2][:_DIRECTIONS]
            for changes in (np.diff(x, axis=0), x - x.mean(axis=0))
        ]
        for direction in np.concatenate(directions):
            states, clearness = _two_levels(x @ direction)
            for current in (states, tuple(None if s is None else not s for s in states)):
                one = _checked(pictures, current, clearness, own_gain)
                if one is not None:
                    found += [one, *_refined(pictures, one)]
    return found


def _refined(pictures: Array, found: Modulation) -> list[Modulation]:
    """Follow the level inside the module over that around it: no light and no gain is in it."""
    around = _beyond(found.region)
    if around.mean() < _LEAST_AROUND:
        return []
    inside, outside = (pictures[:, where].mean(axis=1) for where in (found.region, around))
    current, clearness = _two_levels(np.log(inside / outside))
    up = np.array([state is True for state in current])
    was = np.array([state is True for state in found.current])
    if np.sum(up == was) < np.sum(up != was):
        current = tuple(None if state is None else not state for state in current)
    one = _checked(pictures, current, clearness, own_gain=True)
    return [] if one is None else [one]


def _beyond(region: Mask) -> Mask:
    around: Mask = cv2.dilate(region.astype(np.uint8), np.ones((5, 5), np.uint8)) == 0
    return around


def _rank(one: Modulation) -> tuple[bool, bool, float, float]:
    border = np.ones(_PICTURE, bool)
    border[1:-1, 1:-1] = False
    switched = one.switches >= _LEAST_SWITCHES
    return one.certain, switched, -round(float(one.region[border].mean()), 1), one.clearness


def _shifted(pictures: Array) -> Array:
    """Move the pictures onto the middle one, where that makes them more alike."""
    reference = len(pictures) // 2
    window = cv2.createHanningWindow(_PICTURE[::-1], cv2.CV_64F)
    detail = np.array([_detail(p) for p in pictures])
    out = pictures.copy()
    for k, picture in enumerate(pictures):
        if k == reference:
            continue
        (dx, dy), _ = cv2.phaseCorrelate(detail[reference], detail[k], window)
        if np.hypot(dx, dy) > 0.25 * min(_PICTURE):
            continue
        move = np.array([[1.0, 0.0, dx], [0.0, 1.0, dy]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        size = _PICTURE[::-1]
        moved = cv2.warpAffine(detail[k], move, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
        before, after = (np.median(np.abs(d - detail[reference])) for d in (detail[k], moved))
        if after < before:
            out[k] = cv2.warpAffine(
                picture, move, size, flags=flags, borderMode=cv2.BORDER_REPLICATE
            )
    return out


def _registered(pictures: Array) -> Array:
    """Move the pictures onto the middle one, with all that moves between frames."""
    reference = len(pictures) // 2
    first = pictures[reference].astype(np.float32)
    out = pictures.copy()
    for k, picture in enumerate(pictures):
        motion = motion_between(first, picture.astype(np.float32)) if k != reference else None
        if motion is not None:
            maps = motion.maps(_PICTURE)
            out[k] = cv2.remap(picture, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.maximum(out, float(pictures.min()))


def _detail(picture: Array) -> Array:
    detail: Array = picture / max(float(picture.mean()), 1e-9)
    return detail - cv2.GaussianBlur(detail, (0, 0), 4.0)


def _blocks(pictures: Array) -> Array:
    n, (rows, cols) = len(pictures), _BLOCKS
    tall, wide = _PICTURE[0] // rows, _PICTURE[1] // cols
    means: Array = pictures.reshape(n, rows, tall, cols, wide).mean(axis=(2, 4)).reshape(n, -1)
    return means


def _two_levels(level: Array) -> tuple[tuple[bool | None, ...], float]:
    """Split a series into two levels about a slow drift; which of them is "on" is not known."""
    n = len(level)
    t = np.linspace(-1.0, 1.0, n)
    degree = 0 if n < _LINE else 1 if n < _PARABOLA else 2
    drift = np.vander(t, degree + 1)
    fits = [fit for start in _starts(level, t) if (fit := _split(level, drift, start)) is not None]
    if not fits:
        return (None,) * n, 0.0
    best = min(fits, key=lambda fit: fit.cost)
    states = tuple(
        None if odd else bool(up) for odd, up in zip(~best.clear, best.high, strict=True)
    )
    free = int(best.clear.sum()) - degree - 2
    if free < 1:
        return states, float("inf")
    scatter = float(np.sqrt(np.sum(np.square(best.rest[best.clear])) / free))
    return states, abs(best.step) / max(scatter, 1e-12)


@dataclass(frozen=True, eq=False)
class _Split:
    """Two levels: which frames have the high one, what is left, which frames have either."""

    high: Mask
    rest: Array
    step: float
    clear: Mask

    @property
    def cost(self) -> float:
        """What is left of the frames, in steps."""
        return float(np.sum(np.abs(self.rest))) / max(abs(self.step), 1e-12)


def _split(level: Array, drift: Array, high: Mask) -> _Split | None:
    """Fit drift and step by turns with the frames' sides, without those that have neither."""
    clear = np.ones(len(level), bool)
    for _ in range(20):
        if min(high[clear].sum(), (~high[clear]).sum()) < 1:
            return None
        design = np.column_stack([drift, high])
        weights = np.linalg.lstsq(design[clear], level[clear], rcond=None)[0]
        step, slow = float(weights[-1]), drift @ weights[:-1]
        again = np.abs(level - slow - step) < np.abs(level - slow)
        rest = level - slow - step * again
        still_clear = np.abs(rest) <= _NEITHER * abs(step)
        if np.array_equal(again, high) and np.array_equal(still_clear, clear):
            break
        high, clear = again, still_clear
    if step == 0.0 or min(high[clear].sum(), (~high[clear]).sum()) < 1:
        return None
    return _Split(high, rest, step, clear)


def _starts(level: Array, t: Array) -> list[NDArray[np.bool_]]:
    """Guess the split: by the jumps, by the line through all, by the largest gap."""
    jumps = np.diff(level)
    usual = float(np.percentile(np.abs(jumps), 80.0)) / 2
    state, by_jumps = 0.0, [0.0]
    for jump in jumps:
        state = 1.0 if jump > usual else -1.0 if jump < -usual else state
        by_jumps.append(state)
    first = next((s for s in by_jumps if s), 0.0)
    by_jumps = [s or -first for s in by_jumps]
    line = level - np.polyval(np.polyfit(t, level, 1), t) if len(level) > 2 else level
    ordered = np.sort(level)
    gap = int(np.argmax(np.diff(ordered)))
    return [
        np.array(by_jumps) > 0,
        line > 0.5 * (line.min() + line.max()),
        level > 0.5 * (ordered[gap] + ordered[gap + 1]),
    ]


def _checked(
    pictures: Array, current: tuple[bool | None, ...], clearness: float, own_gain: bool
) -> Modulation | None:
    """Check where the frames get brighter with the current: in one piece, and nowhere darker."""
    on = [k for k, state in enumerate(current) if state is True]
    off = [k for k, state in enumerate(current) if state is False]
    if not on or not off or clearness < _CLEAR_IF_ASKED:
        return None
    if current.count(None) > max(1, _FEW_NEITHER * len(current)):
        return None
    ratio = np.median([pictures[k] / _without(pictures, off, k) for k in on], axis=0)
    ratio = cv2.GaussianBlur(ratio, (0, 0), 1.0)
    if own_gain:
        ratio = ratio / np.percentile(ratio, 10.0)
    excess = ratio - 1.0
    strong = float(np.percentile(excess, 95.0))
    region = excess > 0.5 * strong
    if strong <= 0 or not region.mean() >= _LEAST_AREA:
        return None
    inside = float(np.median(excess[region]))
    count, labels = cv2.connectedComponents(region.astype(np.uint8))
    largest = max(int((labels == k).sum()) for k in range(1, count)) / int(region.sum())
    beyond = _beyond(region)
    outside = float(np.median(np.abs(excess[beyond]))) if beyond.any() else 0.0
    if largest < _ONE_PIECE or _solidity(region) < _SOLID or outside > _QUIET_OUTSIDE * inside:
        return None
    dark = pictures[off].mean(axis=0)
    by_day = bool(beyond.any()) and float(
        np.percentile(dark[beyond], _BRIGHT_SURROUNDINGS)
    ) >= float(np.median(dark[region]))
    made = Modulation(current, region, inside, clearness, certain=False)
    certain = (
        clearness >= _CLEAR
        and np.isfinite(clearness)
        and by_day
        and inside <= _LARGEST_SHARE
        and region.mean() <= _LARGEST_AREA
        and made.switches >= _LEAST_SWITCHES
        and min(len(on), len(off)) >= 2
    )
    return Modulation(current, region, inside, clearness, bool(certain))


def _solidity(region: Mask) -> float:
    """Area over that of the convex hull of its largest piece."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(region.astype(np.uint8))
    piece = labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    hull = cv2.convexHull(np.argwhere(piece)[:, ::-1].astype(np.int32))
    filled = cv2.fillConvexPoly(np.zeros(region.shape, np.uint8), hull, 1)
    return float(piece.sum() / max(int(filled.sum()), 1))


def _without(pictures: Array, off: list[int], k: int) -> Array:
    """Level without current at the time of frame k, between the nearest frames without it."""
    before = max((i for i in off if i < k), default=min(off))
    after = min((i for i in off if i > k), default=max(off))
    share = (k - before) / (after - before) if before < k < after else 0.0
    nearest = before if before < k else after
    between: Array = (1 - share) * pictures[nearest] + share * pictures[after]
    return between
