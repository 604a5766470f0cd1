"""Time and memory of whole runs on large inputs, beside what was estimated before the work began.

Every case is simulated, run by the command line in a process of its own, and measured by the
system: processor time, wall time, peak of the resident memory. A case that does not fit shows the
sentence instead. Cases are frames x width x height @ magnification.

    python benchmarks/large_inputs.py 8x640x512@4 300x640x512@2 --folder /var/tmp/large

The simulation needs about 40 s per 20 million pixels of frames; a folder that is given keeps its
sequences for the next time.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import tifffile

from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.memory import expected_grid, needed_bytes
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.simulate import SimulationSettings, simulated, write_sequence

LAYOUT = ModuleLayout(6, 10)
GIB = 2.0**30
MARGIN = 0.15  # around the module, in its image
_CASE = re.compile(r"(\d+)x(\d+)x(\d+)@([\d.]+)")


@dataclass(frozen=True)
class Case:
    """So many frames of a size, and the magnification."""

    frames: int
    width: int
    height: int
    magnification: float

    @classmethod
    def read(cls, text: str) -> Case:
        """Read what stands on the command line."""
        found = _CASE.fullmatch(text)
        if found is None:
            raise argparse.ArgumentTypeError(f"{text} is not FRAMESxWIDTHxHEIGHT@MAGNIFICATION")
        return cls(int(found[1]), int(found[2]), int(found[3]), float(found[4]))

    def sequence(self, folder: Path) -> Path:
        """Simulate the frames, unless they are there."""
        path = folder / f"{self.frames}x{self.width}x{self.height}"
        if not path.exists():
            settings = SimulationSettings(
                n_frames=self.frames,
                width=self.width,
                height=self.height,
                supersampling=2,
                pixels_per_unit=min(max(120, self.width // 9), 420),
                seed=4,
            )
            write_sequence(simulated(settings), path)
        return path

    def estimates(self, sequence: Path, result: Path) -> tuple[float, float]:
        """GiB that were expected before the module was found, and with its size known."""
        opened = FrameSequence.open(sequence)
        seen = expected_grid(opened.frame(0).image, LAYOUT, self.magnification)
        first = needed_bytes(opened.shape, self.frames, seen)
        image = result / "module_hr.tif"
        if not image.exists():
            return first / GIB, float("nan")
        height = tifffile.imread(image).shape[0]
        scale = height / (LAYOUT.size[1] + 2 * MARGIN) / self.magnification
        known = HrGrid.covering(LAYOUT, scale, self.magnification, MARGIN)
        return first / GIB, needed_bytes(opened.shape, self.frames, known) / GIB


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    cases = ["8x640x512@2", "8x640x512@4", "8x1280x1024@2", "8x1280x1024@4", "300x640x512@2"]
    parser.add_argument("cases", nargs="*", type=Case.read, default=[Case.read(c) for c in cases])
    parser.add_argument("--folder", type=Path, help="where the sequences are and stay")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary)
        print("frames      size   m   cpu s  wall s  peak GiB  expected  known  per frame s")
        for case in arguments.cases:
            _row(case, folder, Path(temporary) / "result")


def _row(case: Case, folder: Path, result: Path) -> None:
    sequence = case.sequence(folder)
    command = [sys.executable, "-m", "pv_inspect", "run", str(sequence), "-o", str(result)]
    begun = time.perf_counter()
    process = subprocess.Popen(
        [*command, "-m", f"{case.magnification:g}", "-q"], stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    said = process.stderr.read()
    _, status, usage = os.wait4(process.pid, 0)
    wall = time.perf_counter() - begun
    process.returncode = os.waitstatus_to_exitcode(status)
    expected, known = case.estimates(sequence, result)
    cpu = usage.ru_utime + usage.ru_stime
    print(
        f"{case.frames:6d} {case.width:4d}x{case.height:<4d} {case.magnification:3g} {cpu:7.0f} "
        f"{wall:7.0f} {usage.ru_maxrss / 2**20:9.2f} {expected:9.2f} {known:6.2f} "
        f"{cpu / case.frames:12.2f}  exit {process.returncode}",
        flush=True,
    )
    if said.strip():
        print(f"    {said.strip()}", flush=True)
    if result.exists():
        for path in sorted(result.rglob("*"), reverse=True):
            path.unlink() if path.is_file() else path.rmdir()


if __name__ == "__main__":
    main()
