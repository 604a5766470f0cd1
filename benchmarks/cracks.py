"""How well cracks are found: labelled cells, foreign cells, reconstructed modules, drawn truth.

    python benchmarks/cracks.py cells CELLS                    labelled cells (train/, val/)
        [--elpv ELPV]                                          cells of other cameras
        [--disjoint NETWORK]                                   a model trained with --split modules
        [--reliability FILE]                                   writes the table of docs/
        [--model NETWORK]                                      this one in place of all of ours
    python benchmarks/cracks.py sequences RESULTS SEQUENCES SCORER
        [--only D2 ...] [--detectors network ...]
        [--unseen CELLS]                                       only cells that are not in train/

ELPV holds labels.csv and images/. RESULTS holds one folder of `pv-inspect run` per sequence, of the
same name; nothing is reconstructed again. SCORER is the script that scores a sequence; its
functions are used. BICUBIC is the first used frame, rectified with the geometry of the result; HR
is the truth.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
from collections.abc import Iterator
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import cv2
import numpy as np
from crack_unseen import Learnt
from crack_visibility import lines_of, pieces
from numpy.typing import NDArray

from pv_inspect.cells import CellTiles
from pv_inspect.common.work import result_of
from pv_inspect.cracks import (
    CrackDetector,
    NetworkDetector,
    RidgeDetector,
    operating_point_of,
    read_cracks,
)
from pv_inspect.cracks.centreline import skeleton_length
from pv_inspect.cracks.features import measure_cell
from pv_inspect.cracks.isolation import Busbars, isolated_share
from pv_inspect.cracks.training.labelled import LabelledCell, read_labelled, split_modules
from pv_inspect.cracks.training.labelled_maps import alarms, as_they_are, degraded
from pv_inspect.cracks.training.reliability import reliability
from pv_inspect.cracks.training.scores import coarse_score, pixel_score, roc_auc
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.registration.registration import Registration
from pv_inspect.results.read import read_result
from pv_inspect.sequence.frame_files import expand, read_frame
from pv_inspect.settings import Settings

Image = NDArray[np.float32]

# A point of a crack is found if a mark lies within this.
_TOLERANCE_LR_PX = 0.75


def detectors() -> dict[str, CrackDetector]:
    """Every detector of the package."""
    return {
        "network": NetworkDetector(),
        "network, sharp cells": NetworkDetector("sharp"),
        "network, cell labels": NetworkDetector("weak"),
        "ridge filters": RidgeDetector(),
    }


def labelled_rows(cells: list[LabelledCell], found: dict[str, CrackDetector]) -> Iterator[str]:
    """Yield the figures on labelled cells, one line per detector."""
    yield (
        f"{'labelled cells':<22}{'AP':>7}{'F1':>7}{'coarse AP':>11}{'F1':>7}{'inst. F1':>10}"
        f"{'recall':>8}{'alarms':>8}{'degraded AP':>13}{'F1':>7}"
    )
    for name, detector in found.items():
        maps = list(as_they_are(detector, cells))
        pixels, coarse = pixel_score(maps), coarse_score(maps)
        recall, false = alarms(maps, operating_point_of(detector, Settings()))
        rough = pixel_score(degraded(detector, cells))
        yield (
            f"{name:<22}{pixels.ap:7.3f}{pixels.f1:7.3f}{coarse.ap:11.3f}{coarse.f1:7.3f}"
            f"{coarse.instance_f1:10.3f}{recall:8.3f}{false:8.3f}{rough.ap:13.3f}{rough.f1:7.3f}"
        )


def foreign_rows(elpv: Path, found: dict[str, CrackDetector]) -> Iterator[str]:
    """Yield the ROC-AUC of the cells' crack score, defect probability >= 0.66 against 0."""
    lines = [line.split() for line in (elpv / "labels.csv").read_text().splitlines() if line]
    defect = np.array([float(line[1]) for line in lines])
    mono = np.array([line[2] == "mono" for line in lines])
    judged = (defect >= 0.66) | (defect == 0)
    yield f"{'foreign cells (ELPV)':<22}{'ROC-AUC':>9}{'mono':>7}{'poly':>7}"
    for name, detector in found.items():
        scores = []
        for line in lines:
            image = cv2.imread(str(elpv / line[0]), cv2.IMREAD_GRAYSCALE)
            tile = np.asarray(image, np.float32) / np.float32(255)
            features = measure_cell(
                tile,
                detector.probability(tile),
                0.5,
                row=0,
                col=0,
                cell_width_px=tile.shape[1],
                usual_intensity=float(np.median(tile)),
            )
            scores.append(features.crack_score)
        aucs = [
            roc_auc(np.array(scores)[chosen], defect[chosen] >= 0.66)
            for chosen in (judged, judged & mono, judged & ~mono)
        ]
        yield f"{name:<22}{aucs[0]:9.3f}{aucs[1]:7.3f}{aucs[2]:7.3f}"


