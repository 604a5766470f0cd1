"""Latencies of the workbench, measured on the real window.

    xvfb-run -a -s "-screen 0 1600x1000x24" env QT_QPA_PLATFORM=xcb LIBGL_ALWAYS_SOFTWARE=1 \
        python benchmarks/workbench.py geometry

geometry
    A crossing point is dragged by the mouse on the sample module. *redrawn*: from the release of
    the button until the grid of that frame is painted. *blocked*: the longest time in which the
    window could not answer. *all frames*: until the fit of all frames is shown, which starts
    0.3 s after the last edit. *in thread*: the longest block while that fit ran.

Median and 95th percentile in milliseconds; the machine should have nothing else to do.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import napari
import numpy as np
from qtpy.QtCore import QObject, QTimer
from qtpy.QtWidgets import QApplication

from napari_pv_inspect.application import build
from napari_pv_inspect.docks.inspect import InspectDock
from napari_pv_inspect.model import RunState
from napari_pv_inspect.sample import sample_folder

SIZE = (1280, 800)


def settle(seconds: float, until: Callable[[], bool] | None = None) -> None:
    """Let the window work for a while, or until something has happened."""
    end = time.perf_counter() + seconds
    while time.perf_counter() < end and not (until is not None and until()):
        QApplication.processEvents()
        time.sleep(0.001)


class Heartbeat(QObject):
    """A timer that ticks every millisecond; the longest gap is how long the window was blocked."""

    def __init__(self) -> None:
        super().__init__()
        self.longest_ms = 0.0
        self._last = time.perf_counter()
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._tick)
        self._timer.start(1)

    def restart(self) -> None:
        """Forget the gaps so far."""
        self.longest_ms, self._last = 0.0, time.perf_counter()

    def _tick(self) -> None:
        now = time.perf_counter()
        self.longest_ms = max(self.longest_ms, 1e3 * (now - self._last))
        self._last = now


@dataclass
class Times:
    """Milliseconds by name."""

    values: dict[str, list[float]] = field(default_factory=dict)

    def add(self, name: str, value: float) -> None:
        """Note one value."""
        self.values.setdefault(name, []).append(value)

    def summary(self) -> dict[str, dict[str, float]]:
        """Median, 95th percentile and number of values."""
        return {
            name: {
                "median_ms": round(float(np.median(values)), 1),
                "p95_ms": round(float(np.percentile(values, 95)), 1),
                "n": len(values),
            }
            for name, values in self.values.items()
        }


def opened(sequence: Path | None) -> tuple[napari.Viewer, InspectDock]:
    """Return a window with a sequence in it."""
    viewer = napari.Viewer(title="pv-inspect", show=True)
    viewer.window._qt_window.resize(*SIZE)
    dock, _ = build(viewer)
    settle(1.0)
    dock.bench.open(sequence or sample_folder())
    settle(1.0)
    return viewer, dock


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
        begun = time.perf_counter()
        points._move(points.selected_data, points.data[row] + [0.0, *rng.normal(0.0, 1.5, 2)])
        points._drag_start = None
        settle(2.0, lambda: bool(bent) and any(at > bent[0] for at in painted))
        shown = [at for at in painted if bent and at > bent[0]]
        if not shown:
            sys.exit(f"Edit {number} in frame {frame} was not drawn.")
        times.add("redrawn", 1e3 * (shown[0] - begun))
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
    from workbench_parts import PARTS

    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parts = parser.add_subparsers(required=True)
    for name, part in {"geometry": geometry, **PARTS}.items():
        sub = parts.add_parser(name)
        sub.add_argument("--sequence", type=Path, help="folder of frames; the sample if not given")
        sub.add_argument("--edits", type=int, default=40, help="how many times something is done")
        sub.set_defaults(part=part)
    options = parser.parse_args(arguments)
    print(json.dumps(options.part(options), indent=1))


if __name__ == "__main__":
    main(sys.argv[1:])
