"""Width of the gaps between cells, from profiles across them."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from pv_inspect.detection.gap_model import STEP_PX, GapShape, fit_steps, gap_basis

__all__ = ["SIDES_APART_PX", "UNSURE_WIDTH", "gap_width", "width_between_sides"]

Array = NDArray[np.float64]

MAX_GAP_PX = 5.0
REACH_PX = 4.5
WIDTHS: Array = np.arange(0.5, MAX_GAP_PX + 0.05, 0.1)
BLURS: Array = np.arange(0.3, 1.75, 0.1)
RESOLVED_PX = (1.3, 1.7)
"""From here to there the shape of a gap is trusted more and more, by the width of a wholly dark gap
that would take as much light. Of simulated modules of 2 x 2 to 4 x 6 cells, 60 to 160 px per cell,
the width by shape is off by 0.1 px (RMS) from 1.6 on and by up to 0.3 px below 1.5; the other one
is too small by a fifth, for gaps are lit by the cells beside them."""
MOST_LIT = 1.8
"""A gap is wider than a wholly dark one at most by this factor."""
SIDES_APART_PX = 4.0
"""The sides of a wider gap are seen one by one: they are blurred over 2 to 3 px."""
UNSURE_WIDTH = 0.2
"""By such a share a wide gap may be wider or narrower than was said."""


def gap_width(profiles: Array, x: Array, place: Array, shape: GapShape) -> float:
    """Typical width of gaps.

    Parameters
    ----------
    profiles : (n, m) float64
        Brightness across each gap.
    x : (m,) float64
        Where, image pixels.
    place : (n,) float64
        Middle of each gap.
    shape : GapShape
        What the gaps look like, roughly.

    Returns
    -------
    float
        Image pixels, 0 to `MAX_GAP_PX`.

    Notes
    -----
    Blur does not change how much light a gap takes. For narrow gaps this is the width if they are
    wholly dark; wide ones are resolved, so that their shape says how dark they are.
    """
    dark = _width_if_dark(profiles, x, place, shape)
    unresolved, resolved = RESOLVED_PX
    trust = float(np.clip((dark - unresolved) / (resolved - unresolved), 0, 1))
    if not trust:
        return dark
    return (1 - trust) * dark + trust * _width_by_shape(profiles, x, place, dark)


def width_between_sides(profiles: Array, x: Array, search: float, expected: float) -> float:
    """Typical width of wide gaps, from one side to the other.

    A width that is wrong would draw the middle of a gap to one of its sides.

    Parameters
    ----------
    profiles : (n, m) float64
        Brightness across each gap.
    x : (m,) float64
        Where, image pixels, symmetric about 0.
    search : float
        How far a gap may lie off, image pixels.
    expected : float
        Image pixels.

    Returns
    -------
    float
        What was expected if the sides are not seen at most gaps.
    """
    reach = min(search + UNSURE_WIDTH * expected / 2, 0.45 * expected)
    right, _, right_found = fit_steps(profiles, x - expected / 2, reach)
    left, _, left_found = fit_steps(profiles[:, ::-1], x - expected / 2, reach)
    both = right_found & left_found
    if 2 * both.sum() <= len(profiles):
        return expected
    width = float(np.median((right + left)[both])) + expected
    unsure = UNSURE_WIDTH * expected
    return float(np.clip(width, expected - unsure, expected + unsure))


def _width_if_dark(profiles: Array, x: Array, place: Array, shape: GapShape) -> float:
    t = x - place[:, None]
    half = max(2.2, shape.width / 2 + 2 * shape.blur)
    beside = (np.abs(t) > half) & (np.abs(t) <= half + 1.3)
    left, right = (
        np.where(side, profiles, 0).sum(axis=1) / np.maximum(side.sum(axis=1), 1)
        for side in (beside & (t < 0), beside & (t > 0))
    )
    good = (left > 0) & (right > 0)
    if not good.any():
        return 0.0
    level = np.where(t < 0, left[:, None], right[:, None])[good]
    missing = np.where(np.abs(t[good]) <= half, 1 - profiles[good] / level, 0).sum(axis=1)
    return float(np.clip(np.median(missing) * STEP_PX, 0, MAX_GAP_PX))


def _width_by_shape(profiles: Array, x: Array, place: Array, dark: float) -> float:
    """Width of the blurred gap between two levels that fits the typical profile best."""
    t, misfits = _misfits()
    centred = np.array([np.interp(t, x - p, one) for p, one in zip(place, profiles, strict=True)])
    level = np.median(centred[:, np.abs(t) > min(dark / 2 + 1.5, REACH_PX - 1)], axis=1)
    bright = level > 0
    if not bright.any():
        return dark
    typical = np.median(centred[bright] / level[bright, None], axis=0)
    which = np.flatnonzero((0.95 * dark <= WIDTHS) & (MOST_LIT * dark >= WIDTHS))
    if not which.size:
        return dark
    squares = np.einsum("i,wbij,j->wb", typical, misfits[which], typical).min(axis=1)
    k = int(squares.argmin())
    width = float(WIDTHS[which[k]])
    if 0 < k < len(squares) - 1:
        before, here, after = squares[k - 1 : k + 2]
        width += 0.05 * float((before - after) / max(before - 2 * here + after, 1e-15))
    return width


@cache
def _misfits() -> tuple[Array, Array]:
    """Distances from the middle of a gap, and what a fit leaves of a profile there.

    The mean square of what is left of profile p with width w and blur b is p' M[w, b] p.
    """
    t: Array = np.arange(-REACH_PX, REACH_PX + STEP_PX / 2, STEP_PX)
    misfits = np.zeros((len(WIDTHS), len(BLURS), len(t), len(t)))
    for i, width in enumerate(WIDTHS):
        for j, blur in enumerate(BLURS):
            basis, _ = gap_basis(t, GapShape(float(blur), float(width), REACH_PX))
            # Further away the cells are uneven.
            near = np.abs(t) < width / 2 + 2.2 * blur + 0.3
            rows = basis[near]
            left = np.eye(len(rows)) - rows @ np.linalg.pinv(rows)
            misfits[i, j][np.ix_(near, near)] = left / len(rows)
    return t, misfits
