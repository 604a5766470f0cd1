"""Quality and cost of the reconstruction alone: the geometry comes from the truth.

    python benchmarks/reconstruction_truth.py SEQUENCES SCORER [--only D4 D6] [--magnification 4]

SEQUENCES is a folder of simulated sequences with their truth, SCORER the folder that holds
score_sequence.py. Prints PSNR (aligned_flat) of bicubic and of the reconstruction, the PSF that was
estimated, CPU and wall seconds without compilation, and the peak memory of the process.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import resource
import sys
import tempfile
import time
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import tifffile

from pv_inspect.common.work import result_of
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.reconstruction.reconstruct import reconstruct
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.reconstruction.single_frame import bicubic
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings


def true_registration(truth: dict[str, Any]) -> Registration:
    """Registration out of truth.json; vignetting stays unknown, as it is in a real run."""
    frames = truth["frames"]
    H = np.array([np.eye(3) if f["H"] is None else f["H"] for f in frames], dtype=np.float64)
    n = len(frames)
    return Registration(
        ModuleLayout(truth["rows"], truth["cols"], truth["cell_aspect"]),
        Camera(np.array(truth["K"]), truth["kappa"]),
        H,
        np.array([f["valid"] for f in frames]),
        tuple(f["reason"] or "" for f in frames),
        np.array([f["gain"] for f in frames]),
        np.zeros(n),
        np.ones(n),
    )


def load_scorer(folder: Path) -> ModuleType:
    """Import score_sequence.py from where it lies."""
    spec = importlib.util.spec_from_file_location("score_sequence", folder / "score_sequence.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def score(scorer: ModuleType, folder: Path, image: np.ndarray, grid: HrGrid) -> dict[str, Any]:
    """Write the part of a result that the scorer reads, with the true crossings, and score it."""
    truth = json.loads((folder / "truth" / "truth.json").read_text())
    frames = [{k: f[k] for k in ("file", "crossings_px")} for f in truth["frames"] if f["valid"]]
    with tempfile.TemporaryDirectory() as out:
        tifffile.imwrite(Path(out) / "module_hr.tif", image)
        (Path(out) / "result.json").write_text(json.dumps({**grid.to_dict(), "frames": frames}))
        scores: dict[str, Any] = scorer.score(str(folder), out)["hr"]
        return scores


def solve(
    sequence: FrameSequence, registration: Registration, settings: Settings
) -> tuple[Reconstruction, int]:
    """Drain reconstruct() and count its solver steps."""
    images: list[bool] = []
    made = result_of(
        reconstruct(sequence, registration, settings),
        lambda progress: images.append(progress.image is not None),
    )
    return made, sum(images)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("sequences", type=Path)
    parser.add_argument("scorer", type=Path)
    parser.add_argument("--only", nargs="*", help="names of sequences")
    parser.add_argument("--magnification", type=float, default=4.0)
    parser.add_argument("--prior-weight", type=float, nargs="*", help="lambda, several to sweep")
    parser.add_argument("--sigma", choices=["estimate", "true"], default="estimate")
    args = parser.parse_args()
    scorer = load_scorer(args.scorer)
    folders = sorted(p for p in args.sequences.iterdir() if (p / "truth").is_dir())
    weights = args.prior_weight or [None]
    print(
        "name  lambda  sigma (true)   bicubic   PSNR  gain   raw   FRC  steps conv CPU s wall s GiB"
    )
    compiled = False
    for folder in folders:
        if args.only and folder.name not in args.only:
            continue
        truth = json.loads((folder / "truth" / "truth.json").read_text())
        sequence, registration = FrameSequence.open(folder), true_registration(truth)
        sigma = truth["psf"]["sigma"] if args.sigma == "true" else None
        settings = Settings(magnification=args.magnification, psf_sigma_lr_px=sigma)
        if not compiled:
            solve(sequence, registration, settings.changed(magnification=1, max_iterations=2))
            compiled = True
        baseline = None
        for weight in weights:
            cpu, wall = time.process_time(), time.perf_counter()
            result, steps = solve(sequence, registration, settings.changed(prior_weight=weight))
            cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
            if baseline is None:
                frame = int(np.flatnonzero(registration.used)[registration.used.sum() // 2])
                image = bicubic(sequence, registration, result.grid, frame)
                baseline = score(scorer, folder, image, result.grid)["aligned_flat"]["psnr_db"]
            hr = score(scorer, folder, result.image, result.grid)
            flat = hr["aligned_flat"]["psnr_db"]
            print(
                f"{folder.name:4} {result.prior_weight:7.3g} {result.psf_sigma_lr_px:6.3f} "
                f"({truth['psf']['sigma']:.2f}) {baseline:8.2f} {flat:8.2f} {flat - baseline:5.2f} "
                f"{hr['raw']['psnr_db']:6.2f} {hr['frc_cutoff']:5.2f} {steps:4d} "
                f"{result.converged!s:6} {cpu:5.1f} {wall:6.1f} {peak:.2f}",
                flush=True,
            )


if __name__ == "__main__":
    sys.exit(main())