def speed_rows(found: dict[str, CrackDetector]) -> Iterator[str]:
    """Yield the time that 60 cells of 256 x 256 take."""
    rng = np.random.default_rng(0)
    cells = [rng.random((256, 256), np.float32) * 0.1 + 0.5 for _ in range(60)]
    yield f"{'60 cells of 256 px':<22}{'s':>7}{'CPU s':>7}   ({cv2.getNumThreads()} threads)"
    for name, detector in found.items():
        detector.probability(cells[0])
        wall, cpu = perf_counter(), process_time()
        for cell in cells:
            detector.probability(cell)
        yield f"{name:<22}{perf_counter() - wall:7.2f}{process_time() - cpu:7.2f}"


def drawn_rows(n: int = 200) -> Iterator[str]:
    """Yield errors of length and isolated area of lines drawn in a cell of 256 px."""
    rng = np.random.default_rng(0)
    row, col = np.mgrid[:256, :256]
    lines = np.zeros(256, bool)
    lines[125:131] = True
    errors: dict[str, list[float]] = {"length": [], "isolated area": []}
    for _ in range(n):
        angle, width = rng.uniform(0, np.pi), rng.integers(2, 6)
        way = np.array([np.cos(angle), np.sin(angle)])
        half, middle = rng.uniform(60, 110), 127 + rng.uniform(-8, 8, 2)
        along = (col - middle[0]) * way[0] + (row - middle[1]) * way[1]
        across = (row - middle[1]) * way[0] - (col - middle[0]) * way[1]
        distance = np.hypot(across, np.maximum(np.abs(along) - half, 0))
        errors["length"].append(skeleton_length(distance <= width / 2) / (2 * half) - 1)
        x, y = rng.uniform(80, 230), rng.uniform(50, 110)
        corner = np.abs(col / x + row / y - 1) / np.hypot(1 / x, 1 / y) <= width / 2
        area = (x + 0.5 + 0.5 * x / y) * (y + 0.5 + 0.5 * y / x) / 2
        errors["isolated area"].append(
            isolated_share(corner, Busbars(True, lines)).sum() / area - 1
        )
    yield f"{'drawn truth':<22}{'mean':>8}{'worst':>8}"
    for name, values in errors.items():
        yield f"{name:<22}{np.mean(values):8.2%}{np.abs(values).max():8.2%}"


def bicubic(result: Inspection, sequence: Path) -> Image:
    """First used frame on the grid of the result."""
    registration, grid = result.need(Registration), result.need(Reconstruction).grid
    first = int(np.flatnonzero(registration.used)[0])
    path = sequence / "frames" / result.names[first]
    pixels = np.asarray(read_frame(expand(path)[0]), np.float32)
    pixels -= np.percentile(pixels, 0.5)  # the black level, about
    h, w = grid.shape
    x, y = np.meshgrid(np.arange(w), np.arange(h))
    at = grid.to_module(np.stack([x, y], axis=-1).reshape(-1, 2).astype(np.float64))
    where = registration.camera.project(registration.homographies[first], at)
    where = where.reshape(h, w, 2).astype(np.float32)
    seen = cv2.remap(pixels, where[..., 0], where[..., 1], cv2.INTER_CUBIC)
    return np.maximum(np.asarray(seen, np.float32), 0) / np.float32(65535)


