"""How well interrupted fingers are found, and what is taken for one.

    python benchmarks/crack_fingers.py CELLS [--part train] [--seed N] [--count N]

CELLS holds train/ and val/, labelled cells. Over clean ones, and over simulated cells, bars are
rendered; blurred, sampled with 58 to 256 px and noisy. Printed are the shares of bars that are
found, by how much darker they are. What the labelled cells have by themselves nobody has labelled:
*found* per cell is compared with what the same search finds along the busbars, where no finger can
be, between them (*across*, per area of the cell). Last, the labelled cracks that a bar is taken
from: pieces that lie on bars in half of their length or more, without a detector's marks, and with
those of the default one. The constants were chosen with ``--part train --seed 1``;
``--part val --seed 2`` is the part that was kept.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from crack_blocks import simulated
from numpy.typing import NDArray

from pv_inspect.cracks import NetworkDetector, crack_marks, operating_point_of
from pv_inspect.cracks.classes import BUSBAR, CLASSES, CRACK
from pv_inspect.cracks.fingers import InterruptedFinger, interrupted_fingers
from pv_inspect.cracks.isolation import Busbars, busbars_from_map
from pv_inspect.cracks.network import CELL_PX
from pv_inspect.cracks.training.augmentation import prepared
from pv_inspect.cracks.training.diversified import Diversity, with_other_metal
from pv_inspect.cracks.training.labelled import LabelledCell, read_labelled
from pv_inspect.settings import Settings

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

_DARK = CLASSES.index("dark")
_INTERRUPTED = Diversity(0, 0, 1, 0, 0, 0)
_DEPTHS = (0.05, 0.1, 0.2, 0.4, 1.0)
_SIDES = (58, 100, 160, 257)
# Of what is rendered: as long and as wide as what counts as a bar, cell widths.
_LEAST_LENGTH, _MOST_WIDTH = 0.12, 0.04


def drawn(label: NDArray[np.uint8], rng: np.random.Generator) -> Image:
    """Factor of the brightness: 1 but for bars along the fingers."""
    white = np.ones(label.shape, np.float32)
    return with_other_metal(white, label, rng, _INTERRUPTED)[0]


def photographed(image: Image, side: int, rng: np.random.Generator) -> Image:
    """Blurred, sampled with so many pixels, noisy."""
    blurred = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.3, 1.5))
    scale = side / max(image.shape)
    size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
    small = cv2.resize(blurred, size, interpolation=cv2.INTER_AREA)
    noise = rng.normal(0, rng.uniform(0.002, 0.03) * float(small.mean()), small.shape)
    return np.asarray(np.maximum(small + noise, 0), np.float32)


def mask_of(bars: list[InterruptedFinger], shape: tuple[int, ...]) -> Mask:
    """Pixels of bars."""
    mask = np.zeros(shape, bool)
    for bar in bars:
        mask[slice(*bar.rows), slice(*bar.cols)] = True
    return mask


def rendered_rows(cells: list[LabelledCell], seed: int, count: int) -> list[str]:
    """Shares of rendered bars that are found, by depth and by pixels per cell."""
    rng = np.random.default_rng(seed)
    found: dict[tuple[str, int, int], list[bool]] = defaultdict(list)
    for _ in range(count):
        cell = cells[rng.integers(len(cells))]
        image, label = prepared(cell.image, cell.label)
        grey, kind = np.asarray(image, np.float32) / np.float32(255), "labelled"
        if rng.random() < 0.5:
            kind, label = "simulated", np.zeros_like(label)
            grey = simulated(rng, busbars := int(rng.integers(2, 7)), interrupted=False)
            rows = ((np.arange(busbars) + 0.5) / busbars * CELL_PX).astype(int)
            label[(rows[:, None] + [-2, -1, 0, 1, 2]).ravel()] = BUSBAR
        busbars_seen = busbars_from_map((label == BUSBAR).astype(np.float32))
        if busbars_seen is None:
            continue
        factor = drawn(label, rng)
        band = int(rng.integers(len(_SIDES) - 1))
        side = int(rng.integers(_SIDES[band], _SIDES[band + 1]))
        tile = photographed(grey * factor, side, rng)
        n = tile.shape[0 if busbars_seen.horizontal else 1]
        lines = cv2.resize(busbars_seen.lines.astype(np.uint8)[None], (n, 1))[0] > 0
        bars = interrupted_fingers(tile, Busbars(busbars_seen.horizontal, lines))
        seen = cv2.resize(mask_of(bars, tile.shape).astype(np.uint8), label.shape[::-1]) > 0
        for part, depth in parts(factor, busbars_seen.horizontal):
            along = 1 if busbars_seen.horizontal else 0
            share = float((seen & part).any(along).sum() / part.any(along).sum())
            k = int(np.searchsorted(_DEPTHS, depth)) - 1
            if k >= 0:
                found[kind, band, k].append(share >= 0.3)
    heads = "".join(f"  {a:g} to {b:g} darker" for a, b in pairwise(_DEPTHS))
    rows_ = [f"{'bars found (of)':<24}{heads}"]
    for kind in ("labelled", "simulated"):
        for band in range(len(_SIDES) - 1):
            row = f"{kind}, {_SIDES[band]} to {_SIDES[band + 1] - 1} px".ljust(24)
            for k in range(len(_DEPTHS) - 1):
                hits = found[kind, band, k]
                row += f"{np.mean(hits) if hits else np.nan:12.2f} ({len(hits):3d})"
            rows_.append(row)
    return rows_


def parts(factor: Image, horizontal: bool) -> list[tuple[Mask, float]]:
    """Rendered bars that don't overlap another one, with how much darker they are."""
    value = factor if horizontal else factor.T
    n, labels, facts, _ = cv2.connectedComponentsWithStats((value < 0.97).astype(np.uint8))
    chosen = []
    for k in range(1, n):
        width, height = facts[k, cv2.CC_STAT_WIDTH], facts[k, cv2.CC_STAT_HEIGHT]
        if height < _LEAST_LENGTH * CELL_PX or width > _MOST_WIDTH * CELL_PX:
            continue
        part = labels == k
        depth = float(1 - np.median(value[part]))
        chosen.append((part if horizontal else part.T, depth))
    return chosen


