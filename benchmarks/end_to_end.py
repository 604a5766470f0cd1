"""Time, memory and quality of `pv-inspect run`, each run in a process of its own.

    python benchmarks/end_to_end.py SEQUENCE... [--magnification 4] [--threads 2] [--score SCORER]
        [--peers]

``--peers`` runs two others on the same frames right after: drizzle with our geometry (the package
`drizzle`, no deconvolution, no cracks), and ours with the paper's prior, WBTV. Machines and their
load differ; the ratios to these tell more than seconds.

SCORER is called as `python SCORER SEQUENCE RESULT` and prints JSON with `geometry` and `hr`; it is
used where the sequence has a truth/ folder.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

from pv_inspect.cli.run import IN_DOUBT


@dataclass(frozen=True)
class Cost:
    """What one process took."""

    exit_code: int
    wall_s: float
    cpu_s: float
    peak_mib: float


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    name: str
    cost: Cost
    used: str = ""
    seconds: dict[str, float] = field(default_factory=dict)
    score: dict[str, Any] = field(default_factory=dict)


def timed(command: list[str]) -> Cost:
    """Run a command; its progress goes to our stderr, its output is dropped."""
    begun = perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    # wait4 reports this child alone; ru_maxrss is its peak, KiB on Linux and bytes on macOS.
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    unit = 2**20 if sys.platform == "darwin" else 2**10
    return Cost(
        process.returncode,
        perf_counter() - begun,
        usage.ru_utime + usage.ru_stime,
        usage.ru_maxrss / unit,
    )


# Geometry and drizzle, in a process of their own like a run.
_DRIZZLE = """
import sys
from pathlib import Path
import numpy as np
from pv_inspect.common.work import result_of
from pv_inspect.evaluation.case import prepared
from pv_inspect.evaluation.peers.drizzling import drizzled
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
sequence, out, magnification = sys.argv[1:]
case = result_of(prepared(FrameSequence.open(sequence), Settings(magnification=magnification)))
np.save(out, result_of(drizzled(case)))
"""


def drizzle(sequence: Path, options: argparse.Namespace, out: Path) -> Row:
    """Find the geometry and drizzle."""
    arguments = [str(sequence), f"{out}.npy", str(options.magnification)]
    cost = timed([sys.executable, "-c", _DRIZZLE, *arguments])
    return Row(f"{sequence.name}, drizzle", cost)


def measured(
    sequence: Path, options: argparse.Namespace, out: Path, prior: str | None = None
) -> Row:
    """Run one sequence and score it."""
    name = sequence.name if prior is None else f"{sequence.name}, {prior}"
    command = [sys.executable, "-m", "pv_inspect", "run", str(sequence), "--out", str(out)]
    command += ["--magnification", str(options.magnification)]
    command += ["--prior", prior] if prior else []
    if options.threads:
        command += ["--threads", str(options.threads)]
    cost = timed(command)
    if cost.exit_code not in (0, IN_DOUBT):
        return Row(name, cost)
    record = json.loads((out / "result.json").read_text(encoding="utf-8"))
    used = [frame["used"] for frame in record["frames"]]
    score: dict[str, Any] = {}
    if options.score and (sequence / "truth").is_dir():
        scored = subprocess.run(
            [sys.executable, str(options.score), str(sequence), str(out)],
            stdout=subprocess.PIPE,
            check=True,
        )
        score = json.loads(scored.stdout)
    return Row(name, cost, f"{sum(used)}/{len(used)}", record["seconds"], score)


def value(score: dict[str, Any], *path: str) -> str:
    """A number out of nested JSON, or a dash."""
    found: Any = score
    for key in path:
        found = found.get(key) if isinstance(found, dict) else None
    return f"{found:.3f}" if isinstance(found, int | float) else "-"


def table(rows: list[Row]) -> str:
    """All rows as text columns."""
    stages = list(dict.fromkeys(stage for row in rows for stage in row.seconds))
    head = ["sequence", "exit", "frames", "wall s", "CPU s", "cores", "peak MiB", *stages]
    head += ["crossing px", "flat PSNR", "raw PSNR", "FRC", "crack AP", "crack F1"]
    lines = [head]
    for row in rows:
        cost = row.cost
        lines.append(
            [
                row.name,
                str(cost.exit_code),
                row.used,
                f"{cost.wall_s:.1f}",
                f"{cost.cpu_s:.1f}",
                f"{cost.cpu_s / cost.wall_s:.2f}",
                f"{cost.peak_mib:.0f}",
                *(f"{row.seconds[s]:.1f}" if s in row.seconds else "-" for s in stages),
                value(row.score, "geometry", "crossing_rmse_px", "median"),
                value(row.score, "hr", "aligned_flat", "psnr_db"),
                value(row.score, "hr", "raw", "psnr_db"),
                value(row.score, "hr", "frc_cutoff"),
                value(row.score, "cracks", "max", "segmentation", "ap"),
                value(row.score, "cracks", "max", "segmentation", "f1"),
            ]
        )
    widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
    return "\n".join(
        "  ".join(
            text.ljust(w) if k == 0 else text.rjust(w)
            for k, (text, w) in enumerate(zip(line, widths, strict=True))
        )
        for line in lines
    )


def ratios(rows: list[Row]) -> str:
    """CPU and wall time of ours over those of the peers, line by line."""
    lines = []
    for ours, *peers in (rows[k : k + 3] for k in range(0, len(rows), 3)):
        told = [
            f"{peer.name.split(', ')[1]} {ours.cost.cpu_s / peer.cost.cpu_s:.2f} (CPU) "
            f"{ours.cost.wall_s / peer.cost.wall_s:.2f} (wall)"
            for peer in peers
        ]
        lines.append(f"{ours.name} over " + ", over ".join(told))
    return "\n".join(lines)


def main() -> int:
    """Run all sequences; the exit code is 1 if one of them failed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sequences", nargs="+", type=Path, metavar="SEQUENCE")
    parser.add_argument("--magnification", type=float, default=4.0)
    parser.add_argument("--threads", type=int, help="threads to compute with")
    parser.add_argument("--score", type=Path, metavar="SCORER")
    parser.add_argument("--keep", type=Path, help="keep the result folders in this folder")
    parser.add_argument("--peers", action="store_true", help="run drizzle and WBTV as well")
    options = parser.parse_args()
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as scratch:
        kept = options.keep or Path(scratch)
        for folder in options.sequences:
            rows.append(measured(folder, options, kept / folder.name))
            if options.peers:
                rows.append(drizzle(folder, options, Path(scratch) / folder.name))
                rows.append(measured(folder, options, kept / f"{folder.name}_wbtv", "wbtv"))
    print(table(rows))
    if options.peers:
        print(ratios(rows))
    return int(any(row.cost.exit_code not in (0, IN_DOUBT) for row in rows))


if __name__ == "__main__":
    sys.exit(main())
