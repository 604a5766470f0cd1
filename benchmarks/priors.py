"""The priors of Eq. 7 against each other: same frames, geometry, blur and solver.

    python benchmarks/priors.py SEQUENCES SCORER [--only D4 D6] [--magnification 3]
        [--priors learned sparse_curvature wbtv btv tikhonov] [--octaves 3] [--thresholds]

SEQUENCES is a folder of simulated sequences with their truth, SCORER the folder that holds
score_sequence.py. The geometry comes from the truth; the blur, the motion and the sensor are as a
run with the default prior estimates them, the same for all priors. For each prior: lambda as a run
would choose it, the best of a sweep over factors of two around it, their PSNR (aligned_flat) in dB,
and steps and CPU seconds of the solve with the automatic lambda. ``--thresholds`` prints how the
threshold of the weights moves from round to round instead.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from reconstruction_truth import load_scorer, score, true_registration

from pv_inspect.common.work import result_of
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.observation.motion_blur import motion_of
from pv_inspect.reconstruction.accumulation import Accumulation
from pv_inspect.reconstruction.held_out import View, cut_view
from pv_inspect.reconstruction.prior import PriorName
from pv_inspect.reconstruction.prior_weight import Trial, choose_prior_weight, windows_of
from pv_inspect.reconstruction.reconstruct import reconstruct, solve
from pv_inspect.reconstruction.reconstruction import Reconstruction, brightness_of
from pv_inspect.reconstruction.solver import Problem, first_guess, minimise
from pv_inspect.reconstruction.total_variation import WeightedBtv
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings

PRIORS: tuple[PriorName, ...] = ("learned", "sparse_curvature", "wbtv", "btv", "tikhonov")


@dataclass(frozen=True, eq=False)
class Prepared:
    """All frames in the normal equations, and what they show of the windows for lambda."""

    data: Accumulation
    trials: list[Trial]
    start: np.ndarray


def prepared(sequence: FrameSequence, registration: Registration, made: Reconstruction) -> Prepared:
    """Let all frames enter as the second pass of a run does."""
    motion = np.array([motion_of(*m) for m in made.motion])
    rays = SensorRays.of(registration.camera, sequence.shape)
    data = Accumulation.begin(
        sequence,
        registration,
        made.grid,
        rays,
        made.psf_sigma_lr_px,
        motion,
        made.photometry,
        made.image,
    )
    windows = windows_of(made.grid)
    views: list[list[View]] = [[] for _ in windows]
    for i in np.flatnonzero(registration.used):
        g, weights = data.add(int(i))
        H, grain = registration.homographies[i], sequence.noise.grain_px
        for window, seen in zip(windows, views, strict=True):
            view = cut_view(registration.camera, H, rays, window, g, weights, motion[i], grain)
            if view is not None:
                seen.append(view)
    trials = [Trial(window, tuple(seen)) for window, seen in zip(windows, views, strict=True)]
    return Prepared(data, trials, first_guess(data.equations))


def thresholds(ready: Prepared, grid: HrGrid, weight: float) -> list[float]:
    """Threshold of the weights after every round, units of the contrast."""
    problem = Problem(ready.data.equations, weight, brightness_of(ready.start, grid), "wbtv")
    seen: list[float] = []
    for state in minimise(problem, ready.start, 100, 0.0, spectral=True):
        prior = state.problem.prior
        assert isinstance(prior, WeightedBtv)
        if not seen or seen[-1] != prior.threshold:
            seen.append(prior.threshold)
    return seen


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("sequences", type=Path)
    parser.add_argument("scorer", type=Path)
    parser.add_argument("--only", nargs="*", help="names of sequences")
    parser.add_argument("--magnification", type=float, default=3.0)
    parser.add_argument("--priors", nargs="*", choices=PRIORS, default=PRIORS)
    parser.add_argument("--octaves", type=int, default=3, help="lambdas to each side")
    parser.add_argument("--thresholds", action="store_true")
    args = parser.parse_args()
    scorer = load_scorer(args.scorer)
    print(
        "name  prior             automatic lambda, PSNR   best lambda, PSNR    steps  conv  CPU s"
    )
    for folder in sorted(p for p in args.sequences.iterdir() if (p / "truth").is_dir()):
        if args.only and folder.name not in args.only:
            continue
        truth = json.loads((folder / "truth" / "truth.json").read_text())
        sequence, registration = FrameSequence.open(folder), true_registration(truth)
        settings = Settings(magnification=args.magnification)
        made = result_of(reconstruct(sequence, registration, settings))
        ready = prepared(sequence, registration, made)
        for prior in args.priors:
            choice = choose_prior_weight(
                registration.camera, ready.trials, made.psf_sigma_lr_px, prior
            )
            automatic, _ = result_of(choice)
            if args.thresholds:
                told = thresholds(ready, made.grid, automatic)
                print(f"{folder.name:5} thresholds {', '.join(f'{t:.3g}' for t in told)}")
                continue
            with_prior = settings.changed(prior=prior)
            scores = {}
            for octave in (0, *range(-args.octaves, 0), *range(1, args.octaves + 1)):
                weight = automatic * 2.0**octave
                cpu = time.process_time()
                result = result_of(solve(ready.data, ready.start, weight, with_prior))
                cpu = time.process_time() - cpu
                flat = score(scorer, folder, result.image, result.grid)["aligned_flat"]
                scores[weight] = flat["psnr_db"]
                if not octave:
                    first, first_cpu = result, cpu
            best = max(scores, key=lambda weight: scores[weight])
            print(
                f"{folder.name:5} {prior:17} {automatic:8.3g} {scores[automatic]:14.2f} "
                f"{best:13.3g} {scores[best]:8.2f} {first.iterations:8d} "
                f"{first.converged!s:>6} {first_cpu:6.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
