"""Wrong rows and columns on simulated sequences: none may pass without a word.

    python benchmarks/wrong_layouts.py [--seeds 0 30] [--right] [--cache FOLDER]

Every sequence is run up to the registered frames with its rows or columns off by one or two,
swapped, halved and doubled, one of these after the other, and, with ``--right``, as they are. The
answer is "refused", "warning" or, what must not be, "silent"; for the right layout it must be
"silent". Times are those until the answer; under load the CPU time is the one to look at.
"""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter, process_time

import cv2
import numba
import numpy as np

from pv_inspect.errors import InspectionError
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.inspection.doubts import quarter_turn_sentence
from pv_inspect.pipeline import inspect_steps
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from pv_inspect.simulate import SimulationSettings, simulated, write_sequence
from pv_inspect.simulate.exposure import camera_matrix, choose_poses

LAYOUTS = (
    *((4, 6, 1.0), (6, 9, 1.0), (6, 10, 1.0), (6, 12, 1.0), (8, 12, 1.0), (5, 8, 1.0)),
    *((10, 6, 1.0), (12, 6, 1.0), (12, 24, 1.0), (4, 9, 1.0), (20, 6, 2.0), (12, 6, 2.0)),
    *((24, 6, 2.0), (6, 20, 0.5), (6, 24, 0.5)),
)
MIN_CELL_PX = 15.0


@dataclass(frozen=True)
class Answer:
    """What one layout came to."""

    seed: int
    true: ModuleLayout
    frames: int
    given: ModuleLayout
    kind: str
    answer: str
    words: str
    wall_s: float
    cpu_s: float


def drawn(seed: int, n_frames: int | None = None) -> SimulationSettings:
    """Draw a module, a view and a camera; frames of at most 640 x 512 px show the whole module."""
    rng = np.random.default_rng([12, seed])
    while True:
        with contextlib.suppress(InspectionError):  # the lens folds this view over: draw again
            return _drawn(rng, seed, n_frames)


def _drawn(rng: np.random.Generator, seed: int, n_frames: int | None) -> SimulationSettings:
    rows, cols, aspect = LAYOUTS[rng.integers(len(LAYOUTS))]
    frames = int(rng.integers(3, 21)) if n_frames is None else n_frames
    wanted = float(np.exp(rng.uniform(np.log(MIN_CELL_PX), np.log(60))))
    settings = SimulationSettings(
        seed=seed,
        rows=rows,
        cols=cols,
        cell_aspect=aspect,
        wafer=str(rng.choice(["multi", "mono"])),
        busbars=int(rng.integers(2, 7)),
        busbar_style=str(rng.choice(["solid", "dashed"])),
        crack_share=float(rng.uniform(0, 0.6)),
        dark_cell_share=float(rng.choice([0.0, 0.02, 0.1, 0.3])),
        n_frames=frames,
        **drawn_view(rng),
        supersampling=3,
        exposure=float(rng.choice([0.3, 0.6, 0.75, 1.3])),
        **drawn_sensor(rng),
    )
    # The focal length goes with the width, so the frame size sets how large the cells come out.
    poses = choose_poses(settings, np.random.default_rng(0))
    camera = Camera(camera_matrix(settings), settings.kappa)
    areas = np.abs(np.linalg.det(camera.jacobian(poses[0].H, settings.layout.crossings())))
    shorter = float(np.sqrt(areas.mean())) / max(aspect, 1.0)
    width = float(np.clip(640 * wanted / shorter, 240, 640))
    ppu = int(np.clip(3.5 * np.sqrt(areas.mean()) * width / 640, 60, 160))
    settings = replace(settings, width=round(width), height=round(0.8 * width), pixels_per_unit=ppu)
    choose_poses(settings, np.random.default_rng(0))
    return settings


def drawn_view(rng: np.random.Generator) -> dict[str, float]:
    """Draw lens, pose, motion and optics."""
    return {
        "kappa": float(rng.uniform(-0.3, 0.3)),
        "tilt_deg": float(rng.uniform(0, 25)),
        "tilt_axis_deg": float(rng.uniform(0, 360)),
        "roll_deg": float(rng.uniform(-30, 30)),
        "fill": float(rng.uniform(0.75, 0.92)),
        "jitter_px": float(rng.uniform(0.5, 4)),
        "motion_blur_px": float(rng.choice([0.3, 1.0, 2.0]) * rng.random()),
        "psf_sigma_px": float(rng.uniform(0.3, 0.7)),
    }


def drawn_sensor(rng: np.random.Generator) -> dict[str, float]:
    """Draw noise, stray light and pattern of the sensor."""
    return {
        "full_well_e": float(np.exp(rng.uniform(np.log(3000), np.log(30000)))),
        "read_noise_e": float(rng.uniform(10, 80)),
        "ambient": float(rng.uniform(0, 0.03)),
        "vignetting": float(rng.uniform(0, 0.25)),
        "column_offset_e": float(rng.uniform(0, 60)),
    }


