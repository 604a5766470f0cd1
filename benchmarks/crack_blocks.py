"""How well parts that are cut off are found, and what is taken for one that is none.

    python benchmarks/crack_blocks.py CELLS [--part train] [--seed N] [--count N]

CELLS holds train/ and val/, labelled cells: their class "dark" is a part that is cut off. Over the
clean ones, and over simulated cells, parts of several shapes are rendered, and what must not be
taken for one: cut corners, dark surrounds, interrupted fingers, gradients, dark grain, dark cells,
other busbars and finger grids; all blurred, sampled with 58 to 256 px and noisy. The constants were
chosen with ``--part train --seed 1``; ``--part val --seed 2`` is the part that was kept.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.cracks.blocks import cut_off_blocks
from pv_inspect.cracks.classes import CLASSES, CRACK
from pv_inspect.cracks.network import CELL_PX
from pv_inspect.cracks.training.augmentation import prepared
from pv_inspect.cracks.training.diversified import Diversity, with_fingers, with_other_metal
from pv_inspect.cracks.training.labelled import LabelledCell, read_labelled
from pv_inspect.simulate.defects import finger_interruptions
from pv_inspect.simulate.texture import cell_shading, metal, monocrystalline, multicrystalline

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

_DARK = CLASSES.index("dark")
_NOTHING = Diversity(0, 0, 0, 0, 0, 0)
SHAPES = ("corner", "strip", "between cracks", "chip")
OTHERS = ("as it is", "cut corners", "surround", "interrupted", "gradient", "grain", "dark cell",
          "other metal")  # fmt: skip


def simulated(rng: np.random.Generator, busbars: int, interrupted: bool = True) -> Image:
    """Cell of the simulator's silicon and metal."""
    shape, pitch = (CELL_PX, CELL_PX), 1 / CELL_PX
    silicon = multicrystalline if rng.random() < 0.5 else monocrystalline
    value = silicon(rng, shape, pitch) * cell_shading(rng, shape, busbars)
    value *= metal(rng, shape, pitch, busbars, str(rng.choice(["solid", "dashed"])))
    if interrupted:
        value *= finger_interruptions(rng, shape, pitch, busbars)
    return np.asarray(value * 0.6, np.float32)


def outline(shape: str, rng: np.random.Generator) -> NDArray[np.float64]:
    """Polygon (x, y) of a part, cell = 1, before a random flip."""
    if shape == "corner":
        a, b = rng.uniform(0.15, 0.6, 2)
        return np.array([(-1, -1), (a, -1), (a, 0), (0, b), (-1, b)])
    if shape == "strip":
        a, b = rng.uniform(0.1, 0.3, 2)
        x0, x1 = np.sort(rng.uniform(-0.2, 1.2, 2)) if rng.random() < 0.6 else (-0.5, 1.5)
        x1 = max(x1, x0 + 0.35)
        return np.array([(x0, -1), (x1, -1), (x1, b), (x0, a)])
    if shape == "between cracks":
        x0, x1 = rng.uniform(0, 0.5), rng.uniform(0.6, 1.0)
        tilt, end = rng.uniform(-0.3, 0.3, 2), rng.uniform(0.15, 0.5)
        return np.array([(x0, -0.1), (x1, -0.1), (x1 + tilt[1] * end, end), (x0 + tilt[0], end)])
    a, b = rng.uniform(0.15, 0.35, 2)
    part = np.linspace(0, 1, int(rng.integers(3, 6)))
    rough = np.where((part > 0) & (part < 1), rng.normal(1, 0.15, len(part)), 1)
    chipped = np.stack([a * (1 - part) * rough, b * part * rough], axis=1)
    return np.array([(-1, -1), (a, -1), *chipped, (-1, b)])


def with_part(image: Image, shape: str, rng: np.random.Generator) -> tuple[Image, Mask]:
    """Draw a part that is cut off, at a level of 0.02 to 0.32 of the rest."""
    mask = np.zeros(image.shape, np.uint8)
    cv2.fillPoly(mask, [np.rint(outline(shape, rng) * CELL_PX).astype(np.int32)], 1)
    mask = mask[:: rng.choice([1, -1]), :: rng.choice([1, -1])]
    mask = np.ascontiguousarray(mask.T if rng.random() < 0.5 else mask)
    soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), rng.uniform(0.4, 2.0))
    return image * (1 - np.float32(rng.uniform(0.68, 0.98)) * soft), mask > 0