def probability_of(
    image: Image, result: Inspection, detector: CrackDetector
) -> tuple[Image, float]:
    """Crack probability of an image on the grid of a result, and the threshold."""
    grid = result.need(Reconstruction).grid
    found = result_of(read_cracks(CellTiles(image, grid), Settings(), detector))
    return found.probability, found.threshold


def sequence_rows(
    name: str,
    result_folder: Path,
    sequence: Path,
    scorer: Any,
    found: dict[str, CrackDetector],
    learnt: Learnt | None = None,
) -> tuple[list[str], list[str]]:
    """Score cracks of ours, BICUBIC and the HR truth as the scorer does.

    Returns
    -------
    tuple of two lists of str
        Lines with the figures, and lines by width and contrast of the cracks.
    """
    result = read_result(result_folder)
    made = result.need(Reconstruction)
    truth = json.loads((sequence / "truth" / "truth.json").read_text())
    record = json.loads((result_folder / "result.json").read_text())
    rows, cols, turns = scorer.orientations(truth, record)
    k = scorer.score_geometry(truth, record, rows, cols, turns)[1] or 0
    hr = truth["hr"]
    fine = scorer.Grid(hr["pixels_per_cell"], hr["origin_px"], truth["rows"], truth["cols"])
    coarse = scorer.Grid(record["pixels_per_cell"], record["origin_px"], rows, cols)
    h, w = made.image.shape
    turned = np.rot90(made.image, k).shape
    grid = coarse.rotated(k, w, h)
    x0, x1, y0, y1 = window = grid.window(turned[1], turned[0])

    def of_truth(file: str) -> Image:
        image = cv2.imread(str(sequence / "truth" / file), cv2.IMREAD_UNCHANGED)
        return np.asarray(scorer.truth_on(image.astype(np.float64), fine, grid, window), np.float32)

    mask = of_truth(hr["cracks"]) >= 127.5
    best = np.zeros(turned, np.float32)
    best[y0:y1, x0:x1] = of_truth(hr["file"]) / 65535
    images = {
        "ours": made.image,
        "BICUBIC": bicubic(result, sequence),
        "HR": np.ascontiguousarray(np.rot90(best, -k)),
    }
    judged = np.ones(turned, bool)
    if learnt is not None:
        cells = np.ndindex(made.grid.layout.rows, made.grid.layout.cols)
        upright = np.zeros(made.image.shape, bool)
        unseen = [made.grid.cell_slices(*at) for at in cells]
        unseen = [where for where in unseen if not learnt.holds(images["HR"][where])]
        for where in unseen:
            upright[where] = True
        judged = np.rot90(upright, k)
        mask = mask & judged[y0:y1, x0:x1]
        name = f"{name} ({len(unseen)})"
    scene = pieces(best, mask_of(mask, turned, window), made.grid.pixels_per_unit)
    figures, shares = [], []
    for detector_name, detector in found.items():
        texts, f1, seen_of = [], {}, {}
        for image_name, image in images.items():
            probability, threshold = probability_of(image, result, detector)
            turned_map = np.ascontiguousarray(np.rot90(probability, k) * judged)
            score = scorer.score_cracks(turned_map[y0:y1, x0:x1], mask, threshold)["max"]
            part, group = score["segmentation"], score["detection"]
            f1[image_name] = (part["f1"], part["ap"])
            texts.append(f"{part['f1']:8.3f}{part['ap']:7.3f}{group['f1']:7.3f}")
            reach = round(_TOLERANCE_LR_PX * made.grid.magnification)
            seen_of[image_name] = scene.found(turned_map, threshold, reach)
        ours, bicubic_f1, truth_f1 = (f1[name] for name in ("ours", "BICUBIC", "HR"))
        ratios = [a / max(b, 1e-9) for a, b in zip(ours, bicubic_f1, strict=True)]
        figures.append(
            f"{name:<8}{detector_name:<22}{''.join(texts)}{ratios[0]:8.1f}{ratios[1]:6.1f}"
            f"{ours[0] / max(truth_f1[0], 1e-9):8.2f}"
        )
        shares.append(f"{name:<8}{detector_name}")
        shares += lines_of(name, scene, seen_of, made.grid.magnification)
    return figures, shares


