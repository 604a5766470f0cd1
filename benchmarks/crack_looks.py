"""Cracks on cells of other makers: rendered over validation cells, and real ones.

    python benchmarks/crack_looks.py CELLS [--models default NETWORK ...]
        [--kinds full half ...]            of the rendered cells, all if not given
        [--sandia FOLDER]                  single cells with labels.csv (file, cracked)
        [--modules RESULT ...]             results of `pv-inspect run`; their cells are read again

CELLS holds val/. Each kind of rendered cell has a seed of its own, which no choice has seen: shares
of the clean cells and of the cracked ones with a class, and of all that can't be judged. "full" are
the validation cells as they are, "full 58" and "half 58" are coarse as in a photograph of a whole
module.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.cells import CellTiles
from pv_inspect.common.work import result_of
from pv_inspect.cracks import (
    CrackDetector,
    NetworkDetector,
    novelty_of,
    operating_point_of,
    read_cracks,
)
from pv_inspect.cracks.classes import CRACK
from pv_inspect.cracks.features import CellFeatures, measure_cell
from pv_inspect.cracks.single_cells import read_plain_cell
from pv_inspect.cracks.training.augmentation import prepared
from pv_inspect.cracks.training.diversified import Diversity, with_fingers, with_other_metal
from pv_inspect.cracks.training.labelled import LabelledCell, read_labelled
from pv_inspect.results.read import read_result
from pv_inspect.settings import Settings

Image = NDArray[np.float32]
Label = NDArray[np.uint8]
Kind = Callable[[Image, Label, np.random.Generator], list[tuple[Image, Label]]]

_SEED = 20261128
# A cell with fewer labelled pixels than this share of it counts as neither cracked nor clean.
_LEAST_CRACK = 40 / 256**2


def _metal(**shares: float) -> Kind:
    none = dict.fromkeys(
        ("busbars", "fingers", "interruptions", "chips", "surrounds", "corners"), 0.0
    )
    diversity = Diversity(**{**none, **shares})
    return lambda image, label, rng: [with_other_metal(image, label, rng, diversity)]


def _fingers(image: Image, label: Label, rng: np.random.Generator) -> list[tuple[Image, Label]]:
    return [(with_fingers(image, label, rng), label)]


def _parts(n: int) -> Kind:
    def cut(image: Image, label: Label, _: np.random.Generator) -> list[tuple[Image, Label]]:
        size = image.shape[0] // n
        return [
            (image[k * size : (k + 1) * size], label[k * size : (k + 1) * size]) for k in range(n)
        ]

    return cut


def _coarse(kind: Kind, longer_px: int) -> Kind:
    """Sampled with fewer pixels, with the noise of a camera."""

    def seen(image: Image, label: Label, rng: np.random.Generator) -> list[tuple[Image, Label]]:
        made = []
        for part, classes in kind(image, label, rng):
            scale = longer_px / max(part.shape)
            size = (round(part.shape[1] * scale), round(part.shape[0] * scale))
            small = np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), np.float32)
            noise = rng.normal(0, 0.01, small.shape).astype(np.float32)
            made.append((small + noise * np.float32(small.mean()), classes))
        return made

    return seen


KINDS: dict[str, Kind] = {
    "full": _parts(1),
    "half": _parts(2),
    "third": _parts(3),
    "full 58": _coarse(_parts(1), 58),
    "half 58": _coarse(_parts(2), 58),
    "finger grid": _fingers,
    "0 to 16 busbars": _metal(busbars=1),
    "interrupted": _metal(interruptions=1),
    "chipped": _metal(chips=1),
    "surround, corners": _metal(surrounds=1, corners=1),
    "all of it": lambda i, m, rng: [
        (with_fingers(x, y, rng), y)
        for x, y in _metal(busbars=1, interruptions=1, chips=0.2, surrounds=0.5, corners=0.5)(
            i, m, rng
        )
    ],
}


def judged(tile: Image, detector: CrackDetector) -> CellFeatures:
    """Features of one cell as `read_cracks` measures them, without busbars."""
    point = operating_point_of(detector, Settings())
    return measure_cell(
        tile,
        detector.probability(tile),
        point.threshold,
        row=0,
        col=0,
        cell_width_px=float(max(tile.shape)),
        usual_intensity=float(np.median(tile)),
        least_extent_cells=point.least_extent_cells,
        least_length_cells=point.least_length_cells,
        least_score=point.least_score,
        novelty=novelty_of(detector, tile),
    )


def rendered_rows(
    cells: list[LabelledCell], detector: CrackDetector, kinds: list[str]
) -> list[str]:
    """Lines with the figures of each kind of rendered cell, or of those that are named."""
    rows = [
        f"{'rendered cells':<20}{'clean':>7}{'classed':>9}{'cracked':>9}{'classed':>9}{'open':>7}"
    ]
    for name, kind in KINDS.items():
        if kinds and name not in kinds:
            continue
        rng = np.random.default_rng(_SEED)
        classed: dict[bool, list[bool]] = {True: [], False: []}
        undecidable = []
        for cell in cells:
            image, label = prepared(cell.image, cell.label)
            grey = np.asarray(image, np.float32) / np.float32(255)
            for tile, classes in kind(grey, label, rng):
                share = float((classes == CRACK).mean())
                if 0 < share < _LEAST_CRACK:
                    continue
                found = judged(np.ascontiguousarray(tile), detector)
                classed[share > 0].append(found.crack_suspected)
                undecidable.append(found.undecidable)
        rows.append(
            f"{name:<20}{len(classed[False]):7d}{np.mean(classed[False]):9.3f}"
            f"{len(classed[True]):9d}{np.mean(classed[True]):9.3f}{np.mean(undecidable):7.3f}"
        )
    return rows


def sandia_rows(folder: Path, detector: CrackDetector) -> list[str]:
    """One line per labelled photograph of a cell."""
    rows = [
        f"{'single cells':<22}{'cracked':>8}{'class':>18}{'score':>7}{'length':>8}{'novelty':>9}"
    ]
    with (folder / "labels.csv").open(encoding="utf-8") as file:
        for line in csv.DictReader(file):
            found = read_plain_cell(folder / line["file"], detector, Settings()).features
            rows.append(
                f"{line['file']:<22}{line['cracked']:>8}"
                f"{found.crack_class + ' (' + found.marked_class + ')':>18}"
                f"{found.crack_score:7.2f}{found.crack_length_cells:8.2f}{found.novelty:9.2f}"
            )
    return rows


def module_row(result: Path, detector: CrackDetector) -> str:
    """Line with the counts of a module whose cells are read again."""
    found = result_of(read_cracks(read_result(result).need(CellTiles), Settings(), detector))
    instances = sum(cell.crack_instances for cell in found.cells)
    return f"{result.name}: {found.counts.text}; {instances} marks"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("cells", type=Path)
    parser.add_argument("--models", nargs="+", default=["default"])
    parser.add_argument("--kinds", nargs="+", default=[], choices=list(KINDS), metavar="KIND")
    parser.add_argument("--sandia", type=Path)
    parser.add_argument("--modules", type=Path, nargs="*", default=[])
    options = parser.parse_args()
    cells = read_labelled(options.cells / "val")
    for model in options.models:
        detector = NetworkDetector(model)
        print(f"\n{model}: {detector.name}")
        print(*rendered_rows(cells, detector, options.kinds), sep="\n", flush=True)
        if options.sandia:
            print(*sandia_rows(options.sandia, detector), sep="\n", flush=True)
        for result in options.modules:
            print(module_row(result, detector), flush=True)


if __name__ == "__main__":
    main()
