"""Sequences in which the border of half of the frames cuts the module, simulated.

    python benchmarks/frames_that_cut.py [--seeds 0 6] [--frames 12]

A drone over modules of 3 x 6 to 6 x 12 cells: in every second frame 10 to 45 % of the module lie
outside, on one or two sides. The whole run is told rows and columns. Printed are the frames that
were used, the RMS distance of the crossing points from the truth where frames show them, and the
PSNR of the module image beside that of a run of the frames that show the whole module. A sequence
passes if at most one frame is left out and its PSNR is the higher one.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path
from time import process_time

import cv2
import numpy as np
from demo import inside, psnr
from drone_draws import drawn_module, made, rms_px, shown

from pv_inspect.errors import InspectionError
from pv_inspect.pipeline import inspect_steps
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from pv_inspect.simulate import SimulatedSequence, SimulationSettings, write_sequence
from pv_inspect.simulate.exposure import Pose, choose_poses

MAGNIFICATION = 3.0


def drawn(seed: int, n_frames: int) -> tuple[SimulationSettings, tuple[Pose, ...]]:
    """Draw a module, a camera and views, every second of which cuts the module."""
    rng = np.random.default_rng([1403, seed])
    settings = drawn_module(seed, rng, n_frames, (-0.15, 0.05), tilted=True)
    poses = list(choose_poses(settings, rng))
    for k in range(1, n_frames, 2):
        poses[k] = _beside(settings, poses[k], rng)
    return settings, tuple(poses)


def _beside(settings: SimulationSettings, pose: Pose, rng: np.random.Generator) -> Pose:
    """Move the camera so that a part of the module is cut."""
    while True:
        shift = rng.uniform(-0.6, 0.6, 2) * [settings.width, settings.height]
        if rng.random() < 0.6:
            shift[int(rng.integers(2))] = 0.0
        H = pose.H.copy()
        H[:2, 2] += shift / settings.focal_px * H[2, 2]
        moved = replace(pose, H=H)
        if 0.55 < shown(settings, moved).mean() < 0.9:
            return moved


def answered(true: SimulatedSequence, chosen: list[int]) -> tuple[Registration, float]:
    """Run some of the frames to the module image; return the registration and the PSNR."""
    poses, frames = tuple(true.poses[k] for k in chosen), true.frames[chosen]
    some = replace(true, poses=poses, frames=frames)
    settings = Settings(
        rows=true.settings.rows, cols=true.settings.cols, magnification=MAGNIFICATION
    )
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "sequence"
        write_sequence(some, folder)
        (folder / "module.json").unlink()
        steps = inspect_steps(FrameSequence.open(folder), settings)
        try:
            for step in steps:
                if isinstance(step.partial, Registration):
                    registration = step.partial
                if isinstance(step.partial, Reconstruction):
                    return registration, _psnr(true, step.partial)
        finally:
            steps.close()
    raise AssertionError("no reconstruction")


def _psnr(true: SimulatedSequence, result: Reconstruction) -> float:
    grid, scene = result.grid, true.scene
    y, x = np.mgrid[: grid.shape[0], : grid.shape[1]].astype(np.float64)
    at = grid.to_module(np.stack([x, y], axis=-1)) * scene.pixels_per_unit
    at = (at + np.array(scene.origin_px)).astype(np.float32)
    soft = cv2.GaussianBlur(
        scene.radiance, (0, 0), 0.5 * scene.pixels_per_unit / grid.pixels_per_unit
    )
    image = inside(grid, result.image)
    truth = inside(grid, cv2.remap(soft, at[..., 0], at[..., 1], cv2.INTER_LINEAR))
    return max(psnr(image, t, grid.pixels_per_unit) for t in (truth, truth[::-1, ::-1]))


def trial(seed: int, n_frames: int) -> tuple[bool, str]:
    """Run one sequence and its whole frames alone; return whether it passes, and words."""
    true = made(*drawn(seed, n_frames))
    words = f"{true.settings.rows} x {true.settings.cols}"
    begun = process_time()
    try:
        registration, together = answered(true, list(range(n_frames)))
        _, alone = answered(true, list(range(0, n_frames, 2)))
    except InspectionError as error:
        return False, f"{words}  {error}"
    used = int(registration.used.sum())
    reasons = " | ".join(f"{k}: {why}" for k, why in enumerate(registration.why) if why)
    return used >= n_frames - 1 and together > alone, (
        f"{words}  {used} of {n_frames} used  {rms_px(registration, true):.3f} px  "
        f"{together:.2f} dB, whole ones alone {alone:.2f} dB  "
        f"{process_time() - begun:.0f} s  {reasons}"
    )


def main() -> int:
    """Print one line per sequence; the exit code is 1 if one does not pass."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", nargs=2, type=int, default=(0, 6), metavar=("FIRST", "END"))
    parser.add_argument("--frames", type=int, default=12)
    args = parser.parse_args()
    passed = 0
    for seed in range(*args.seeds):
        good, words = trial(seed, args.frames)
        passed += good
        print(f"{seed:4d}  {'pass' if good else 'FAIL'}  {words}", flush=True)
    count = len(range(*args.seeds))
    print(f"{passed} of {count} pass")
    return int(passed < count)


if __name__ == "__main__":
    raise SystemExit(main())
