"""Figures that several views tell of one result: one definition and one wording each.

*Residual* is what remains between a frame and the finished module image seen through the camera,
in units of the frame's noise: about 1 or less where they agree (``residual`` in ``result.json``).
The *registration residual* (``rms`` there) is what remains against the mean of the other frames,
before there is an image: it contains what the mean is too coarse to show, and is the larger one.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

__all__ = [
    "REGISTRATION_RESIDUAL",
    "RESIDUAL",
    "RESIDUAL_MEANING",
    "known_median",
    "median_text",
]

RESIDUAL = "residual"
REGISTRATION_RESIDUAL = "registration residual"
RESIDUAL_MEANING = "frames against the module image, median, in units of their noise; 1 is ideal"


def known_median(values: Iterable[float]) -> float:
    """Median over the frames of which a value is known; NaN if there is none.

    Parameters
    ----------
    values : iterable of float
        One per frame, NaN for those that are not used.

    Returns
    -------
    float
    """
    known = np.array([value for value in values if np.isfinite(value)], np.float64)
    return float(np.median(known)) if known.size else float("nan")


def median_text(values: Iterable[float]) -> str:
    """Median as it is told everywhere: two decimals, or ``not known``."""
    value = known_median(values)
    return f"{value:.2f}" if np.isfinite(value) else "not known"
