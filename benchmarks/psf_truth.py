"""Motion blur and optical sigma that are estimated, against the truth.

    python benchmarks/psf_truth.py --seeds 0 30 [--own-registration] [--images] [--cache FOLDER]
    python benchmarks/psf_truth.py --sequences FOLDER [--only D1 D3] [--frames]

Seeds are simulated cameras, see `psf_draws.py`; half of their scenes are soft. 60 to 119 are to
choose constants on, 0 to 59 and 200 to 229 were looked at: to judge, take others. FOLDER is a
folder of simulated sequences with their truth. The geometry is the true one unless the program's
own is asked for. ``--images`` also reconstructs with the true sigma and prints how much the image
loses against it. At the end: bias, spread, median of the absolute error, the share within 10 %, the
worst.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from psf_draws import drawn_folder
from reconstruction_truth import solve, true_registration

from pv_inspect.geometry.grid import HrGrid
from pv_inspect.pipeline import inspect_steps
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings

# An estimate this near to a limit of the search is one that found nothing, LR px.
LIMITS, NEAR = (0.13, 1.5), 0.03


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--sequences", type=Path)
    parser.add_argument("--only", nargs="*", help="names of sequences")
    parser.add_argument("--seeds", type=int, nargs=2, metavar=("FIRST", "END"))
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "psf_draws")
    parser.add_argument("--own-registration", action="store_true")
    parser.add_argument("--images", action="store_true", help="loss against the true sigma")
    parser.add_argument("--frames", action="store_true", help="every frame as well")
    args = parser.parse_args()
    print(
        "name  sigma (true, kind)       error  moving  true > 1 px  largest error: length [px]  "
        "angle   CPU s   loss dB"
    )
    errors, losses, at_limit = [], [], 0
    for folder in folders(args):
        truth = json.loads((folder / "truth" / "truth.json").read_text())
        sequence = FrameSequence.open(folder)
        if args.own_registration:
            registration = own_registration(sequence, truth)
        else:
            registration = true_registration(truth)
        # Two steps: the PSF is known before the first.
        settings = Settings() if args.images else Settings(max_iterations=2)
        cpu = time.process_time()
        result, _ = solve(sequence, registration, settings)
        cpu = time.process_time() - cpu
        psf, sigma = truth["psf"], result.psf_sigma_lr_px
        errors.append(sigma / psf["sigma"] - 1.0)
        at_limit += not LIMITS[0] + NEAR < sigma < LIMITS[1] - NEAR
        loss = ""
        if args.images:
            best, _ = solve(sequence, registration, settings.changed(psf_sigma_lr_px=psf["sigma"]))
            losses.append(psnr(folder, truth, best) - psnr(folder, truth, result))
            loss = f"{losses[-1]:9.2f}"
        print(
            f"{folder.name:4} {sigma:6.3f} ({psf['sigma']:.3f} {psf['kind']:8}) "
            f"{100 * errors[-1]:+8.1f} % {motion_errors(truth, result)} {cpu:8.1f} {loss}",
            flush=True,
        )
        if args.frames:
            for f, t in zip(result.motion, true_motion(truth), strict=True):
                print(f"     {f[0]:5.2f} px {f[1]:6.1f} deg   true {t[0]:5.2f} px {t[1]:6.1f} deg")
    told(np.array(errors), at_limit)
    if losses:
        print(f"image: loses {np.median(losses):.2f} dB (median), {np.max(losses):.2f} dB (worst)")


def told(errors: np.ndarray, at_limit: int) -> None:
    """Print what all sequences together say."""
    size = np.abs(errors)
    print(
        f"{len(errors)} sequences: bias {100 * np.median(errors):+.1f} %, spread "
        f"{100 * errors.std():.1f} %, median |error| {100 * np.median(size):.1f} %, within 10 % "
        f"{100 * (size <= 0.1).mean():.0f} %, worst {100 * errors[size.argmax()]:+.1f} %, at a "
        f"limit {at_limit}"
    )


def folders(args: argparse.Namespace) -> Iterator[Path]:
    """Folders of the sequences that are asked for."""
    for seed in range(*(args.seeds or (0, 0))):
        yield drawn_folder(seed, args.cache)
    if args.sequences:
        for folder in sorted(p for p in args.sequences.iterdir() if (p / "truth").is_dir()):
            if not args.only or folder.name in args.only:
                yield folder


def own_registration(sequence: FrameSequence, truth: dict[str, Any]) -> Registration:
    """Find the module as the program does."""
    says = {key: truth[key] for key in ("rows", "cols", "cell_aspect")}
    for step in inspect_steps(sequence, Settings(**says)):
        if isinstance(step.partial, Registration):
            return step.partial
    raise SystemExit("no registration")


def true_motion(truth: dict[str, Any]) -> np.ndarray:
    """Length [px] and angle [deg] of the motion of every frame, (n, 2)."""
    return np.array([(f["motion"]["length_px"], f["motion"]["angle_deg"]) for f in truth["frames"]])


def motion_errors(truth: dict[str, Any], result: Reconstruction) -> str:
    """Columns of the table: frames found moving, frames that do, largest errors."""
    found, true = np.array(result.motion), true_motion(truth)
    length = found[:, 0] - true[:, 0]
    angle = (found[:, 1] - true[:, 1] + 90.0) % 180.0 - 90.0
    moving = found[:, 0] > 0
    worst = [float(np.abs(e[moving]).max()) if moving.any() else 0.0 for e in (length, angle)]
    return f"{moving.sum():6d} {(true[:, 0] > 1).sum():12d} {worst[0]:23.2f} {worst[1]:11.1f}"


def psnr(folder: Path, truth: dict[str, Any], result: Reconstruction) -> float:
    """PSNR inside the module against the true scene, with the best gain and offset."""
    says, grid = truth["hr"], result.grid
    scene = cv2.imread(str(folder / "truth" / "hr.png"), cv2.IMREAD_UNCHANGED).astype(np.float32)
    true, inside = on_grid(scene, says, grid)
    a, b = result.image[inside].astype(np.float64), true[inside].astype(np.float64)
    gain, offset = np.polyfit(a, b, 1)
    peak = float(np.percentile(b, 99.9))
    return float(10 * np.log10(peak**2 / np.mean((gain * a + offset - b) ** 2)))


def on_grid(scene: np.ndarray, says: dict[str, Any], grid: HrGrid) -> tuple[np.ndarray, np.ndarray]:
    """Mean of the scene over the pixels of a result's grid; which of them show the module."""
    x, y = np.meshgrid(np.arange(grid.shape[1]), np.arange(grid.shape[0]))
    module = grid.to_module(np.stack([x, y], axis=-1).astype(np.float64))
    px = (module * says["px_per_unit"] + says["origin_px"]).astype(np.float32)
    side = max(round(says["px_per_unit"] / grid.pixels_per_unit), 1)
    smooth = cv2.blur(scene, (side, side))
    # An even box has its middle between two pixels.
    px += np.float32(0.5 * (1 - side % 2))
    true = cv2.remap(smooth, px[..., 0], px[..., 1], cv2.INTER_LINEAR)
    width, height = grid.layout.size
    return true, np.all((module >= 0) & (module <= [width, height]), axis=-1)


if __name__ == "__main__":
    main()
