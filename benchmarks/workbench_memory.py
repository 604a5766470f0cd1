"""What full runs leave behind in memory: twenty of them, one after the other, in one window.

Memory after each run, when the window has settled: resident, and the part of it that is no file
(the system takes pages of libraries away and brings them back as it likes). *growth*: from the
first run to the last one, and to the highest of all.
"""

from __future__ import annotations

import argparse
import gc
import json
import sys
from pathlib import Path

import psutil
from workbench_window import opened, process_events

from napari_pv_inspect.models.workbench import RunState

LIMIT_S = 300.0


def memory(options: argparse.Namespace) -> dict[str, object]:
    """Run again and again with a changed lambda and a fresh grid."""
    viewer, dock = opened(options.sequence)
    model, process = dock.workbench.model, psutil.Process()
    resident, own = [], []
    for _ in range(options.runs):
        model.inspection = model.draft = None  # all stages anew
        model.change_settings(magnification=options.magnification, max_iterations=8)
        dock.run.run.click()
        process_events(LIMIT_S, lambda: model.run_state is RunState.IDLE)
        if model.inspection is None or not model.inspection.complete:
            sys.exit("A run came to no end.")
        process_events(0.5)
        gc.collect()
        used = process.memory_info()
        resident.append(used.rss / 2**20)
        own.append((used.rss - used.shared) / 2**20)
    viewer.close()
    return {"resident": _growth(resident), "own": _growth(own)}


def _growth(mib: list[float]) -> dict[str, object]:
    return {
        "mib": [round(value) for value in mib],
        "last_percent": round(100 * (mib[-1] / mib[0] - 1), 1),
        "highest_percent": round(100 * (max(mib) / mib[0] - 1), 1),
    }


def main(arguments: list[str]) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sequence", type=Path, help="folder of frames; the sample if not given")
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--magnification", type=float, default=1.5)
    print(json.dumps(memory(parser.parse_args(arguments)), indent=1))
