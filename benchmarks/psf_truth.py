"""Motion blur and optical sigma that are estimated, against the truth; true geometry.

    python benchmarks/psf_truth.py SEQUENCES [--only D1 D3] [--frames]

SEQUENCES is a folder of simulated sequences with their truth.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
from reconstruction_truth import solve, true_registration

from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("sequences", type=Path)
    parser.add_argument("--only", nargs="*", help="names of sequences")
    parser.add_argument("--frames", action="store_true", help="every frame as well")
    args = parser.parse_args()
    print("name  sigma (true)   moving  true > 1 px  largest error: length [px]  angle   CPU s")
    for folder in sorted(p for p in args.sequences.iterdir() if (p / "truth").is_dir()):
        if args.only and folder.name not in args.only:
            continue
        truth = json.loads((folder / "truth" / "truth.json").read_text())
        cpu = time.process_time()
        # Two steps: the PSF is known before the first.
        result, _ = solve(
            FrameSequence.open(folder), true_registration(truth), Settings(max_iterations=2)
        )
        cpu = time.process_time() - cpu
        found = np.array(result.motion)
        true = np.array(
            [(f["motion"]["length_px"], f["motion"]["angle_deg"]) for f in truth["frames"]]
        )
        length = found[:, 0] - true[:, 0]
        angle = (found[:, 1] - true[:, 1] + 90.0) % 180.0 - 90.0
        moving = found[:, 0] > 0
        worst = [float(np.abs(e[moving]).max()) if moving.any() else 0.0 for e in (length, angle)]
        print(
            f"{folder.name:4} {result.psf_sigma_lr_px:6.3f} ({truth['psf']['sigma']:.2f}) "
            f"{moving.sum():6d} {(true[:, 0] > 1).sum():12d} {worst[0]:23.2f} {worst[1]:11.1f} "
            f"{cpu:9.1f}",
            flush=True,
        )
        if args.frames:
            for f, t in zip(found, true, strict=True):
                print(f"     {f[0]:5.2f} px {f[1]:6.1f} deg   true {t[0]:5.2f} px {t[1]:6.1f} deg")


if __name__ == "__main__":
    main()
