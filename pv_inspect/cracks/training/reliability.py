"""Whether a probability means what it says: reliability, and the calibration that mends it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Reliability", "fit_calibration", "reliability"]

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

_LIMIT = 12.0  # of log odds
_BINS = 480


@dataclass(frozen=True, eq=False)
class Reliability:
    """Pixels by what was said about them.

    Parameters
    ----------
    said : (n,) float64
        Mean probability of each bin.
    seen : (n,) float64
        Share of the pixels of the bin that are labelled.
    pixels : (n,) int64
    error : float
        Mean of |said - seen| over the bins, weighted with the labelled and marked pixels of each:
        weighted with all pixels, those without a crack would hide everything.
    """

    said: NDArray[np.float64]
    seen: NDArray[np.float64]
    pixels: NDArray[np.int64]
    error: float


def reliability(pairs: Iterable[tuple[Image, Mask]], n_bins: int = 10) -> Reliability:
    """Compare probabilities with labels.

    Parameters
    ----------
    pairs : iterable of (probability, mask)
        (h, w) float32 and (h, w) bool.
    n_bins : int
        Bins of equal width from 0 to 1.

    Returns
    -------
    Reliability
        Of the bins that have pixels.
    """
    total, sums, hits = (np.zeros(n_bins) for _ in range(3))
    for probability, mask in pairs:
        index = np.minimum((probability.ravel() * n_bins).astype(int), n_bins - 1)
        total += np.bincount(index, minlength=n_bins)
        sums += np.bincount(index, probability.ravel(), n_bins)
        hits += np.bincount(index, mask.ravel(), n_bins)
    filled = total > 0
    said, seen = sums[filled] / total[filled], hits[filled] / total[filled]
    weight = sums[filled] + hits[filled]
    error = float((weight * np.abs(said - seen)).sum() / max(weight.sum(), 1e-9))
    return Reliability(said, seen, total[filled].astype(np.int64), error)


def fit_calibration(pairs: Iterable[tuple[Image, Mask]]) -> tuple[float, float]:
    """Fit log odds = slope * (log odds said) + offset to labels (Platt scaling [1]_).

    Parameters
    ----------
    pairs : iterable of (probability, mask)

    Returns
    -------
    slope, offset : float
        Of the highest likelihood.

    References
    ----------
    .. [1] J. Platt, "Probabilistic Outputs for Support Vector Machines and Comparisons to
           Regularized Likelihood Methods", Advances in Large Margin Classifiers, 1999.
    """
    edges = np.linspace(-_LIMIT, _LIMIT, _BINS + 1)
    counts = np.zeros((2, _BINS))
    for probability, mask in pairs:
        q = np.clip(np.asarray(probability, np.float64), 1e-9, 1 - 1e-9)
        log_odds = np.clip(np.log(q / (1 - q)), -_LIMIT, _LIMIT)
        for k, chosen in enumerate((~mask, mask)):
            counts[k] += np.histogram(log_odds[chosen], edges)[0]
    x = np.stack([(edges[1:] + edges[:-1]) / 2, np.ones(_BINS)], axis=1)
    total, hits = counts.sum(0), counts[1]
    beta = np.array([1.0, 0.0])
    for _ in range(50):
        p = 1 / (1 + np.exp(-x @ beta))
        hessian = (x * (total * p * (1 - p))[:, None]).T @ x
        step = np.linalg.solve(hessian + 1e-9 * np.eye(2), x.T @ (total * p - hits))
        beta -= step * min(1.0, 2 / max(float(np.abs(step).max()), 1e-12))
        if np.abs(step).max() < 1e-7:
            break
    return float(beta[0]), float(beta[1])
