"""By how much what two frames show of a module is shifted against each other, in cells."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.detection.seen_part import SAMPLES, Part

__all__ = ["ASIDE", "off_cells", "shift_between"]

Array = NDArray[np.float64]

# No search for these constants is on record: they were set by hand on seeds 0 to 3 and 20 to 27 of
# `python benchmarks/partial_views.py`.

LEAST_OVERLAP_CELLS = 3.0
LEAST_CORRELATION = 0.35
CLEARER = 0.2
"""By so much a shift must correlate better than any that differs by more than `APART` cells."""
BY_CHANCE = 0.5
"""Correlation of one cell with another by chance; of n cells it is less by the root of n."""
MOST_CONTRADICTED = 0.2
"""Cells that may be lit in one picture and dark in the other, their rims left out: where a module
ends, it ends in every frame."""
RIM = np.ones((3, 3), np.uint8)
APART = 0.5
ASIDE = 0.05
"""Cells by which pictures may fit best beside where they should: the grids are right to 0.01."""


def shift_between(one: Part, other: Part, whole_cells: bool = False) -> tuple[Array, float] | None:
    """Tell where the plane of another part lies on that of this one.

    Parameters
    ----------
    one, other : Part
    whole_cells : bool
        Whether it must lie whole cells beside it.

    Returns
    -------
    shift : (2,) float64
        Of its cell (0, 0), cells (x, y).
    clearness : float
        By how much this one correlates better than any other shift. None if too little is seen by
        both, or not at one place only.
    """
    scores = _scores(one, other)
    if scores is None:
        return None
    score, shape = scores, scores.shape
    rows, cols = (np.arange(size) for size in shape)
    possible = np.where(_contradicted(one, other, shape), -1.0, score)
    allowed = possible
    if whole_cells:
        aside = [
            _aside(v, size, n)
            for v, size, n in zip((rows, cols), shape, one.details.shape, strict=True)
        ]
        allowed = np.where((aside[0] > 0)[:, None] | (aside[1] > 0)[None], -1.0, possible)
    row, col = (int(v) for v in np.unravel_index(int(allowed.argmax()), score.shape))
    best = float(allowed[row, col])
    # Shifts wrap around: the other part may begin before this one.
    dy, dx = (
        np.minimum(np.abs(v - at), s - np.abs(v - at))
        for v, at, s in ((rows, row, shape[0]), (cols, col, shape[1]))
    )
    away = np.maximum(dy[:, None], dx[None]) > APART * SAMPLES
    second = float(allowed[away].max(initial=-1.0))
    if best < LEAST_CORRELATION or best - second < CLEARER:
        return None
    peak = _peak(score, row, col)
    if whole_cells and np.abs(peak).max() > ASIDE * SAMPLES:
        return None
    moved = [
        float(at if at < part else at - size)
        for at, part, size in (
            (col, one.details.shape[1], shape[1]),
            (row, one.details.shape[0], shape[0]),
        )
    ]
    cells = (np.array(moved) + (0.0 if whole_cells else peak)) / SAMPLES
    return one.first + cells - other.first, best - second


def _peak(score: Array, row: int, col: int) -> Array:
    """Where the score is largest around a place, (x, y) samples from there, to parts of them."""
    reach = int(APART * SAMPLES)
    at = np.arange(-reach, reach + 1)
    around = np.take(np.take(score, row + at, 0, mode="wrap"), col + at, 1, mode="wrap")
    y, x = np.unravel_index(int(around[1:-1, 1:-1].argmax()), (2 * reach - 1,) * 2)
    y, x = y + 1, x + 1
    peak = []
    for line, k in ((around[y], x), (around[:, x], y)):
        before, here, after = line[k - 1 : k + 2]
        bend = before - 2 * here + after
        peak.append(k - reach + (0.5 * (before - after) / bend if bend < 0 else 0.0))
    return np.array(peak)


def _aside(shifts: NDArray[np.int64], size: int, part: int) -> NDArray[np.int64]:
    """How far shifts, which wrap around, are from whole cells, samples."""
    beside = np.where(shifts < part, shifts, shifts - size) % SAMPLES
    return np.asarray(np.minimum(beside, SAMPLES - beside), np.int64)


def off_cells(one: Part, other: Part) -> float | None:
    """Cells by which two pictures in the same plane agree best beside each other; None if unseen.

    Parameters
    ----------
    one, other : Part
    """
    score = _scores(one, other)
    if score is None:
        return None
    col, row = (other.first - one.first) * SAMPLES
    if not score[row % score.shape[0], col % score.shape[1]] > -1.0:
        return None
    return float(np.abs(_peak(score, int(row), int(col))).max()) / SAMPLES


def _contradicted(one: Part, other: Part, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Whether one picture is lit where the other is dark, for all shifts, which wrap around."""

    def spectra(part: Part) -> list[Array]:
        masks = (cv2.erode(mask.astype(np.uint8), RIM) for mask in (part.bright, part.dark))
        return [np.asarray(np.fft.rfft2(mask, shape)) for mask in masks]

    (lit, dark), (other_lit, other_dark) = spectra(one), spectra(other)
    both = np.fft.irfft2(lit * np.conj(other_dark) + dark * np.conj(other_lit), shape)
    return np.asarray(both > MOST_CONTRADICTED * SAMPLES**2)


def _scores(one: Part, other: Part) -> Array | None:
    """Correlation at all shifts in samples, which wrap around, less what is chance.

    At most -1 where too little is seen by both; None if it is so everywhere.
    """
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
    # Few cells look alike by chance.
    score -= BY_CHANCE * SAMPLES / np.sqrt(n)
    return np.asarray(score, np.float64)