def with_other(
    image: Image, label: NDArray[np.uint8], kind: str, rng: np.random.Generator
) -> Image:
    """Draw something dark that is not cut off."""
    shares = {
        "cut corners": Diversity(0, 0, 0, 0, 0, 1), "surround": Diversity(0, 0, 0, 0, 1, 0.3),
        "interrupted": Diversity(0, 0, 1, 0, 0, 0), "other metal": Diversity(1, 0, 0, 0, 0, 0),
    }  # fmt: skip
    y, x = np.mgrid[: image.shape[0], : image.shape[1]].astype(np.float32) / CELL_PX
    if kind in shares:
        image = with_other_metal(image, label, rng, shares[kind])[0]
        return with_fingers(image, label, rng) if kind == "other metal" else image
    if kind == "gradient":
        for _ in range(int(rng.integers(1, 3))):
            turn, reach = rng.uniform(0, 2 * np.pi), rng.uniform(0.1, 0.6)
            far = (x - 0.5) * np.cos(turn) + (y - 0.5) * np.sin(turn)
            fall = np.exp(-np.maximum(far.max() - far, 0) / reach * 2)
            image = image * (1 - np.float32(rng.uniform(0.4, 0.95)) * fall)
        return image
    if kind == "grain":
        for _ in range(int(rng.integers(2, 8))):
            noise = rng.standard_normal(image.shape).astype(np.float32)
            rough = cv2.GaussianBlur(noise, (0, 0), rng.uniform(2, 8))
            spot = np.hypot(x - rng.random(), y - rng.random()) / rng.uniform(0.03, 0.14)
            where = 1 / (1 + np.exp(np.clip(6 * (spot - 1) + 3 * rough / rough.std(), -30, 30)))
            image = image * (1 - np.float32(rng.uniform(0.2, 0.8)) * where)
        return np.asarray(image, np.float32)
    if kind == "dark cell":
        return image * np.float32(rng.uniform(0.02, 0.2))
    return image


def photographed(image: Image, mask: Mask, rng: np.random.Generator) -> tuple[Image, Mask]:
    """Turned, cut out inexactly, blurred, sampled with fewer pixels, noisy; some as half cells."""
    if rng.random() < 0.25:
        n, low = CELL_PX // 2, rng.random() < 0.5
        image, mask = (part[:n] if low else part[-n:] for part in (image, mask))
    image = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.3, 2.0))
    longer = int(np.exp(rng.uniform(np.log(58), np.log(257))))
    scale = longer / max(image.shape)
    size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
    image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    mask = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    sigma = rng.uniform(0.002, 0.05) * 0.6
    noisy = image + rng.normal(0, sigma, image.shape).astype(np.float32)
    return np.asarray(np.maximum(noisy, 0), np.float32), mask > 0


def rendered_rows(cells: list[LabelledCell], seed: int, count: int) -> list[str]:
    """Shares of rendered parts that are found, and of cells without any that get an alarm."""
    rng = np.random.default_rng(seed)
    clean = [c for c in cells if not np.isin(c.label, (_DARK, CRACK)).any()]
    found: dict[str, list[float]] = defaultdict(list)
    for kind in (*SHAPES, *OTHERS):
        for _ in range(count):
            cell = clean[rng.integers(len(clean))]
            image, label = prepared(cell.image, cell.label)
            grey = np.asarray(image, np.float32) / np.float32(255)
            if rng.random() < 0.4:
                grey = simulated(rng, int(rng.integers(2, 7)))
                label = np.zeros_like(label)
            mask = np.zeros(grey.shape, bool)
            if kind in SHAPES:
                if rng.random() < 0.5:
                    other = str(rng.choice(["cut corners", "interrupted", "other metal"]))
                    grey = with_other(grey, label, other, rng)
                grey, mask = with_part(grey, kind, rng)
            else:
                grey = with_other(grey, label, kind, rng)
            grey, mask = photographed(grey, mask, rng)
            seen = cut_off_blocks(grey)
            if kind in OTHERS:
                found[kind].append(float(seen.any()))
            elif 0.015 <= mask.mean() <= 0.45:
                found[kind].append(float((seen & mask).sum() / (seen | mask).sum()))
    rows = [f"{'rendered':<18}{'cells':>7}{'found':>8}{'IoU':>7}"]
    for kind in SHAPES:
        iou = np.array(found[kind])
        rows.append(f"{kind:<18}{len(iou):7d}{(iou > 0.3).mean():8.3f}{iou[iou > 0.3].mean():7.2f}")
    rows.append(f"{'without a part':<18}{'cells':>7}{'alarms':>8}")
    rows += [f"{kind:<18}{len(found[kind]):7d}{np.mean(found[kind]):8.3f}" for kind in OTHERS]
    return rows


def labelled_rows(cells: list[LabelledCell]) -> list[str]:
    """Shares of labelled cells in which a part is found, by what the labels say."""
    found: dict[str, list[bool]] = defaultdict(list)
    for cell in cells:
        dark = cell.label == _DARK
        grey = np.asarray(cell.image, np.float32) / np.float32(255)
        if dark.mean() <= 0.001:
            kind = "no dark part, cracked" if cell.crack.any() else "clean"
        elif dark.mean() < 0.012:
            kind = "dark parts under 1.2 %"
        else:
            level = np.median(grey[dark]) / np.percentile(grey, 70)
            kind = "dark part" if level < 0.35 else "greyish part"
        found[kind].append(bool(cut_off_blocks(grey).any()))
    rows = [f"{'labelled cells':<24}{'cells':>7}{'found':>8}"]
    return rows + [f"{k:<24}{len(v):7d}{np.mean(v):8.3f}" for k, v in sorted(found.items())]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("cells", type=Path)
    parser.add_argument("--part", choices=("train", "val"), default="val")
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--count", type=int, default=200)
    options = parser.parse_args()
    cells = read_labelled(options.cells / options.part)
    print(*labelled_rows(cells), sep="\n")
    print(*rendered_rows(cells, options.seed, options.count), sep="\n")


if __name__ == "__main__":
    main()