def wrong_layouts(true: ModuleLayout) -> dict[str, ModuleLayout]:
    """Layouts that someone may give instead of the true one."""
    rows, cols = true.rows, true.cols
    pairs = {f"rows {d:+d}": (rows + d, cols) for d in (-2, -1, 1, 2)}
    pairs |= {f"cols {d:+d}": (rows, cols + d) for d in (-2, -1, 1, 2)}
    pairs |= {
        "swapped": (cols, rows),
        "rows halved": (rows // 2, cols),
        "cols halved": (rows, cols // 2),
        "both halved": (rows // 2, cols // 2),
        "rows doubled": (2 * rows, cols),
        "cols doubled": (rows, 2 * cols),
        "both doubled": (2 * rows, 2 * cols),
    }
    return {
        kind: ModuleLayout(r, c, true.cell_aspect)
        for kind, (r, c) in pairs.items()
        if r > 0 and c > 0 and (r, c) != (rows, cols)
    }


def answered(sequence: FrameSequence, layout: ModuleLayout) -> tuple[str, str]:
    """Run up to the registered frames; return the answer and its words."""
    settings = Settings(rows=layout.rows, cols=layout.cols, cell_aspect=layout.cell_aspect)
    steps = inspect_steps(sequence, settings)
    try:
        for step in steps:
            registration = step.partial
            if isinstance(registration, Registration):
                used = f"{int(registration.used.sum())} of {len(sequence)} frames used"
                warning = quarter_turn_sentence(registration)
                return ("warning", warning) if warning else ("silent", used)
    except InspectionError as error:
        return "refused", str(error)
    finally:
        steps.close()
    return "silent", ""


def trial(
    seed: int, n_frames: int | None, right: bool, kinds: int, cache: Path | None
) -> list[Answer]:
    """Simulate one sequence and give it all layouts."""
    cv2.setNumThreads(1)
    numba.set_num_threads(1)
    made = drawn(seed, n_frames)
    answers = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = (cache or Path(scratch)) / f"seed_{seed}_{made.n_frames}"
        if not (folder / "module.json").exists():
            write_sequence(simulated(made), folder)
        given = {"right": made.layout} if right else {}
        wrong = list(wrong_layouts(made.layout).items())
        first = kinds * seed % len(wrong)
        given |= dict((wrong[first:] + wrong[:first])[:kinds])
        for kind, layout in given.items():
            begun, cpu = perf_counter(), process_time()
            answer, words = answered(FrameSequence.open(folder), layout)
            answers.append(
                Answer(
                    seed,
                    made.layout,
                    made.n_frames,
                    layout,
                    kind,
                    answer,
                    words,
                    perf_counter() - begun,
                    process_time() - cpu,
                )
            )
    return answers


def _row(answer: Answer) -> str:
    true, given = answer.true, answer.given
    return (
        f"{answer.seed:5d} {answer.frames:3d}  {true.rows:2d} x {true.cols:2d} "
        f"({true.cell_aspect:g})  {given.rows:2d} x {given.cols:2d}  {answer.kind:13} "
        f"{answer.answer:8} {answer.wall_s:6.1f} {answer.cpu_s:6.1f}  {answer.words}"
    )


def main() -> int:
    """Print the table; the exit code is 1 if a layout was answered wrongly."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", nargs=2, type=int, default=(0, 30), metavar=("FIRST", "END"))
    parser.add_argument("--frames", type=int, help="per sequence; 3 to 20 by default")
    parser.add_argument("--right", action="store_true", help="the true layout too")
    parser.add_argument(
        "--kinds", type=int, default=99, help="wrong layouts per sequence, others in the next"
    )
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--cache", type=Path, help="folder that keeps the simulated sequences")
    options = parser.parse_args()
    print(
        "seed frames  true           given    kind          answer   wall s  CPU s  words",
        flush=True,
    )
    answers: list[Answer] = []
    # Spawned, not forked: compiled code that has started its threads does not survive a fork.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(options.jobs, mp_context=context) as pool:
        jobs = [
            pool.submit(trial, seed, options.frames, options.right, options.kinds, options.cache)
            for seed in range(*options.seeds)
        ]
        for job in jobs:
            answers += job.result()
            for answer in job.result():
                print(_row(answer), flush=True)
    wrong = [a for a in answers if a.kind != "right"]
    correct = [a for a in answers if a.kind == "right"]
    for name, group in (("wrong", wrong), ("right", correct)):
        if group:
            counts = ", ".join(f"{k} {v}" for k, v in Counter(a.answer for a in group).items())
            wall, cpu = [a.wall_s for a in group], [a.cpu_s for a in group]
            print(
                f"{name} layouts: {counts}; median wall {np.median(wall):.1f} s, CPU "
                f"{np.median(cpu):.1f} s, longest {max(wall):.1f} s, {max(cpu):.1f} s"
            )
    bad = [a for a in wrong if a.answer == "silent"] + [a for a in correct if a.answer != "silent"]
    print(f"answered wrongly: {len(bad)} of {len(answers)}")
    return int(bool(bad))


if __name__ == "__main__":
    raise SystemExit(main())
