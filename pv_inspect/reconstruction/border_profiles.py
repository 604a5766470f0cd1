"""Mean profiles of the borders of cells, frame by frame and axis by axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pv_inspect.reconstruction.border_samples import REACH_LR_PX, BorderSamples

__all__ = ["BINS", "BorderProfiles", "border_profiles", "clean_reach"]

Array = NDArray[np.float64]

# Half the length of a profile and its step, LR px; at a step of a sixth the samples of one bin
# differ in distance by a variance of 0.002 LR px^2.
_HALF, _STEP = 19.0 / 6.0, 1.0 / 6.0
BINS = round(2 * _HALF / _STEP)
"""Bins of a profile."""
# Samples that the level of a piece needs on its side.
_LEAST_LEVEL = 5
# A piece whose level is this far from that of its cell is on a busbar or a crack.
_UNLIKE = 0.12
# Cells darker than this share of the usual one are not looked at.
_DARK = 0.3
# Cells whose level changes by more on the way to the border are not looked at, per LR px.
_STEEP = 0.015
# Level along the normal: this far a busbar near the border may change it.
_LEVEL_CHANGE = 0.03
# Length that a slope of the level needs, LR px.
_SLOPE_LENGTH = 1.2


@dataclass(frozen=True, eq=False)
class BorderProfiles:
    """Profiles; the bright side (of outer borders) is to the left.

    Parameters
    ----------
    pair : (n,) int64
        2 * frame + axis.
    outer : (n,) bool
    count : (n, BINS) int64
        Samples in each bin.
    distance, value, left, right : (n, BINS) float64
        Means: distance from the line [LR px], intensity, levels of both sides; intensities and
        levels in units of the cells' level (``right`` is 0 for outer borders).
    variance : (n, BINS) float64
        Of the mean intensity.
    box, motion, scale : (n,) float64
        See `BorderSamples`; the root mean square of the motion.
    """

    pair: NDArray[np.int64]
    outer: NDArray[np.bool_]
    count: NDArray[np.int64]
    distance: Array
    value: Array
    left: Array
    right: Array
    variance: Array
    box: Array
    motion: Array
    scale: Array

    def picked(self, keep: NDArray[np.bool_]) -> BorderProfiles:
        """Return some of the profiles."""
        return BorderProfiles(*(getattr(self, name)[keep] for name in self.__dataclass_fields__))


def clean_reach(samples: BorderSamples, level_from: float, wanted: float) -> tuple[float, float]:
    """How far from the lines of each axis cells keep their level: up to the first busbar.

    Parameters
    ----------
    samples : BorderSamples
    level_from, wanted : float
        Distance at which the level begins, and up to which it is looked at, LR px.
    """
    step = 0.25
    n_bins = int(REACH_LR_PX / step)
    # The level of every cell at every border, so that no single cell decides.
    side = 2 * np.unique(samples.segment, return_inverse=True)[1] + (samples.distance > 0)
    away = np.abs(samples.distance)
    first = (away >= level_from) & (away < level_from + 4 * step)
    n = np.bincount(side[first], minlength=int(side.max(initial=0)) + 1)
    level = np.bincount(side[first], samples.value[first], len(n)) / np.maximum(n, 1)
    # Beyond the outline there is no cell.
    pick = (samples.distance * samples.outer <= 0) & (level[side] > 0)
    at = np.minimum((away / step).astype(np.int64), n_bins - 1) + n_bins * samples.axis
    relative = samples.value[pick] / level[side[pick]]
    usual = _median_of(relative, at[pick], 2 * n_bins).reshape(2, n_bins)
    found = []
    for mean in usual:
        k = round(level_from / step)
        base = float(np.median(mean[k : k + 3]))
        while k < round(min(wanted, REACH_LR_PX) / step) and (
            abs(mean[k] - base) < _LEVEL_CHANGE * base
        ):
            k += 1
        found.append(k * step)
    return found[0], found[1]


def border_profiles(
    samples: BorderSamples, level_from: float, level_to: tuple[float, float]
) -> BorderProfiles:
    """Average samples of one frame and axis.

    Parameters
    ----------
    samples : BorderSamples
    level_from : float
        Distance from which on the blur of the border no longer changes a cell's level, LR px.
    level_to : tuple of float
        Distance up to which the level is read, for each axis; an axis where it is not beyond
        ``level_from`` is left out.
    """
    before = _level(samples, -1, level_from, level_to)
    after = _level(samples, 1, level_from, level_to)
    both = samples.outer == 0
    # Outer borders are turned so that the module is on the left.
    turned = samples.outer < 0
    left, right = np.where(turned, after, before), np.where(both, after, 0.0)
    distance = np.where(turned, -samples.distance, samples.distance)
    level = np.where(both, (before + after) / 2, left)
    keep = np.isfinite(level) & (np.abs(distance) < _HALF)
    n_frames = int(samples.frame.max(initial=0)) + 1
    group = (2 * samples.frame + samples.axis) * 2 + ~both
    place = np.clip((distance + _HALF) / _STEP, 0, BINS - 1).astype(np.int64)
    at = (group * BINS + place)[keep]
    level = level[keep]
    n_groups = 4 * n_frames

    def total(x: Array | None) -> Array:
        sums = np.bincount(at, x, n_groups * BINS)
        return np.asarray(sums.reshape(n_groups, BINS), np.float64)

    count = total(None)
    few = np.maximum(count, 1.0)
    value = samples.value[keep] / level
    mean, square = total(value) / few, total(value**2) / few
    in_group = np.maximum(count.sum(1), 1.0)
    # Scatter of the samples of a bin, as the profiles of all frames together show it.
    scatter = np.maximum(square - mean**2, 0.0) * count
    usual = scatter.sum(0) / np.maximum(count.sum(0), 1.0)
    noisier = scatter.sum(1) / np.maximum((usual * count).sum(1), 1e-30)
    pick = count.sum(1) > 0
    return BorderProfiles(
        np.arange(n_groups) // 2,
        np.arange(n_groups) % 2 == 1,
        count.astype(np.int64),
        total(distance[keep]) / few,
        mean,
        total(left[keep] / level) / few,
        total(right[keep] / level) / few,
        usual * noisier[:, None] / few,
        total(samples.box[keep]).sum(1) / in_group,
        np.sqrt(total(samples.motion[keep] ** 2).sum(1) / in_group),
        total(samples.scale[keep]).sum(1) / in_group,
    ).picked(pick)


def _level(samples: BorderSamples, side: int, start: float, ends: tuple[float, float]) -> Array:
    """Level of the cell on one side, continued to every sample; NaN where it is not known."""
    away = side * samples.distance
    far = (away > start) & (away < np.array(ends)[samples.axis])
    pieces, piece = np.unique(samples.piece, return_inverse=True)
    segment = pieces // 1000
    sides, side_of = np.unique(segment, return_inverse=True)
    n_pieces, n_sides = len(pieces), len(sides)
    n = np.bincount(piece[far], minlength=n_pieces)
    few = np.maximum(n, 1)
    where = np.bincount(piece[far], samples.distance[far], n_pieces) / few
    mean = np.bincount(piece[far], samples.value[far], n_pieces) / few
    # The slope is one for all pieces of a side.
    x = samples.distance[far] - where[piece[far]]
    y = samples.value[far] - mean[piece[far]]
    at = side_of[piece[far]]
    xx, xy = np.bincount(at, x * x, n_sides), np.bincount(at, x * y, n_sides)
    axis = np.zeros(n_sides, np.int64)
    axis[side_of[piece]] = samples.axis
    long = np.array(ends)[axis] - start > _SLOPE_LENGTH
    slope = np.where(long, xy / np.maximum(xx, 1e-9), 0.0)
    good = n >= _LEAST_LEVEL
    usual = _median_of(mean[good], side_of[good], n_sides)
    typical = float(np.median(usual[usual > 0])) if (usual > 0).any() else np.inf
    of_piece = usual[side_of]
    # A cell that darkens towards its border has no level to continue.
    good &= np.abs(slope[side_of]) < _STEEP * of_piece
    good &= (of_piece > _DARK * typical) & (np.abs(mean - of_piece) < _UNLIKE * of_piece)
    level = mean[piece] + slope[side_of[piece]] * (samples.distance - where[piece])
    return np.where(good[piece] & (level > _DARK / 2 * typical), level, np.nan)


def _median_of(values: Array, group: NDArray[np.intp], n_groups: int) -> Array:
    """Median of the values of every group, 0 for groups without any."""
    order = np.lexsort((values, group))
    which, first, n = np.unique(group[order], return_index=True, return_counts=True)
    out = np.zeros(n_groups)
    out[which] = values[order][first + n // 2]
    return out
