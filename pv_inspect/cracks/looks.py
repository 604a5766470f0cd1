"""How far the look of a cell is from the cells that a detector has learnt from.

A network answers any image, one of another kind with confidence as well. The look of a cell is a
few statistics that its metallisation, noise and texture determine; their Mahalanobis distance [1]_
from those of the cells that the network has learnt from says whether its answer can be relied on.

References
----------
.. [1] D. Hendrycks, K. Gimpel, "A Baseline for Detecting Misclassified and Out-of-Distribution
       Examples in Neural Networks", ICLR 2017; the distance: K. Lee et al., "A Simple Unified
       Framework for Detecting Out-of-Distribution Samples and Adversarial Attacks", NeurIPS 2018.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["STATISTICS", "KnownLooks", "look_of"]

Image = NDArray[np.float32]
Vector = NDArray[np.float64]

# Of a look.
STATISTICS = 23
_SIDE = 256
# Without the border of the cell, which shows the gap.
_BORDER = 0.06
# Edges of the bands of the spectrum: periods in pixels of `_SIDE`.
_PERIODS = (2.0, 2.5, 3.0, 4.0, 5.0, 6.5, 8.0, 11.0, 16.0, 32.0)
# Periods among which the fingers of a cell may be: 0.8 to 4 mm of 156.
_FINGERS = (2.0, 7.0)
# Power under which a band is empty: cells that are blurred more than others are not another look.
_LEAST_POWER = 1e-4
# Of the variance of each statistic that is added to all: statistics that hang together.
_SHRINKAGE = 0.02


def look_of(tile: Image) -> Vector:
    """Measure the statistics of a cell's look.

    Parameters
    ----------
    tile : (h, w) float32
        Any size and brightness scale.

    Returns
    -------
    (23,) float64
        Log power in nine bands along either axis, the axis with more power first; how far the
        most periodic line pattern stands out along either axis; brightness (5th percentile and
        median over the 95th, share under a third of it). The same for a turned or flipped cell.
    """
    h, w = tile.shape
    scale = _SIDE / max(h, w)
    size = (max(round(w * scale), 32), max(round(h * scale), 32))
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    image = np.asarray(cv2.resize(tile, size, interpolation=way), np.float32)
    image = np.clip(image / max(float(np.percentile(image, 95)), 1e-6), 0, 1.5)
    edge_y, edge_x = (max(round(_BORDER * n), 1) for n in image.shape)
    inside = image[edge_y:-edge_y, edge_x:-edge_x]
    along = [_along(np.ascontiguousarray(part)) for part in (inside, inside.T)]
    along.sort(key=lambda part: -float(part[:-1].sum()))
    low, middle = np.percentile(inside, [5, 50])
    dark = float((inside < 1 / 3).mean())
    return np.array([*along[0], *along[1], low, middle, dark], np.float64)


def _along(image: Image) -> Vector:
    """Log power of the lines of an image in bands, and how far a periodic pattern stands out."""
    fine = image - cv2.GaussianBlur(image, (0, 0), 8.0)
    window = np.hanning(fine.shape[1]).astype(np.float32)
    norm = float((window**2).sum())
    power = (np.abs(np.fft.rfft(fine * window, axis=1)) ** 2).mean(0) / norm
    frequency = np.fft.rfftfreq(fine.shape[1])
    bands = []
    for short, long in pairwise(_PERIODS):
        chosen = (frequency >= 1 / long) & (frequency <= 1 / short)
        mean = float(power[chosen].mean()) if chosen.any() else 0.0
        bands.append(np.log10(_LEAST_POWER + mean))
    profile = np.abs(np.fft.rfft(fine.mean(0) * window)) ** 2 / norm
    chosen = (frequency >= 1 / _FINGERS[1]) & (frequency <= 1 / _FINGERS[0])
    part = profile[chosen] if chosen.any() else np.zeros(1)
    peak = np.log10((part.max() + 1e-2 * _LEAST_POWER) / (np.median(part) + 1e-2 * _LEAST_POWER))
    return np.array([*bands, peak], np.float64)


@dataclass(frozen=True, eq=False)
class KnownLooks:
    """The looks of the cells that a detector has learnt from.

    Parameters
    ----------
    mean : (n,) float64
        Of the statistics, `look_of`.
    whitening : (n, n) float64
        Makes their covariance the identity.
    limit : float
        Distance from which on a look is another one.
    """

    mean: Vector
    whitening: Vector
    limit: float

    def __post_init__(self) -> None:
        n = self.mean.size
        if self.mean.shape != (n,) or self.whitening.shape != (n, n) or n != STATISTICS:
            raise ValueError(
                f"known looks have {n} means and a whitening of {self.whitening.shape}, expected "
                f"are {STATISTICS} and its square"
            )

    @classmethod
    def of(cls, looks: Vector, held_out: Vector, *, quantile: float, margin: float) -> KnownLooks:
        """Fit to the looks of cells.

        Parameters
        ----------
        looks : (m, n) float64
            Of cells that the detector has learnt from.
        held_out : (k, n) float64
            Of other cells of the same kinds: they set the limit.
        quantile, margin : float
            The limit is this quantile of the distances of ``held_out`` times the margin.
        """
        mean = looks.mean(0)
        covariance = np.cov(looks.T)
        covariance += _SHRINKAGE * np.diag(np.diag(covariance)) + 1e-6 * np.eye(len(mean))
        whitening = np.linalg.inv(np.linalg.cholesky(covariance))
        free = cls(mean, whitening, 1.0)
        distances = [free.novelty_of(look) for look in held_out]
        return cls(mean, whitening, margin * float(np.quantile(distances, quantile)))

    def novelty_of(self, look: Vector) -> float:
        """Distance of a look from the known ones, in units of the limit."""
        return float(np.linalg.norm(self.whitening @ (look - self.mean))) / self.limit

    def novelty(self, tile: Image) -> float:
        """Distance of the look of a cell from the known ones; from 1 on it is another one.

        Parameters
        ----------
        tile : (h, w) float32
        """
        return self.novelty_of(look_of(tile))
