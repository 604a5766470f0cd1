"""Fit and judge the read-out of the classical crack detector on labelled cells.

    python benchmarks/fit_ridge.py CELLS           judge the weights of the package on CELLS/val
    python benchmarks/fit_ridge.py CELLS --fit     fit on CELLS/train, write the weights, judge them

CELLS holds train/ and val/, each with img/ and ann/ (class 3 = crack). Every second training
cell is seen as a super-resolved tile would show it: coarser, blurred, with some noise.

The figures on val are optimistic: the features, the length of full probability and the level were
chosen with val in view, and cells of one module may lie in both parts.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.cracks import ridge
from pv_inspect.cracks.flatten import flatten
from pv_inspect.cracks.ridge import N_FEATURES, RidgeDetector, RidgeWeights, ridge_features

WEIGHTS = Path(ridge.__file__).with_name("ridge_weights.json")
CRACK = 3
NEGATIVES_PER_CELL = 400
TOLERANCE_PX = 2
LEVELS = np.linspace(0.02, 0.98, 49)
Image = NDArray[np.float32]


def cells(folder: Path) -> Iterator[tuple[Image, NDArray[np.bool_]]]:
    """Image and crack mask of every labelled cell."""
    for path in sorted((folder / "img").iterdir()):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        label = cv2.imread(str(folder / "ann" / f"{path.stem}.png"), cv2.IMREAD_UNCHANGED)
        yield np.asarray(image, np.float32) / 255, label == CRACK


def as_tile(image: Image, rng: np.random.Generator) -> Image:
    """The cell as a super-resolved tile shows it."""
    n, m = int(rng.uniform(70, 200)), int(rng.uniform(150, 280))
    coarse = cv2.resize(image, (n, n), interpolation=cv2.INTER_AREA)
    coarse = cv2.GaussianBlur(coarse, (0, 0), rng.uniform(0.3, 0.8))
    coarse += rng.normal(0, rng.uniform(0, 0.01) * image.mean(), coarse.shape).astype(np.float32)
    return np.asarray(cv2.resize(coarse, (m, m), interpolation=cv2.INTER_CUBIC))


def tiles_of(seed: int) -> Callable[[Image], Image]:
    """Return `as_tile` with its own random numbers."""
    rng = np.random.default_rng(seed)
    return lambda image: as_tile(image, rng)


def samples(folder: Path, rng: np.random.Generator) -> tuple[Image, Image, Image]:
    """Features, labels and weights of pixels."""
    features, labels, weights = [], [], []
    for number, (image, mask) in enumerate(cells(folder)):
        turns = int(rng.integers(4))
        image, mask = np.rot90(image, turns).copy(), np.rot90(mask, turns)
        cell = flatten(as_tile(image, rng) if number % 2 else image)
        x = ridge_features(cell).reshape(-1, N_FEATURES)
        size = cell.contrast.shape[::-1]
        share = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        near = cv2.dilate((share > 0).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        judged = ~(cell.outside | cell.lines)
        positive = np.flatnonzero((share > 0.5) & judged)
        negative = np.flatnonzero(~near & judged)
        drawn = rng.choice(negative, min(NEGATIVES_PER_CELL, negative.size), replace=False)
        features += [x[positive], x[drawn]]
        labels += [np.ones(positive.size), np.zeros(drawn.size)]
        weights += [np.ones(positive.size), np.full(drawn.size, negative.size / max(drawn.size, 1))]
    return tuple(np.concatenate(part).astype(np.float32) for part in (features, labels, weights))


def fit(x: Image, y: Image, weight: Image, ridge_penalty: float = 1.0) -> RidgeWeights:
    """Weighted logistic regression on all products of two features, by Newton's method."""
    zeros = np.zeros((N_FEATURES, N_FEATURES), np.float32)
    start = RidgeWeights(x.mean(0), x.std(0), zeros[0], zeros, 0.0)
    z = start.normalised(x)
    i, j = np.triu_indices(N_FEATURES)
    design = np.concatenate([np.ones((len(z), 1), np.float32), z, z[:, i] * z[:, j]], axis=1)
    beta = np.zeros(design.shape[1])
    for _ in range(25):
        p = 1 / (1 + np.exp(-np.clip(design @ beta, -30, 30)))
        gradient = design.T @ (weight * (p - y)) + ridge_penalty * beta
        hessian = (design * (weight * p * (1 - p))[:, None]).T @ design
        step = np.linalg.solve(hessian + ridge_penalty * np.eye(beta.size), gradient)
        beta -= step * min(1, 3 / np.abs(step).max())
        if np.abs(step).max() < 1e-4:
            break
    quadratic = np.zeros((N_FEATURES, N_FEATURES))
    quadratic[i, j] = beta[1 + N_FEATURES :]
    return replace(
        start,
        linear=beta[1 : 1 + N_FEATURES].astype(np.float32),
        quadratic=quadratic.astype(np.float32),
        bias=float(beta[0]),
    )


