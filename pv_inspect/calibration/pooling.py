"""One value out of several with their uncertainties, and which of them do not go with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Pooled", "pooled"]

Array = NDArray[np.float64]

OUTLIER = 4.0
"""Standard deviations, of the value itself and of the scatter of all, beyond which one is left out.
By chance one of 16,000 lies there."""
DRIFT = 3.0
"""Standard deviations by which a trend over the values must differ from none."""
LEAST_FOR_OUTLIERS, LEAST_FOR_DRIFT = 4, 5


@dataclass(frozen=True)
class Pooled:
    """Weighted mean of some values.

    Parameters
    ----------
    value, error : float
        The error has the scatter of the values in it where it is larger than they claim.
    outliers : tuple of int
        Which of the values were left out.
    drift : float
        Change from the first value to the last one, in their order; 0 if it is not significant.
    count : int
        Values that it is made of.
    """

    value: float
    error: float
    outliers: tuple[int, ...]
    drift: float
    count: int


def pooled(values: Array, errors: Array, shared: float = 0.0) -> Pooled:
    """Pool values, weighted with 1 / error^2.

    Parameters
    ----------
    values, errors : (n,) float64
        At least one; the errors are above 0.
    shared : float
        Error that all values have in common and that their scatter does not show.

    Notes
    -----
    Where the values scatter by more than they claim, all errors are widened by the same factor
    (Birge ratio). An outlier is told from the median and from the median deviation of the others,
    so that it does not hide itself.
    """
    n = len(values)
    used = np.ones(n, bool)
    if n >= LEAST_FOR_OUTLIERS:
        middle = float(np.median(values))
        scatter = 1.4826 * float(np.median(np.abs(values - middle)))
        used = np.abs(values - middle) <= OUTLIER * np.hypot(errors, scatter)
    x, s = values[used], errors[used]
    weights = 1.0 / s**2
    mean = float((weights * x).sum() / weights.sum())
    freedom = len(x) - 1
    birge = np.sqrt((weights * (x - mean) ** 2).sum() / freedom) if freedom else 1.0
    error = float(max(birge, 1.0) / np.sqrt(weights.sum()))
    left_out = tuple(int(k) for k in np.flatnonzero(~used))
    drift = _drift(np.flatnonzero(used) / max(n - 1, 1), x, weights)
    return Pooled(mean, float(np.hypot(error, shared)), left_out, drift, len(x))


def _drift(at: Array, x: Array, weights: Array) -> float:
    """Change over the whole order, by a weighted straight line; 0 if it is not significant."""
    if len(x) < LEAST_FOR_DRIFT:
        return 0.0
    design = np.column_stack([np.ones_like(at), at])
    covariance = np.linalg.inv(design.T @ (weights[:, None] * design))
    line = covariance @ design.T @ (weights * x)
    rest = float((weights * (x - design @ line) ** 2).sum() / (len(x) - 2))
    slope, error = float(line[1]), float(np.sqrt(covariance[1, 1] * max(rest, 1.0)))
    return slope if abs(slope) > DRIFT * error else 0.0
