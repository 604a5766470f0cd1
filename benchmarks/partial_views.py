"""Sequences of overlapping views each of which cuts the module, simulated.

    python benchmarks/partial_views.py [--seeds 0 12] [--frames 12] [--hidden]

The camera goes over modules of 3 x 6 to 6 x 12 cells in rows, so near that no frame shows all of
one. The run, up to the registered frames, is told rows and columns. "right" is one whose crossing
points lie within 0.15 LR px (RMS) of the truth where frames show them, and whose frames in use
show all of the module; "in doubt" one that says that the layout does not fit, or names the cells
that are missing; "silent" one that is wrong without a word. With --hidden a part of the module is
in no frame: those must be refused, and whether the reason is the true one is to be read.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from pathlib import Path
from time import process_time

import cv2
import numpy as np
from drone_draws import drawn_module, made, rms_px, shown
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.inspection.coverage import unseen_sentence
from pv_inspect.pipeline import inspect_steps
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from pv_inspect.simulate import SimulationSettings, write_sequence
from pv_inspect.simulate.exposure import Pose

MOST_RMS_PX = 0.15
SHOWN_BEYOND = 0.25
"""So far around the module the views show all, cells: where it ends must be seen."""
LEAST_HIDDEN = 0.01
OVERLAP = 4.0
"""Cells that two views must both show to count as overlapping."""
Array = NDArray[np.float64]


def turned(axis_angle: Array) -> Array:
    """Rotation matrix of an axis times an angle."""
    return np.asarray(cv2.Rodrigues(np.asarray(axis_angle, np.float64))[0])


def drawn(
    seed: int, n_frames: int, hidden: bool = False
) -> tuple[SimulationSettings, tuple[Pose, ...]]:
    """Draw a module, a camera, and views in rows over the module, each of a part of it.

    They overlap, and together they show all of the module and the dark around it; or not all of the
    module if `hidden`.
    """
    rng = np.random.default_rng([1402, seed])
    settings = drawn_module(seed, rng, n_frames, (-0.2, 0.05), tilted=False)
    while True:
        poses = _views(settings, rng, (-1.0, -0.2) if hidden else (0.3, 0.8))
        missing = [
            1 - np.any([shown(settings, pose, beyond) for pose in poses], axis=0).mean()
            for beyond in (0.0, SHOWN_BEYOND)
        ]
        whole = not missing[1] and _overlap(settings, poses)
        if missing[0] > LEAST_HIDDEN if hidden else whole:
            return settings, poses


def _overlap(settings: SimulationSettings, poses: tuple[Pose, ...]) -> bool:
    """Whether each view shows some cells that another one shows, and all hang together."""
    seen = np.array([shown(settings, pose).ravel() for pose in poses], float)
    cells = settings.rows * settings.cols * (seen @ seen.T) / seen.shape[1]
    together, count = np.arange(len(poses)) == 0, 0
    while count < together.sum():
        count = together.sum()
        together = (cells[together] >= OVERLAP).any(axis=0)
    return bool(together.all())


def _views(
    settings: SimulationSettings, rng: np.random.Generator, reach: tuple[float, float]
) -> tuple[Pose, ...]:
    """Draw views that reach so many cells beyond the module."""
    n_frames = settings.n_frames
    size = np.array(settings.layout.size)
    frame = np.array([settings.width, settings.height])
    # So many cells are seen along the sides of the frame.
    seen_x = float(rng.uniform(0.55, 0.8)) * size[0]
    per_unit = float(np.clip(frame[0] / seen_x, 28, 90))
    seen = frame / per_unit
    roll = np.radians(rng.uniform(-6, 6))
    tilt = np.radians(rng.uniform(0, 15)) * turned([0, 0, rng.uniform(0, 6.28)])[:, 0]
    rotation = turned(np.array([0, 0, roll])) @ turned(tilt)
    beyond = float(rng.uniform(*reach))
    low, high = seen / 2 - beyond, size - seen / 2 + beyond
    low, high = np.minimum(low, size / 2), np.maximum(high, size / 2)
    lines = 1 if high[1] - low[1] < 0.3 * seen[1] else (2 if seen[1] > 0.55 * size[1] else 3)
    along = -(-n_frames // lines)
    poses = []
    for k in range(n_frames):
        row, col = divmod(k, along)
        share = np.array(
            [col / max(along - 1, 1), row / (lines - 1) if lines > 1 else rng.uniform(0, 1)]
        )
        if row % 2:
            share[0] = 1 - share[0]
        at = low + share * (high - low) + rng.normal(0, 0.08, 2)
        R = turned(np.radians(rng.normal(0, 0.5, 3))) @ rotation
        depth = settings.focal_px / per_unit * (1 + rng.normal(0, 0.01))
        H = np.column_stack([R[:, :2], np.array([0, 0, depth]) - R[:, :2] @ at])
        poses.append(Pose(H, 1 + 0.015 * rng.normal(), 0.3 * rng.random(), 180 * rng.random()))
    return tuple(poses)


def trial(seed: int, n_frames: int, hidden: bool) -> tuple[str, str]:
    """Simulate and register one sequence; return the answer and what there is to say."""
    true = made(*drawn(seed, n_frames, hidden))
    rows, cols = true.settings.rows, true.settings.cols
    begun = process_time()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "sequence"
        write_sequence(true, folder)
        (folder / "module.json").unlink()
        sequence = FrameSequence.open(folder)
        steps = inspect_steps(sequence, Settings(rows=rows, cols=cols))
        try:
            registration = next(
                step.partial for step in steps if isinstance(step.partial, Registration)
            )
        except InspectionError as error:
            return "refused", f"{rows} x {cols}  {error}"
        finally:
            steps.close()
    rms = rms_px(registration, true)
    used = int(registration.used.sum())
    words = f"{rows} x {cols}  {used} of {n_frames} used  {rms:.3f} px"
    reasons = " | ".join(sorted({why for why in registration.why if why}))
    views = [
        shown(true.settings, pose)
        for pose, u in zip(true.poses, registration.used, strict=True)
        if u
    ]
    missing = 1 - np.any(views, axis=0).mean()
    if missing:
        words += f", {100 * missing:.1f} % of the module in none of them"
    unseen = unseen_sentence(registration, sequence.shape)
    answer = "right" if rms <= MOST_RMS_PX and not missing else "silent"
    # That cells are missing does not say that the others lie elsewhere.
    if registration.misfit or (unseen and rms <= MOST_RMS_PX):
        answer, words = "in doubt", f"{words}  {registration.misfit} {unseen}"
    return answer, f"{words}  {process_time() - begun:.0f} s  {reasons}"


def main() -> int:
    """Print one line per sequence; the exit code is 1 if one was wrong without a word."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", nargs=2, type=int, default=(0, 12), metavar=("FIRST", "END"))
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--hidden", action="store_true")
    args = parser.parse_args()
    answers: list[str] = []
    for seed in range(*args.seeds):
        answer, words = trial(seed, args.frames, args.hidden)
        answers.append(answer)
        print(f"{seed:4d}  {answer:8s} {words}", flush=True)
    print(", ".join(f"{n} {answer}" for answer, n in Counter(answers).items()))
    return int("silent" in answers)


if __name__ == "__main__":
    raise SystemExit(main())
