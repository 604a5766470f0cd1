"""What full runs leave behind in memory: twenty of them, one after the other, in one window.

Resident memory after each run, when the window has settled. *growth*: from the fifth run, when all
caches are filled, to the last one.
"""

from __future__ import annotations

import argparse
import gc
import json
import sys
from pathlib import Path

import psutil
from workbench_window import opened, settle

from napari_pv_inspect.model import RunState

LIMIT_S = 300.0
WARM = 5


def memory(options: argparse.Namespace) -> dict[str, object]:
    """Run again and again with a changed lambda and a fresh grid."""
    viewer, dock = opened(options.sequence)
    model, process = dock.bench.model, psutil.Process()
    used_mib = []
    for _ in range(options.runs):
        model.inspection = model.draft = None  # all stages anew
        model.change_settings(magnification=options.magnification, max_iterations=8)
        dock.run.run.click()
        settle(LIMIT_S, lambda: model.run_state is RunState.IDLE)
        if model.inspection is None or not model.inspection.complete:
            sys.exit("A run came to no end.")
        settle(0.5)
        gc.collect()
        used_mib.append(process.memory_info().rss / 2**20)
    viewer.close()
    warm = used_mib[min(WARM, len(used_mib)) - 1]
    return {
        "mib": [round(mib) for mib in used_mib],
        "growth_percent": round(100 * (used_mib[-1] / warm - 1), 1),
        "growth_from_first_percent": round(100 * (used_mib[-1] / used_mib[0] - 1), 1),
    }


def main(arguments: list[str]) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sequence", type=Path, help="folder of frames; the sample if not given")
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--magnification", type=float, default=1.5)
    print(json.dumps(memory(parser.parse_args(arguments)), indent=1))