def mask_of(part: NDArray[np.bool_], shape: tuple[int, ...], window: Any) -> NDArray[np.bool_]:
    """Mask of a window, put back on the whole grid."""
    x0, x1, y0, y1 = window
    whole = np.zeros(shape, bool)
    whole[y0:y1, x0:x1] = part
    return whole


def reliability_table(cells: list[LabelledCell], detector: CrackDetector) -> str:
    """Return the reliability of the probability as a table in Markdown."""
    found = {
        "as they are": reliability(as_they_are(detector, cells)),
        "degraded": reliability(degraded(detector, cells)),
    }
    lines = []
    for name, table in found.items():
        lines += [f"Cells {name} (mean error {table.error:.3f}):", ""]
        lines += ["| probability said | share labelled crack | pixels |", "|---|---|---|"]
        rows = zip(table.said, table.seen, table.pixels, strict=True)
        lines += [f"| {said:.3f} | {seen:.3f} | {n} |" for said, seen, n in rows] + [""]
    return "\n".join(lines)


def cells_command(options: argparse.Namespace) -> None:
    """Labelled cells, foreign cells, drawn truth, speed."""
    found, val = detectors(), read_labelled(options.cells / "val")
    if options.model:
        found = {"network": NetworkDetector(options.model)}
    print(*labelled_rows(val, found), sep="\n")
    if options.disjoint:
        everything = [*read_labelled(options.cells / "train"), *val]
        held = split_modules(everything)[1]
        print(
            *labelled_rows(held, {"module-disjoint": NetworkDetector(options.disjoint)}), sep="\n"
        )
    if options.elpv:
        print(*foreign_rows(options.elpv, found), sep="\n")
    print(*drawn_rows(), sep="\n")
    print(*speed_rows(found), sep="\n")
    if options.reliability:
        options.reliability.write_text(reliability_table(val, found["network"]), encoding="utf-8")


def sequences_command(options: argparse.Namespace) -> None:
    """Ours against BICUBIC and the truth, on stored results."""
    spec = importlib.util.spec_from_file_location("scorer", options.scorer)
    assert spec is not None
    assert spec.loader is not None
    scorer = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(scorer)
    every = detectors()
    found = {name: every[name] for name in options.detectors or every}
    print(
        f"{'coarse masks':<30}"
        + "".join(f"{n + ' F1':>8}{'AP':>7}{'inst.':>7}" for n in ("ours", "BIC", "HR"))
        + "   F1, AP: / BIC   F1 / HR"
    )
    by_width = []
    learnt = None
    if options.unseen:
        learnt = Learnt(*(read_labelled(options.unseen / part) for part in ("train", "val")))
    for folder in sorted(options.results.iterdir()):
        sequence = options.sequences / folder.name
        if options.only and folder.name not in options.only:
            continue
        if (folder / "result.json").is_file() and (sequence / "truth" / "cracks.png").is_file():
            figures, shares = sequence_rows(folder.name, folder, sequence, scorer, found, learnt)
            print(*figures, sep="\n", flush=True)
            by_width += shares
    print(f"\n{'cracks by':<36}{'share':>7}{'ours':>9}{'BICUBIC':>9}{'HR':>9}  found")
    print(*by_width, sep="\n")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    commands = parser.add_subparsers(required=True)
    cells = commands.add_parser("cells", help=cells_command.__doc__)
    cells.add_argument("cells", type=Path)
    for name in ("elpv", "disjoint", "reliability", "model"):
        cells.add_argument(f"--{name}", type=Path)
    cells.set_defaults(call=cells_command)
    sequences = commands.add_parser("sequences", help=sequences_command.__doc__)
    for name in ("results", "sequences", "scorer"):
        sequences.add_argument(name, type=Path)
    sequences.add_argument("--unseen", type=Path, metavar="CELLS")
    sequences.add_argument("--only", nargs="+", metavar="NAME")
    sequences.add_argument("--detectors", nargs="+", metavar="NAME")
    sequences.set_defaults(call=sequences_command)
    options = parser.parse_args()
    options.call(options)


if __name__ == "__main__":
    main()
