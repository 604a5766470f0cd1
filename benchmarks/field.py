"""Crossing points of the central module on field photographs, against their truth.

    python benchmarks/field.py FOLDER [--guess]

FOLDER holds photographs and a ``truth.json`` with rows, cols and crossings_px of every one. Each
photograph is detected on its own, as a sequence of one frame; with ``--guess`` without being told
the rows and columns.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from pv_inspect.detection.detect import detect
from pv_inspect.detection.layout_guess import guess_layout
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.progress.follow import follow
from pv_inspect.sequence.sequence import FrameSequence

MUST_PX = 2.0


def main() -> None:
    """Print the error per photograph, and how many are good."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--guess", action="store_true", help="do not tell the rows and columns")
    arguments = parser.parse_args()
    truth = json.loads((arguments.folder / "truth.json").read_text(encoding="utf-8"))
    photos = truth["images"]
    good = sum(_report(arguments.folder, photo, arguments.guess) for photo in photos)
    print(f"all crossings within {MUST_PX:g} px: {good} of {len(photos)}")


def _report(folder: Path, photo: dict[str, Any], guess: bool) -> bool:
    begun = process_time()
    try:
        sequence = FrameSequence.open([folder / photo["file"]])
        layout = ModuleLayout(photo["rows"], photo["cols"])
        if guess:
            layout = guess_layout(sequence).layout
        frame = follow(detect(sequence, layout), "detecting", quiet=True).frames[0]
    except InspectionError as error:
        print(f"{photo['file']}  not found: {error}")
        return False
    seconds = process_time() - begun
    true = np.array(photo["crossings_px"])
    name = f"{photo['file']}  {layout.rows} x {layout.cols}"
    if len(true) != len(frame.points_px):
        print(f"{name}  wrong rows and columns, {photo['rows']} x {photo['cols']} in truth")
        return False
    # The module looks the same turned by half a turn.
    error = min(
        (np.linalg.norm(frame.points_px[::way] - true, axis=1) for way in (1, -1)),
        key=lambda distance: float(distance.max()),
    )
    print(
        f"{name}  median {np.median(error):.3f}  max {error.max():.3f} px"
        f"  measured {frame.measured.mean():.0%}  {seconds:.2f} s"
    )
    return bool(error.max() <= MUST_PX)


if __name__ == "__main__":
    main()
