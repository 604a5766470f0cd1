"""From the edit of a crossing point to the grid that follows it.

A crossing point of the sample module is dragged, in changing frames. *redrawn*: from the release
of the button until the grid of that frame is painted. *cpu*: of the window's thread in that time.
*blocked*: the longest time in which the window could not answer. *all frames*: until the fit of
all frames is shown; it starts 0.3 s after the last edit. *in thread*: the longest block while that
fit and the curve over kappa are computed and shown.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
from workbench_window import Heartbeat, Times, opened, settle

from napari_pv_inspect.model import RunState


def geometry(options: argparse.Namespace) -> dict[str, dict[str, float]]:
    """Drag points, one after the other, in changing frames."""
    viewer, dock = opened(options.sequence)
    bench = dock.bench
    dock.module.detect.click()
    settle(120.0, lambda: bench.model.run_state is RunState.IDLE)
    settle(2.0)
    dock.points.select.click()
    points, grid = viewer.layers["Crossing points"], viewer.layers["Fitted grid"]
    painted: list[float] = []
    canvas = viewer.window._qt_viewer.canvas._scene_canvas
    canvas.events.draw.connect(lambda _: painted.append(time.perf_counter()), position="last")
    bent: list[float] = []
    grid.events.set_data.connect(lambda _: bent.append(time.perf_counter()))
    heart, times, rng = Heartbeat(), Times(), np.random.default_rng(0)
    n_frames, n = len(bench.model.sequence), bench.model.inspection.layout.n_crossings
    for number in range(options.edits):
        frame = int(rng.integers(n_frames))
        viewer.dims.set_current_step(0, frame)
        settle(0.4)
        row = frame * n + int(rng.integers(n))
        points.selected_data = {row}
        points._set_drag_start(points.selected_data, points.data[row])
        heart.restart()
        bent.clear()
        begun, cpu = time.perf_counter(), time.thread_time()
        points._move(points.selected_data, points.data[row] + [0.0, *rng.normal(0.0, 1.5, 2)])
        points._drag_start = None
        settle(2.0, lambda: bool(bent) and any(at > bent[0] for at in painted))
        shown = [at for at in painted if bent and at > bent[0]]
        if not shown:
            sys.exit(f"Edit {number} in frame {frame} was not drawn.")
        times.add("redrawn", 1e3 * (shown[0] - begun))
        times.add("cpu", 1e3 * (time.thread_time() - cpu))
        times.add("blocked", heart.longest_ms)
        heart.restart()
        settle(10.0, lambda: not bench.recalibration.busy)
        times.add("all frames", 1e3 * (time.perf_counter() - begun))
        settle(1.0, lambda: not bench.kappa_curve.busy)
        times.add("in thread", heart.longest_ms)
        painted.clear()
    viewer.close()
    return times.summary()


def main(arguments: list[str]) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sequence", type=Path, help="folder of frames; the sample if not given")
    parser.add_argument("--edits", type=int, default=40)
    print(json.dumps(geometry(parser.parse_args(arguments)), indent=1))
