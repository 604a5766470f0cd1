"""How well a crack map agrees with labels: the figures by which detectors are compared."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = [
    "LEVELS",
    "CoarseScore",
    "PixelScore",
    "average_precision",
    "coarse_score",
    "pixel_score",
    "roc_auc",
]

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Levels at which crack maps are cut; close together at both ends.
LEVELS = 1 / (1 + np.exp(-np.linspace(-9, 9, 181)))


@dataclass(frozen=True, eq=False)
class PixelScore:
    """Agreement of pixels over all levels.

    Parameters
    ----------
    ap, f1, level : float
        Average precision, best F1, and the level of the probability where it is reached.
    precision, recall : (n_levels,) float64
        At `LEVELS`.
    """

    ap: float
    f1: float
    level: float
    precision: NDArray[np.float64]
    recall: NDArray[np.float64]


@dataclass(frozen=True)
class CoarseScore:
    """Agreement of coarse masks (paper, Sec. IV-D, Table I).

    Parameters
    ----------
    ap, f1, level : float
        Of the blocks: average precision, F1 at ``level``.
    precision, recall : float
        Of the blocks at ``level``; precision is 1 where none is called a crack.
    instance_precision, instance_recall, instance_f1 : float
        Of 8-connected groups of blocks at ``level``; found if at least one block overlaps.
    """

    ap: float
    f1: float
    level: float
    precision: float
    recall: float
    instance_precision: float
    instance_recall: float
    instance_f1: float


def pixel_score(pairs: Iterable[tuple[Image, Mask]], tolerance_px: int = 2) -> PixelScore:
    """Score crack maps pixel by pixel, with a tolerance for where exactly the line was drawn.

    A pixel called crack is right if a labelled one lies within the tolerance; a labelled pixel is
    found if one called crack does.

    Parameters
    ----------
    pairs : iterable of (probability, mask)
        (h, w) float32 and (h, w) bool; all pixels of all pairs count alike.
    tolerance_px : int

    Returns
    -------
    PixelScore
    """
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * tolerance_px + 1,) * 2)
    edges = np.append(LEVELS, 2.0)
    hit, marked, found = (np.zeros(LEVELS.size) for _ in range(3))
    cracks = 0

    def above(values: Image) -> NDArray[np.int64]:
        counts = np.histogram(values, edges)[0]
        return np.asarray(counts[::-1].cumsum()[::-1], np.int64)

    for probability, mask in pairs:
        near = cv2.dilate(mask.astype(np.uint8), disc) > 0
        hit += above(probability[near])
        marked += above(probability)
        found += above(np.asarray(cv2.dilate(probability, disc), np.float32)[mask])
        cracks += int(mask.sum())
    precision = np.where(marked > 0, hit / np.maximum(marked, 1), 1.0)
    recall = found / max(cracks, 1)
    f1 = 2 * precision * recall / np.maximum(precision + recall, 1e-9)
    steps = recall - np.append(recall[1:], 0.0)
    best = int(f1.argmax())
    return PixelScore(
        float((steps * precision).sum()), float(f1[best]), float(LEVELS[best]), precision, recall
    )


def average_precision(score: NDArray[np.floating], truth: Mask) -> float:
    """Average precision; equal scores are one level.

    Parameters
    ----------
    score : (n,) float
    truth : (n,) bool
    """
    order = np.argsort(-score, kind="stable")
    ranked, hits = score[order], np.cumsum(truth[order])
    last = np.append(np.flatnonzero(np.diff(ranked)), ranked.size - 1)
    precision, recall = hits[last] / (last + 1), hits[last] / max(int(truth.sum()), 1)
    return float((np.diff(recall, prepend=0.0) * precision).sum())


def roc_auc(score: NDArray[np.floating], truth: Mask) -> float:
    """Probability that a positive has the higher score than a negative; equal ones count half.

    Parameters
    ----------
    score : (n,) float
    truth : (n,) bool
    """
    positive, negative = score[truth][:, None], score[~truth][None]
    return float((positive > negative).mean() + 0.5 * (positive == negative).mean())


def coarse_score(
    pairs: Iterable[tuple[Image, Mask]], level: float | None = None, block_px: int = 16
) -> CoarseScore:
    """Score coarse masks as Table I of the paper does.

    A block of the label is crack if any pixel in it is; a block of the map has the highest
    probability in it.

    Parameters
    ----------
    pairs : iterable of (probability, mask)
    level : float, optional
        Level of the probability; the one with the best F1 if not given.
    block_px : int

    Returns
    -------
    CoarseScore
    """
    maps, masks = [], []
    for probability, mask in pairs:
        maps.append(_blocks(probability, block_px))
        masks.append(_blocks(mask, block_px) > 0)
    score = np.concatenate([p.ravel() for p in maps])
    truth = np.concatenate([m.ravel() for m in masks])
    levels = LEVELS if level is None else np.array([level])
    f1s = [
        2 * ((score >= t) & truth).sum() / max((score >= t).sum() + truth.sum(), 1) for t in levels
    ]
    best = int(np.argmax(f1s))
    cut = float(levels[best])
    counts = np.sum([_instances(p >= cut, m) for p, m in zip(maps, masks, strict=True)], axis=0)
    n_found, n_right, n_true, n_hit = (int(count) for count in counts)
    groups = n_right / n_found if n_found else 1.0, n_hit / max(n_true, 1)
    called = score >= cut
    right, n_called = int((called & truth).sum()), int(called.sum())
    return CoarseScore(
        average_precision(score, truth),
        float(f1s[best]),
        cut,
        right / n_called if n_called else 1.0,
        right / max(int(truth.sum()), 1),
        *groups,
        2 * groups[0] * groups[1] / max(sum(groups), 1e-9),
    )


def _blocks(values: NDArray[np.generic], n: int) -> Image:
    h, w = -(-values.shape[0] // n) * n, -(-values.shape[1] // n) * n
    whole = np.zeros((h, w), np.float32)
    whole[: values.shape[0], : values.shape[1]] = values
    return np.asarray(whole.reshape(h // n, n, w // n, n).max((1, 3)))


def _instances(found: Mask, truth: Mask) -> tuple[int, int, int, int]:
    """Found groups, right ones among them, true groups, found ones among them."""
    n_found, labels_found = cv2.connectedComponents(found.astype(np.uint8), connectivity=8)
    n_true, labels_true = cv2.connectedComponents(truth.astype(np.uint8), connectivity=8)
    both = found & truth
    right, hit = np.unique(labels_found[both]).size, np.unique(labels_true[both]).size
    return n_found - 1, right, n_true - 1, hit
