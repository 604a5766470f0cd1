"""Labelled cells through a detector: what the scores and the calibration look at."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pv_inspect.cracks.classes import CRACK
from pv_inspect.cracks.features import OperatingPoint, measure_cell
from pv_inspect.cracks.training.augmentation import Augmentation, prepared
from pv_inspect.cracks.training.labelled import LabelledCell
from pv_inspect.cracks.training.scores import pixel_score

if TYPE_CHECKING:
    from pv_inspect.cracks import CrackDetector

__all__ = ["alarms", "as_they_are", "degraded", "evidence", "operating_point"]

# Operating points that are tried: probability, and cell widths.
_THRESHOLDS = (0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5)
_EXTENTS = (0.02, 0.025, 0.03, 0.035, 0.04, 0.05, 0.06, 0.08, 0.1, 0.15)
# Evidence that is tried: crack score, and cell widths.
_SCORES = (0.0, 0.3, 0.4, 0.5, 0.6, 0.7)
_LENGTHS = (0.0, 0.02, 0.03, 0.04)

Pair = tuple[NDArray[np.float32], NDArray[np.bool_]]


def as_they_are(detector: CrackDetector, cells: Sequence[LabelledCell]) -> Iterator[Pair]:
    """Crack probability and crack mask of cells at the size of their images."""
    for cell in cells:
        image = np.asarray(np.divide(cell.image, 255), np.float32)
        yield detector.probability(image), cell.crack


def degraded(
    detector: CrackDetector, cells: Sequence[LabelledCell], seed: int = 0
) -> Iterator[Pair]:
    """Crack probability and crack mask of cells as `Augmentation` degrades them, 256 px."""
    rng = np.random.default_rng(seed)
    augment = Augmentation()
    for cell in cells:
        seen, label = augment(*prepared(cell.image, cell.label), rng)
        yield detector.probability(np.asarray((seen + 1) / 2, np.float32)), label == CRACK


def alarms(pairs: Sequence[Pair], point: OperatingPoint) -> tuple[float, float]:
    """Shares of the cells that get an alarm: of those with labelled cracks, and of the others."""
    suspected = np.array([_suspected(p, point) for p, _ in pairs])
    cracked = np.array([bool(mask.any()) for _, mask in pairs])
    return float(suspected[cracked].mean()), float(suspected[~cracked].mean())


def operating_point(pairs: Sequence[Pair], recall: float = 0.95) -> OperatingPoint:
    """Choose the operating point with the fewest alarms in clean cells.

    Parameters
    ----------
    pairs : sequence of (probability, mask)
        One per cell.
    recall : float
        Least share of the cells with cracks that must get an alarm.

    Returns
    -------
    OperatingPoint
        Of those with equally few alarms the one with the threshold next to the best F1 of pixels;
        if none has the recall, the one that comes nearest to it.
    """
    best = pixel_score(pairs).level
    points = [OperatingPoint(t, e) for t in _THRESHOLDS for e in _EXTENTS]

    def cost(point: OperatingPoint) -> tuple[float, float, float]:
        found, false = alarms(pairs, point)
        return max(recall - found, 0.0), round(false, 4), abs(point.threshold - best)

    return min(points, key=cost)


def evidence(
    pairs: Sequence[Pair], point: OperatingPoint, *, recall_lost: float = 0.035
) -> OperatingPoint:
    """Add the evidence that a class needs to an operating point.

    Parameters
    ----------
    pairs : sequence of (probability, mask)
        One per cell.
    point : OperatingPoint
    recall_lost : float
        Share of the cracked cells that may lose their class ("can't be judged") by it.

    Returns
    -------
    OperatingPoint
        Of the bounds with the fewest alarms in clean cells the lowest score, then the shortest
        length.
    """
    found = alarms(pairs, point)[0]
    tried = [
        replace(point, least_length_cells=length, least_score=score)
        for score in _SCORES
        for length in _LENGTHS
    ]
    rated = [(candidate, *alarms(pairs, candidate)) for candidate in tried]
    allowed = [(false, c) for c, recall, false in rated if recall >= found - recall_lost - 1e-9]
    return min(
        allowed, key=lambda one: (round(one[0], 4), one[1].least_score, one[1].least_length_cells)
    )[1]


def _suspected(probability: NDArray[np.float32], point: OperatingPoint) -> bool:
    cell = measure_cell(
        np.ones_like(probability),
        probability,
        point.threshold,
        row=0,
        col=0,
        cell_width_px=float(probability.shape[1]),
        usual_intensity=1.0,
        least_extent_cells=point.least_extent_cells,
        least_length_cells=point.least_length_cells,
        least_score=point.least_score,
    )
    return cell.crack_suspected
