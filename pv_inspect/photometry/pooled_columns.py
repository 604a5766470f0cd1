"""The column pattern of a camera out of many sequences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pv_inspect.photometry.fixed_pattern import (
    ColumnPattern,
    column_lines,
    columns_of_halves,
    mean_light,
)

__all__ = ["column_outliers", "pooled_columns"]

# A sequence shows so much of the others' pattern at least, unless that lies within so many standard
# errors.
_SHARE, _SIGNIFICANCE = 0.5, 4.0
_LEAST_FOR_OUTLIERS = 4


def pooled_columns(each: Sequence[NDArray[np.floating]]) -> ColumnPattern | None:
    """Estimate the pattern that all sequences of a camera have in common.

    Parameters
    ----------
    each : sequence of (2, 5, width) float32
        `Photometry.column_sums` of every sequence.

    Returns
    -------
    ColumnPattern or None
        None if the halves do not agree on a pattern.

    Notes
    -----
    The halves are every other sequence: what one module or flight brings with it is in one of them
    only. A single sequence has the halves of its frames.
    """
    if not each:
        return None
    if len(each) == 1:
        halves = np.asarray(each[0], np.float64)
    else:
        whole = np.array([sums.sum(axis=0, dtype=np.float64) for sums in each])
        halves = np.stack([whole[::2].sum(axis=0), whole[1::2].sum(axis=0)])
    found = columns_of_halves(halves)
    return found if found.level.any() or found.gain.any() else None


def column_outliers(each: Sequence[NDArray[np.floating]]) -> tuple[int, ...]:
    """Return which sequences do not show the pattern that the others have in common.

    Parameters
    ----------
    each : sequence of (2, 5, width) float32

    Notes
    -----
    The pattern of a sequence is what the others have, times a factor, and noise: the factor of one
    that was taken with another camera is about 0.
    """
    if len(each) < _LEAST_FOR_OUTLIERS:
        return ()
    out = []
    for k, sums in enumerate(each):
        others = pooled_columns([other for i, other in enumerate(each) if i != k])
        if others is None:
            continue
        whole = sums.sum(axis=0, dtype=np.float64)
        light = mean_light(whole)
        level, _ = column_lines(whole, light)
        pattern = others.level + others.gain * (light - others.light)
        strength = float(level.precision @ pattern**2)
        if strength == 0.0:
            continue
        factor = float(level.precision @ (level.value * pattern)) / strength
        left = level.value - factor * pattern
        known = level.precision > 0
        excess = float(level.precision @ left**2) / max(int(known.sum()), 1)
        if factor + _SIGNIFICANCE * np.sqrt(max(excess, 1.0) / strength) < _SHARE:
            out.append(k)
    return tuple(out)
