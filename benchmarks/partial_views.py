"""Sequences of overlapping views each of which cuts the module, simulated.

    python benchmarks/partial_views.py [--seeds 0 12] [--frames 12]

The camera goes over modules of 3 x 6 to 6 x 12 cells in rows, so near that no frame shows all of
one. The run, up to the registered frames, is told rows and columns. "right" is one whose crossing
points lie within 0.15 LR px (RMS) of the truth where frames show them, "silent" one that is wrong
without a word.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from pathlib import Path
from time import process_time

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.work import result_of
from pv_inspect.errors import InspectionError
from pv_inspect.pipeline import inspect_steps
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from pv_inspect.simulate import SimulatedSequence, SimulationSettings, write_sequence
from pv_inspect.simulate.exposure import Exposer, Pose, Sensor
from pv_inspect.simulate.scene import render_scene

MOST_RMS_PX = 0.15
Array = NDArray[np.float64]


def turned(axis_angle: Array) -> Array:
    """Rotation matrix of an axis times an angle."""
    return np.asarray(cv2.Rodrigues(np.asarray(axis_angle, np.float64))[0])


def drawn(seed: int, n_frames: int) -> tuple[SimulationSettings, tuple[Pose, ...]]:
    """Draw a module, a camera, and views in rows over the module, each of a part of it."""
    rng = np.random.default_rng([1402, seed])
    rows, cols = ((3, 6), (4, 6), (6, 6), (6, 10), (6, 12), (5, 9))[int(rng.integers(6))]
    settings = SimulationSettings(
        seed=seed, rows=rows, cols=cols, n_frames=n_frames, width=400, height=320,
        wafer=str(rng.choice(["multi", "mono"])), busbars=int(rng.integers(2, 7)),
        busbar_style=str(rng.choice(["solid", "dashed"])),
        crack_share=float(rng.uniform(0, 0.5)), dark_cell_share=float(rng.choice([0.0, 0.03])),
        kappa=float(rng.uniform(-0.2, 0.05)), psf_sigma_px=float(rng.uniform(0.4, 0.7)),
        exposure=float(rng.choice([0.4, 0.7])), pixels_per_unit=150, supersampling=3,
    )  # fmt: skip
    size = np.array(settings.layout.size)
    frame = np.array([settings.width, settings.height])
    # So many cells are seen along the sides of the frame.
    seen_x = float(rng.uniform(0.55, 0.8)) * size[0]
    per_unit = float(np.clip(frame[0] / seen_x, 28, 90))
    seen = frame / per_unit
    roll = np.radians(rng.uniform(-6, 6))
    tilt = np.radians(rng.uniform(0, 15)) * turned([0, 0, rng.uniform(0, 6.28)])[:, 0]
    rotation = turned(np.array([0, 0, roll])) @ turned(tilt)
    beyond = float(rng.uniform(0.3, 0.8))
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
    return settings, tuple(poses)


def made(settings: SimulationSettings, poses: tuple[Pose, ...]) -> SimulatedSequence:
    """Expose the drawn views."""
    module, pattern, noise = np.random.default_rng(settings.seed).spawn(3)
    scene = result_of(render_scene(settings, module))
    exposer, sensor = Exposer(settings, scene), Sensor(settings, pattern)
    frames = [sensor.digitise(exposer.expose(pose), pose.gain, noise) for pose in poses]
    return SimulatedSequence(settings, scene, poses, np.array(frames))


def rms_px(registration: Registration, true: SimulatedSequence) -> float:
    """RMS distance of the crossing points from the truth, where frames show them."""
    squares = []
    last = np.array([true.settings.width, true.settings.height]) - 1
    for i in np.flatnonzero(registration.used):
        wanted = true.crossings_px(int(i))
        shown = np.all((wanted >= 0) & (wanted <= last), axis=1)
        points = registration.crossings_px(int(i))
        ways = (np.square(p - wanted)[shown].sum(axis=1).mean() for p in (points, points[::-1]))
        squares.append(min(ways))
    return float(np.sqrt(np.mean(squares)))


def trial(seed: int, n_frames: int) -> tuple[str, str]:
    """Simulate and register one sequence; return the answer and what there is to say."""
    true = made(*drawn(seed, n_frames))
    rows, cols = true.settings.rows, true.settings.cols
    begun = process_time()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "sequence"
        write_sequence(true, folder)
        (folder / "module.json").unlink()
        steps = inspect_steps(FrameSequence.open(folder), Settings(rows=rows, cols=cols))
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
    answer = "right" if rms <= MOST_RMS_PX else "silent"
    return answer, f"{words}  {process_time() - begun:.0f} s  {reasons}"


def main() -> int:
    """Print one line per sequence; the exit code is 1 if one was wrong without a word."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", nargs=2, type=int, default=(0, 12), metavar=("FIRST", "END"))
    parser.add_argument("--frames", type=int, default=12)
    args = parser.parse_args()
    answers: list[str] = []
    for seed in range(*args.seeds):
        answer, words = trial(seed, args.frames)
        answers.append(answer)
        print(f"{seed:4d}  {answer:8s} {words}", flush=True)
    print(", ".join(f"{n} {answer}" for answer, n in Counter(answers).items()))
    return int("silent" in answers)


if __name__ == "__main__":
    raise SystemExit(main())
