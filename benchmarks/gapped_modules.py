"""Modules with wide gaps or uneven cells, simulated: found right, refused, or put in doubt.

    python benchmarks/gapped_modules.py [--seeds 0 100] [--jobs 2] [--frames 6] [--guess]
                                        [--uneven told | untold]

Half-cut modules with centre gaps of 0 to 30 mm, mini-modules with 2 to 20 % of the pitch between
all cells, third-cut cells and plain ones of 3 x 3 to 12 x 24 cells are run up to the registered
frames with their rows, columns and cell aspect alone. "right" is a module whose gaps are found to
0.02 cell widths and whose crossing points lie within 0.3 LR px (RMS) of the truth; "doubtful" one
that is wrong and said to be in doubt, "silent" one that is wrong without a word. A right one that
is said to be in doubt is "doubted". Times are CPU seconds of the run. With ``--guess`` rows,
columns and cell aspect are not given either.

With ``--uneven`` the modules have no wide gap, but columns or rows of other cells than the rest: an
outer one, both outer ones, or cut cells among whole ones. Told, they are to be registered as others
are; untold, the result is to be refused or said to be in doubt.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing
import tempfile
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import process_time
from typing import Any

import cv2
import numba
import numpy as np
from wrong_layouts import drawn_sensor, drawn_view

from pv_inspect.errors import InspectionError
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.pipeline import inspect_steps
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from pv_inspect.simulate import (
    SimulatedSequence,
    SimulationSettings,
    simulated,
    write_sequence,
)
from pv_inspect.simulate.exposure import camera_matrix, choose_poses

GAP_TOLERANCE = 0.02
MOST_RMS_PX = 0.3
ANSWERS = {
    (True, False): "right",
    (True, True): "doubted",
    (False, True): "doubtful",
    (False, False): "silent",
}
"""By whether the module is right, and whether it is said to be in doubt."""
CELL_MM = 182.0
"""Width of a whole wafer of today's modules."""


@dataclass(frozen=True)
class Answer:
    """What one module came to."""

    seed: int
    kind: str
    true: ModuleLayout
    answer: str
    rms_px: float
    cpu_s: float
    words: str


def drawn(seed: int, n_frames: int, uneven: bool) -> tuple[str, SimulationSettings]:
    """Draw a module, a view and a camera."""
    rng = np.random.default_rng([15 if uneven else 14, seed])
    while True:
        with contextlib.suppress(InspectionError):  # the lens folds this view over: draw again
            return _drawn(rng, seed, n_frames, _uneven if uneven else _layout)


