"""Whether cracks would show in a cell: the rule by which cells can be judged.

It asks what could be seen, not how many frames there are: how much of a detail as fine as cracks
comes from the frames, and how blurred the image is, both in widths of the cell.
"""

from __future__ import annotations

import math

__all__ = ["LEAST_DETAIL", "MOST_BLUR", "sight_known", "why_unseen", "would_show"]

LEAST_DETAIL = 0.6
"""Least `CellFeatures.crack_detail` of a cell that can be judged.

Chosen with `MOST_BLUR` on simulated modules of labelled cells (benchmarks/judged_cells.py):
beyond the bounds 4 of 10 cracked cells would be called clean, within them 1 of 20 is."""

MOST_BLUR = 0.0165
"""Largest `CellFeatures.edge_blur` of a cell that can be judged, cell widths."""


def sight_known(detail: float) -> bool:
    """Whether it is known how well a cell was seen; earlier versions did not measure it."""
    return not math.isnan(detail)


def would_show(detail: float, blur: float) -> bool:
    """Whether cracks would show in a cell.

    Parameters
    ----------
    detail : float
        Share of a detail as fine as cracks that comes from the frames.
    blur : float
        Blur of the image there, cell widths; NaN if it could not be measured, then nothing is
        known to show.
    """
    return detail >= LEAST_DETAIL and blur <= MOST_BLUR


def why_unseen(detail: float, blur: float) -> str:
    """Say why cracks would not show in a cell; empty if they would."""
    if would_show(detail, blur):
        return ""
    if detail >= LEAST_DETAIL and math.isnan(blur):
        return "no edge of a cell is clear enough to tell how sharp the image is"
    if detail >= LEAST_DETAIL:
        return "too blurred for cracks to show"
    if blur > MOST_BLUR:
        return "too coarse or too blurred for cracks to show"
    return "too coarse, too noisy or overexposed: cracks would not show"
