"""What `make demo` runs: the main job on the sample, its quality against the sample's truth.

python benchmarks/demo.py [--no-window] [--out demo_result] [--sequence sample_data/module]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.pipeline import inspect_steps
from pv_inspect.progress.follow import follow
from pv_inspect.reconstruction.single_frame import bicubic
from pv_inspect.results.write import check_writable, write_result
from pv_inspect.sequence.sequence import FrameSequence

ROOT = Path(__file__).resolve().parents[1]
Image = NDArray[np.float64]


def area_means(image: Image, edges: Image, axis: int) -> Image:
    """Mean of an image of square pixels between neighbouring edges (pixel 0 spans -0.5 to 0.5)."""
    moved = np.moveaxis(image, axis, 0)
    integral = np.concatenate([np.zeros((1, *moved.shape[1:])), np.cumsum(moved, 0)])
    at = np.clip(edges + 0.5, 0, len(moved))
    below = np.minimum(at.astype(int), len(moved) - 1)
    share = (at - below)[:, None]
    total = integral[below] * (1 - share) + integral[below + 1] * share
    width = np.maximum(np.diff(at), 1e-9)[:, None]
    return np.asarray(np.moveaxis(np.diff(total, axis=0) / width, 0, axis))


def truth_on_grid(folder: Path, grid: HrGrid) -> Image:
    """True radiance, area-filtered to the pixels of the cells of a result grid."""
    about = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["hr"]
    image = cv2.imread(str(folder / about["file"]), cv2.IMREAD_UNCHANGED).astype(np.float64)
    scale = about["px_per_unit"] / grid.pixels_per_unit
    size = inside(grid, np.zeros(grid.shape)).shape
    for axis in (0, 1):
        origin = about["origin_px"][1 - axis]
        image = area_means(image, origin + scale * np.arange(size[axis] + 1), axis)
    return image


def inside(grid: HrGrid, image: NDArray[np.floating]) -> Image:
    """The pixels of all cells, without the margin."""
    first = grid.cell_slices(0, 0)
    last = grid.cell_slices(grid.layout.rows - 1, grid.layout.cols - 1)
    part = image[first[0].start : last[0].stop, first[1].start : last[1].stop]
    return np.asarray(part, np.float64)


def psnr(image: Image, truth: Image, cell_px: float) -> float:
    """PSNR in dB after a fit of gain and offset; vignetting, wider than a cell, does not count."""

    def slow(a: Image) -> Image:
        size = (max(a.shape[1] // 8, 1), max(a.shape[0] // 8, 1))
        small = cv2.GaussianBlur(
            cv2.resize(a, size, interpolation=cv2.INTER_AREA), (0, 0), cell_px / 16
        )
        return np.asarray(cv2.resize(small, a.shape[::-1]))

    even = image * slow(truth) / np.maximum(slow(image), 0.05 * np.median(image))
    design = np.column_stack([even.ravel(), np.ones(even.size)])
    gain, offset = np.linalg.lstsq(design, truth.ravel(), rcond=None)[0]
    error = np.mean((gain * even + offset - truth) ** 2)
    return float(10 * np.log10(np.percentile(truth, 99.9) ** 2 / error))


def qualities(inspection: Inspection, truth_folder: Path) -> tuple[float, float]:
    """PSNR of the result, and of the best single frame rectified by bicubic interpolation."""
    registration, reconstruction = inspection.registration, inspection.reconstruction
    assert registration is not None
    assert reconstruction is not None
    grid = reconstruction.grid
    truth = truth_on_grid(truth_folder, grid)
    image = inside(grid, reconstruction.image)
    # A module looks the same when turned by 180 degrees: either way up is right.
    ours, truth = max(
        ((psnr(image, t, grid.pixels_per_unit), t) for t in (truth, truth[::-1, ::-1])),
        key=lambda pair: pair[0],
    )
    frames = (
        inside(grid, bicubic(inspection.sequence, registration, grid, int(i)))
        for i in np.flatnonzero(registration.used)
    )
    return ours, max(psnr(frame, truth, grid.pixels_per_unit) for frame in frames)


def has_display() -> bool:
    """Whether a window can be opened."""
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def main() -> int:
    """Run the demo."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--no-window", action="store_true", help="do not open the workbench")
    parser.add_argument("--out", type=Path, default=ROOT / "demo_result")
    parser.add_argument("--sequence", type=Path, default=ROOT / "sample_data" / "module")
    options = parser.parse_args()
    begun = perf_counter()
    try:
        check_writable(options.out)
        sequence = FrameSequence.open(options.sequence)
        height, width = sequence.shape
        print(f"{len(sequence)} frames of {width} x {height} pixels in {options.sequence}")
        inspection = follow(inspect_steps(sequence))
        write_result(inspection, options.out)
    except InspectionError as error:
        print(f"demo: {error}", file=sys.stderr)
        return 1
    seconds = perf_counter() - begun
    registration, cracks = inspection.registration, inspection.cracks
    assert registration is not None
    assert cracks is not None
    print(f"frames    {registration.used.sum()} of {len(sequence)} used")
    print(f"cells     {cracks.counts.text}")
    if (options.sequence / "truth").is_dir():
        ours, single = qualities(inspection, options.sequence / "truth")
        print(
            f"PSNR      {ours:.2f} dB against the truth; bicubic, best single frame: "
            f"{single:.2f} dB ({ours - single:+.2f} dB)"
        )
    print(f"time      {seconds:.1f} s")
    print(f"results   {options.out}")
    print(f"report    {options.out / 'report.html'}")
    if options.no_window:
        return 0
    if not has_display():
        print("workbench not opened: there is no display (pv-inspect gui opens it elsewhere)")
        return 0
    print("opening the workbench; close its window to end the demo", flush=True)
    command = [sys.executable, "-m", "pv_inspect", "gui", str(options.sequence)]
    return subprocess.run(command, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