def _uneven(rng: np.random.Generator) -> tuple[str, dict[str, Any]]:
    kind = str(rng.choice(["outer", "both", "mixed"], p=[0.5, 0.2, 0.3]))
    n, others = int(rng.integers(4, 13)), int(rng.integers(2, 9))
    width = float(rng.choice([rng.uniform(0.35, 0.9), rng.uniform(1.1, 1.5)], p=[0.8, 0.2]))
    if kind == "mixed":
        numbers = sorted(rng.choice(n, int(rng.integers(1, n // 2)), replace=False) + 1)
        width = 0.5
    else:
        numbers = [1, n] if kind == "both" else [int(rng.choice([1, n]))]
    sizes = ", ".join(f"{number}:{width:.3f}" for number in numbers)
    if rng.random() < 0.3:  # the module lies on its side
        return kind, {"rows": n, "cols": others, "row_heights": sizes}
    return kind, {"rows": others, "cols": n, "col_widths": sizes}


def _layout(rng: np.random.Generator) -> tuple[str, dict[str, Any]]:
    kind = str(rng.choice(["half-cut", "mini", "third-cut", "plain"], p=[0.5, 0.25, 0.1, 0.15]))
    if kind == "half-cut":
        along, across = int(rng.choice([20, 24])), 6
        gap_mm = float(rng.choice([0, 4, 8, 12, 16, 20, 25, 30]))
        if rng.random() < 0.5:  # lying: cells half as wide as high, the unit is half a wafer
            values = {"rows": across, "cols": along, "cell_aspect": 0.5}
            return kind, values | {"col_gap": gap_mm / (CELL_MM / 2)}
        values = {"rows": along, "cols": across, "cell_aspect": 2.0}
        return kind, values | {"row_gap": gap_mm / CELL_MM}
    if kind == "mini":
        rows, cols = (2, 2) if rng.random() < 0.4 else (4, 9)
        return kind, {"rows": rows, "cols": cols, "cell_gap": float(rng.uniform(0.02, 0.2))}
    if kind == "third-cut":
        values = {"rows": 6, "cols": 30, "cell_aspect": 1 / 3}
        return kind, values | {"col_gap": float(rng.choice([0, 0.15, 0.3]))}
    rows, cols = ((3, 3), (4, 6), (6, 10), (6, 12), (12, 24))[int(rng.integers(5))]
    return kind, {"rows": rows, "cols": cols}


def _drawn(
    rng: np.random.Generator,
    seed: int,
    n_frames: int,
    layout_of: Callable[[np.random.Generator], tuple[str, dict[str, Any]]],
) -> tuple[str, SimulationSettings]:
    kind, layout = layout_of(rng)
    settings = SimulationSettings(
        seed=seed,
        **layout,
        wafer=str(rng.choice(["multi", "mono"])),
        busbars=int(rng.integers(2, 10)),
        busbar_style=str(rng.choice(["solid", "dashed"])),
        crack_share=float(rng.uniform(0, 0.5)),
        dark_cell_share=float(rng.choice([0.0, 0.02, 0.05])),
        n_frames=n_frames,
        **drawn_view(rng),
        supersampling=3,
        exposure=float(rng.choice([0.3, 0.6, 0.75])),
        **drawn_sensor(rng),
    )
    poses = choose_poses(settings, np.random.default_rng(0))
    camera = Camera(camera_matrix(settings), settings.kappa)
    areas = np.abs(np.linalg.det(camera.jacobian(poses[0].H, settings.layout.crossings())))
    # Small modules in smaller frames: their cells would be of hundreds of pixels.
    per_unit = float(np.sqrt(areas.mean()))
    width = round(float(np.clip(640 * 110 / per_unit, 256, 640)))
    scale = per_unit * width / 640
    return kind, replace(
        settings,
        width=width,
        height=round(0.8 * width),
        pixels_per_unit=int(np.clip(3.5 * scale, 60, 300)),
    )


def _gaps_right(found: ModuleLayout, true: ModuleLayout) -> bool:
    off = [abs(one - other) for one, other in zip(found.cell_gap, true.cell_gap, strict=True)]
    # Up to a few hundredths of the pitch a gap between all cells looks like a usual one.
    between = max(off) <= GAP_TOLERANCE or (not any(found.cell_gap) and max(off) < 0.06)
    lines = np.abs(found.crossings() - true.crossings()).max()
    return between and bool(lines <= GAP_TOLERANCE)


def _error_px(registration: Registration, made: SimulatedSequence) -> float:
    """RMS distance of the crossing points from the truth, whichever way up the module lies."""
    found, true = registration.layout, made.settings.layout
    if (found.rows, found.cols) != (true.rows, true.cols):
        return float("inf")
    errors = []
    for i in np.flatnonzero(registration.used):
        points = registration.crossings_px(int(i))
        true = made.crossings_px(int(i))
        errors.append(min(float(np.square(p - true).sum(1).mean()) for p in (points, points[::-1])))
    return float(np.sqrt(np.mean(errors)))


def trial(seed: int, n_frames: int, guess: bool, uneven: str | None = None) -> Answer:
    """Simulate one module and run it without telling its gaps, or anything of its cells."""
    cv2.setNumThreads(1)
    numba.set_num_threads(1)
    kind, settings = drawn(seed, n_frames, uneven is not None)
    made = simulated(settings)
    layout = settings.layout.plain
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "sequence"
        write_sequence(made, folder)
        if uneven != "told":
            # The sidecar may say nothing of gaps or uneven cells.
            shape = {"rows": layout.rows, "cols": layout.cols, "cell_aspect": layout.cell_aspect}
            said = json.dumps({} if guess else shape)
            (folder / "module.json").write_text(said, encoding="utf-8")
        return _answered(seed, kind, made, FrameSequence.open(folder))


def _answered(seed: int, kind: str, made: SimulatedSequence, frames: FrameSequence) -> Answer:
    true = made.settings.layout
    begun = process_time()
    answer, rms, words = "refused", np.nan, ""
    steps = inspect_steps(frames, Settings())
    try:
        for step in steps:
            if isinstance(step.partial, Registration):
                registration = step.partial
                rms = _error_px(registration, made)
                found = registration.layout
                right = rms <= MOST_RMS_PX and _gaps_right(found, true)
                answer = ANSWERS[right, bool(registration.misfit)]
                used = int(registration.used.sum())
                words = f"{used} used; {found.gaps_in_words} {registration.misfit}"
                break
    except InspectionError as error:
        words = str(error)
    finally:
        steps.close()
    return Answer(seed, kind, true, answer, float(rms), process_time() - begun, words)


def main() -> int:
    """Print the table; the exit code is 1 if a module was wrong without a word."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", nargs=2, type=int, default=(0, 100), metavar=("FIRST", "END"))
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--guess", action="store_true")
    parser.add_argument("--uneven", choices=["told", "untold"])
    args = parser.parse_args()
    answers: list[Answer] = []
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(args.jobs, mp_context=context) as pool:
        one_trial = partial(trial, n_frames=args.frames, guess=args.guess, uneven=args.uneven)
        for one in pool.map(one_trial, range(*args.seeds)):
            answers.append(one)
            print(
                f"{one.seed:4d} {one.kind:9} {one.true.rows:2d} x {one.true.cols:2d} "
                f"{one.answer:8} {one.rms_px:6.3f} px {one.cpu_s:6.1f} s  "
                f"true: {one.true.sizes_in_words or one.true.gaps_in_words or 'none'}  "
                f"{one.words[:250]}",
                flush=True,
            )
    count = Counter(one.answer for one in answers)
    print(" ".join(f"{count[k]} {k}" for k in (*ANSWERS.values(), "refused")), "of", len(answers))
    for plain in (True, False):
        rms = [
            a.rms_px for a in answers if a.answer == "right" and (a.true == a.true.plain) is plain
        ]
        if rms:
            name = "plain modules" if plain else "modules with gaps or uneven cells"
            print(f"RMS of {name}: median {np.median(rms):.3f}, worst {max(rms):.3f} px")
    return int(count["silent"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
