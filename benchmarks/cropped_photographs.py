"""Photographs that are cropped to the edge of the module, simulated.

    python benchmarks/cropped_photographs.py [--seeds 0 20]

Single photographs of modules of 3 x 6 to 12 x 6 cells are cropped to -0.5 to 3 px beyond the module
on one to four sides. The search for the module is told the true rows and columns ("right" if the
crossing points lie within 0.5 px RMS of the truth), wrong ones, and, cropped so that part of a row
or some rows are missing, the true ones and those that are whole. "silent" is a wrong answer
without a word; the line "cut, one less" has the rows that are whole while a part of the next shows.
"""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.work import result_of
from pv_inspect.detection.detect import detect
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.simulate import SimulatedSequence, SimulationSettings, simulated

MOST_RMS_PX = 0.5
LAYOUTS = ((3, 6, 1.0), (4, 6, 1.0), (6, 6, 1.0), (6, 10, 1.0), (6, 12, 1.0), (12, 6, 2.0))
Array = NDArray[np.float64]


def drawn(seed: int) -> SimulatedSequence:
    """Draw a module and a photograph of it from nearly in front."""
    rng = np.random.default_rng([1403, seed])
    rows, cols, aspect = LAYOUTS[int(rng.integers(len(LAYOUTS)))]
    settings = SimulationSettings(
        seed=seed, rows=rows, cols=cols, cell_aspect=aspect, n_frames=1,
        width=int(rng.choice([320, 480, 640])), height=400,
        wafer=str(rng.choice(["multi", "mono"])), busbars=int(rng.integers(2, 7)),
        busbar_style=str(rng.choice(["solid", "dashed"])),
        crack_share=float(rng.uniform(0, 0.5)), dark_cell_share=float(rng.choice([0.0, 0.03])),
        kappa=float(rng.uniform(-0.1, 0.03)), tilt_deg=float(rng.uniform(0, 5)),
        tilt_axis_deg=float(rng.uniform(0, 360)), roll_deg=float(rng.uniform(-1, 1)), fill=0.85,
        psf_sigma_px=float(rng.uniform(0.3, 0.8)), exposure=float(rng.choice([0.3, 0.6, 0.75])),
        ambient=float(rng.uniform(0, 0.03)), pixels_per_unit=120, supersampling=3,
    )  # fmt: skip
    return simulated(settings)


def cropped(
    true: SimulatedSequence, rng: np.random.Generator, missing: float = 0.0
) -> tuple[NDArray[np.uint16], Array]:
    """Crop the photograph; `missing` rows are cut off at the bottom."""
    layout, frame = true.settings.layout, true.frames[0]
    points = true.crossings_px(0)
    grid = points.reshape(layout.rows + 1, layout.cols + 1, 2)
    last = np.array(frame.shape[::-1]) - 1
    margins = rng.uniform(-0.5, 3, 4)
    wide = rng.permutation(4)[: int(rng.integers(4))]
    margins[wide] = 15
    low, high = points.min(axis=0) - margins[:2], points.max(axis=0) + margins[2:]
    if missing:
        line = layout.rows - missing
        k = min(int(line), layout.rows - 1)
        between = grid[k] + (line - k) * (grid[k + 1] - grid[k])
        high[1] = between[:, 1].mean()
    x0, y0 = np.clip(np.round(low), 0, last).astype(int)
    x1, y1 = np.clip(np.round(high), 0, last).astype(int)
    return np.ascontiguousarray(frame[y0 : y1 + 1, x0 : x1 + 1]), points - [x0, y0]


def answer(image: NDArray[np.uint16], layout: ModuleLayout, points: Array | None) -> str:
    """Look for a layout; `points` are the true crossing points, None if it is a wrong one."""
    with TemporaryDirectory() as folder:
        cv2.imwrite(str(Path(folder) / "photograph.png"), image * np.uint16(16))
        try:
            found = result_of(detect(FrameSequence.open(Path(folder)), layout)).frames[0]
        except InspectionError:
            return "refused"
    if points is None:
        return "silent"
    shown = found.measured
    ways = (points, points[::-1])
    rms = min(
        float(np.sqrt(np.square(found.points_px - way)[shown].sum(axis=1).mean())) for way in ways
    )
    return "right" if rms < MOST_RMS_PX else "silent"


def main() -> None:
    """Print how often each kind came to which answer."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", nargs=2, type=int, default=(0, 20), metavar=("FIRST", "END"))
    arguments = parser.parse_args()
    counts: dict[str, Counter[str]] = {}
    begun = process_time()

    def count(seed: int, kind: str, said: str) -> None:
        counts.setdefault(kind, Counter())[said] += 1
        if said == "silent" or (said == "refused" and kind == "whole"):
            print(f"seed {seed}: {kind}: {said}", flush=True)

    for seed in range(*arguments.seeds):
        true = drawn(seed)
        layout, rng = true.settings.layout, np.random.default_rng([1404, seed])
        rows, cols, aspect = layout.rows, layout.cols, layout.cell_aspect
        image, points = cropped(true, rng)
        count(seed, "whole", answer(image, layout, points))
        for r, c in ((rows - 1, cols), (rows + 1, cols), (rows, cols - 1), (rows, cols + 1)):
            count(seed, "whole, wrong layout", answer(image, ModuleLayout(r, c, aspect), None))
        part = cropped(true, rng, float(rng.uniform(0.2, 0.8)))[0]
        count(seed, "cut, true layout", answer(part, layout, None))
        count(seed, "cut, one less", answer(part, ModuleLayout(rows - 1, cols, aspect), None))
        part = cropped(true, rng, 1.0)[0]
        count(seed, "a row cut off, true layout", answer(part, layout, None))
    for kind, found in counts.items():
        print(f"{kind:28}", dict(found))
    print(f"{process_time() - begun:.0f} CPU s")


if __name__ == "__main__":
    main()
