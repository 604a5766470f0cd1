"""How well pieces of one crack are joined: length, and links where there is no crack.

    python benchmarks/crack_links.py CELLS [--part train] [--seed N] [--count N]

Cracks are drawn over clean labelled and simulated cells: half of them are faint in the middle, half
are two cracks on one line with a clean gap. All are blurred, sampled with 58 to 256 px and noisy.
The constants were chosen with ``--part train --seed 1``; ``--part val --seed 2`` is the part that
was kept. A pair of ends belongs together if 0.75 of the way between them lies on a drawn crack, and
does not if less than 0.6 does.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
from crack_blocks import photographed, simulated
from numpy.typing import NDArray

from pv_inspect.cracks import NetworkDetector
from pv_inspect.cracks.centreline import skeleton_length
from pv_inspect.cracks.classes import CLASSES, CRACK
from pv_inspect.cracks.features import crack_marks
from pv_inspect.cracks.links import Link, linked, possible_links
from pv_inspect.cracks.network import CELL_PX
from pv_inspect.cracks.training.augmentation import prepared
from pv_inspect.cracks.training.labelled import LabelledCell, read_labelled

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]


def cracked(image: Image, rng: np.random.Generator) -> tuple[Image, Mask, float]:
    """Draw a crack with a faint part, or two on one line; the mask of it and its length, cells."""
    two = rng.random() < 0.5
    angle, length = rng.uniform(0, np.pi), rng.uniform(0.5, 0.95)
    n = 101
    heading = angle + np.cumsum(rng.normal(0, rng.uniform(0, 0.03), n))
    steps = length / (n - 1) * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    points = np.cumsum(steps, axis=0)
    points += 0.5 + rng.uniform(-0.1, 0.1, 2) - points.mean(0)
    gap, start = rng.uniform(0.05, 0.6), rng.uniform(0.15, 0.35)
    faint = np.arange(n - 1) / (n - 1)
    faint = (faint > start) & (faint < min(start + gap, 0.85))
    contrast, rest = rng.uniform(0.25, 0.8), 0.0 if two else rng.uniform(0.08, 0.5)
    width = rng.uniform(1.0, 3.0)
    drawn, mask = np.zeros(image.shape, np.float32), np.zeros(image.shape, np.uint8)
    at = np.rint(points * CELL_PX * 16).astype(np.int32)
    for k in range(n - 1):
        depth = contrast * (rest if faint[k] else 1)
        if depth:
            a, b = tuple(map(int, at[k])), tuple(map(int, at[k + 1]))
            part = cv2.line(np.zeros_like(mask), a, b, 255, 1, cv2.LINE_AA, 4)
            drawn = np.maximum(drawn, depth * part.astype(np.float32) / 255)
            cv2.line(mask, a, b, 1, 1, cv2.LINE_8, 4)
    soft = cv2.GaussianBlur(drawn, (0, 0), width / 2.355) * 1.064 * width
    inside = ((points[1:] > 0) & (points[1:] < 1)).all(1) & (~faint if two else True)
    return image * (1 - np.clip(soft, 0, 0.95)), mask > 0, float(inside.sum() * length / (n - 1))


def right(link: Link, mask: Mask) -> float:
    """Share of the way of a link that lies on a crack."""
    reach = max(round(0.012 * mask.shape[1]), 1)
    wide = cv2.dilate(mask.astype(np.uint8), np.ones((2 * reach + 1,) * 2, np.uint8))
    y, x = np.clip(np.rint(link.path).astype(int), 0, np.array(mask.shape) - 1).T
    return float(wide[y, x].mean())


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("cells", type=Path)
    parser.add_argument("--part", choices=("train", "val"), default="val")
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--count", type=int, default=300)
    options = parser.parse_args()
    cells: list[LabelledCell] = read_labelled(options.cells / options.part)
    dark = CLASSES.index("dark")
    clean = [c for c in cells if not np.isin(c.label, (dark, CRACK)).any()]
    rng, detector = np.random.default_rng(options.seed), NetworkDetector()
    point = detector.operating_point
    rows, errors = [], []
    for _ in range(options.count):
        cell = clean[rng.integers(len(clean))]
        image, _ = prepared(cell.image, cell.label)
        grey = np.asarray(image, np.float32) / np.float32(255)
        grey = simulated(rng, int(rng.integers(2, 7))) if rng.random() < 0.4 else grey
        drawn, mask, length = cracked(grey, rng)
        tile, seen = photographed(np.asarray(drawn, np.float32), mask, rng)
        if tile.shape[0] != tile.shape[1]:
            continue
        width = float(tile.shape[1])
        said = detector.probability(tile)
        rows += [
            (link.gap, link.supported, right(link, seen))
            for link in possible_links(said, tile, point.threshold, width)
        ]
        found = [
            sum(skeleton_length(m) for m in crack_marks(p, point.threshold, width, 0.02)) / width
            for p in (said, linked(said, tile, point.threshold, width))
        ]
        errors.append([length, *found])
    table, lengths = np.array(rows), np.array(errors)
    print(f"{len(lengths)} cells, {len(table)} pairs of ends")
    for name, found in (("before", lengths[:, 1]), ("after", lengths[:, 2])):
        off = found - lengths[:, 0]
        print(f"length {name}: mean error {off.mean():+.3f}, absolute {np.abs(off).mean():.3f}")
    gap, supported, share = table.T
    for name, pairs in (("one crack", share >= 0.75), ("two", share < 0.6)):
        joined = pairs & (supported > 0)
        part = gap[joined].sum() / max(gap[pairs].sum(), 1e-9)
        print(f"{name}: {pairs.sum()} pairs, {joined.sum()} joined, {part:.3f} of the length")


if __name__ == "__main__":
    main()