def judge(
    folder: Path, detector: RidgeDetector, seen: Callable[[Image], Image]
) -> tuple[float, float, float, float]:
    """AP, best F1, its level and AUC of the cells' score; hits within 2 px count."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * TOLERANCE_PX + 1,) * 2)
    edges = np.append(LEVELS, 2.0)

    def above(values: Image) -> NDArray[np.int64]:
        return np.histogram(values, edges)[0][::-1].cumsum()[::-1]

    hit, marked, found, cracks = (np.zeros(LEVELS.size) for _ in range(4))
    scores, cracked = [], []
    for image, mask in cells(folder):
        p = cv2.resize(detector.probability(seen(image)), image.shape[::-1])
        hit += above(p[cv2.dilate(mask.astype(np.uint8), disc) > 0])
        marked += above(p)
        found += above(cv2.dilate(p, disc)[mask])
        cracks += mask.sum()
        scores.append(np.sort(p, axis=None)[-160:].mean())
        cracked.append(mask.sum() > 40)
    precision, recall = hit / np.maximum(marked, 1), found / cracks
    f1 = 2 * precision * recall / np.maximum(precision + recall, 1e-9)
    envelope = np.maximum.accumulate(precision)
    ap = np.trapezoid(envelope[::-1], recall[::-1]) + envelope[-1] * recall[-1]
    score, is_cracked = np.array(scores), np.array(cracked)
    auc = (score[is_cracked][:, None] > score[~is_cracked][None]).mean()
    best = int(f1.argmax())
    return float(ap), float(f1[best]), float(LEVELS[best]), float(auc)


def main() -> None:
    """Fit if asked to, then judge."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cells", type=Path)
    parser.add_argument("--fit", action="store_true")
    options = parser.parse_args()
    val = options.cells / "val"
    if options.fit:
        weights = fit(*samples(options.cells / "train", np.random.default_rng(0)))
        # 0.5 shall be the level of the best F1 on tiles; marks are shortened at a level as well,
        # hence twice.
        for seed in (1, 2):
            level = judge(val, RidgeDetector(weights), tiles_of(seed))[2]
            weights = replace(weights, bias=weights.bias + float(np.log((1 - level) / level)))
        stored = {
            name: np.round(np.asarray(getattr(weights, name), np.float64), 5).tolist()
            for name in ("mean", "scale", "linear", "quadratic", "bias")
        }
        WEIGHTS.write_text(json.dumps(stored) + "\n", encoding="utf-8")
        RidgeWeights.load.cache_clear()
    detector = RidgeDetector()
    ways: dict[str, Callable[[Image], Image]] = {
        "as photographed": lambda image: image,
        "as a tile": tiles_of(3),
    }
    print(f"{'cells':<16} {'AP':>6} {'F1':>6} {'level':>6} {'AUC of score':>13} {'ms / cell':>10}")
    for name, seen in ways.items():
        begun = perf_counter()
        ap, f1, level, auc = judge(val, detector, seen)
        ms = 1000 * (perf_counter() - begun) / len(list((val / "img").iterdir()))
        print(f"{name:<16} {ap:6.3f} {f1:6.3f} {level:6.2f} {auc:13.3f} {ms:10.0f}")


if __name__ == "__main__":
    main()