def across(tile: Image, busbars: Busbars) -> tuple[int, float]:
    """Bars along the busbars between two of them, and the share of the cell that was searched."""
    turned = tile if busbars.horizontal else np.ascontiguousarray(tile.T)
    edges = np.flatnonzero(np.diff(busbars.lines.astype(np.int8), prepend=1, append=1))
    n, area = 0, 0.0
    for a, b in edges.reshape(-1, 2):
        part = np.ascontiguousarray(turned[a + 10 : b - 10])
        if len(part) < 60:
            continue
        lines = np.zeros(part.shape[1], bool)
        lines[:: len(part) + 20] = True
        n += len(interrupted_fingers(part, Busbars(False, lines)))
        area += part.size / turned.size
    return n, area


def labelled_rows(cells: list[LabelledCell]) -> list[str]:
    """What is found in the labelled cells as they are."""
    detector = NetworkDetector()
    point = operating_point_of(detector, Settings())
    counts: dict[str, list[tuple[int, int, float]]] = defaultdict(list)
    pieces, on_bars, on_told = 0, 0, 0
    for cell in cells:
        tile = np.asarray(cell.image, np.float32) / np.float32(255)
        probability, bars = detector.read(tile)
        busbars = busbars_from_map(bars)
        if busbars is None:
            continue
        marks = crack_marks(probability, point.threshold, tile.shape[1], point.least_extent_cells)
        told = interrupted_fingers(tile, busbars, marks)
        kind = "cracked or dark" if np.isin(cell.label, (CRACK, _DARK)).any() else "clean"
        counts[kind].append((len(told), *across(tile, busbars)))
        any_bars = mask_of(interrupted_fingers(tile, busbars), tile.shape)
        told_bars = mask_of(told, tile.shape)
        n, labels = cv2.connectedComponents(cell.crack.astype(np.uint8), connectivity=8)
        for k in range(1, n):
            piece = labels == k
            if piece.sum() >= 40:
                pieces += 1
                on_bars += bool((any_bars & piece).sum() >= 0.5 * piece.sum())
                on_told += bool((told_bars & piece).sum() >= 0.5 * piece.sum())
    rows = [f"{'labelled cells':<18}{'cells':>7}{'with':>7}{'bars per cell':>15}{'across':>8}"]
    for kind, found in counts.items():
        n, wrong, area = np.array(found, float).T
        rows.append(
            f"{kind:<18}{len(n):7d}{(n > 0).mean():7.3f}{n.mean():15.3f}"
            f"{wrong.sum() / area.sum():8.3f}"
        )
    return [*rows, f"labelled cracks on bars: {on_bars} of {pieces}, {on_told} that are told"]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("cells", type=Path)
    parser.add_argument("--part", choices=("train", "val"), default="val")
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--count", type=int, default=600)
    options = parser.parse_args()
    cells = read_labelled(options.cells / options.part)
    clean = [cell for cell in cells if not np.isin(cell.label, (CRACK, _DARK)).any()]
    print(*rendered_rows(clean, options.seed, options.count), sep="\n", flush=True)
    print(*labelled_rows(cells), sep="\n")


if __name__ == "__main__":
    main()
