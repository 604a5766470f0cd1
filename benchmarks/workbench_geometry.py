"""From the edit of a crossing point to the grid that follows it.

A crossing point of the sample module is dragged, in changing frames. *redrawn*: from the release
of the button until the grid of that frame is painted. *cpu*: of the window's thread in that time.
*blocked*: the longest time in which the window could not answer. *all frames*: until the fit of
all frames is shown; it starts 0.3 s after the last edit. *in thread*: the longest block while that
fit and the curve over kappa are computed and shown.

*held*: the same point is dragged on by mouse events at 60 Hz, without a release: the longest block
per event, repaint included; *held cpu* of the window's thread. *kappa*: the same while the slider
of kappa goes from end to end.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator
from qtpy.QtCore import QPoint, Qt
from qtpy.QtTest import QTest
from workbench_window import Heartbeat, Times, opened, process_events

from napari_pv_inspect.docks.inspect import InspectDock
from napari_pv_inspect.models.workbench import RunState


def geometry(options: argparse.Namespace) -> dict[str, dict[str, float]]:
    """Drag points, one after the other, in changing frames; then kappa."""
    viewer, dock = opened(options.sequence)
    workbench = dock.workbench
    dock.module.detect.click()
    process_events(120.0, lambda: workbench.model.run_state is RunState.IDLE)
    process_events(2.0)
    dock.points.select.click()
    heart, times, rng = Heartbeat(), Times(), np.random.default_rng(0)
    edits(viewer, dock, options.edits, heart, times, rng)
    held(viewer, dock, heart, times, rng)
    kappa(dock, heart, times)
    viewer.close()
    return times.summary()


def edits(
    viewer: Any, dock: InspectDock, n_edits: int, heart: Heartbeat, times: Times, rng: Generator
) -> None:
    """Move points at a stroke."""
    workbench = dock.workbench
    points, grid = viewer.layers["Crossing points"], viewer.layers["Fitted grid"]
    painted: list[float] = []
    canvas = viewer.window._qt_viewer.canvas._scene_canvas
    canvas.events.draw.connect(lambda _: painted.append(time.perf_counter()), position="last")
    fitted: list[float] = []
    grid.events.set_data.connect(lambda _: fitted.append(time.perf_counter()))
    for number in range(n_edits):
        row = take(viewer, dock, rng)
        heart.restart()
        fitted.clear()
        begun, cpu = time.perf_counter(), time.thread_time()
        points._move(points.selected_data, points.data[row] + [0.0, *rng.normal(0.0, 1.5, 2)])
        points._drag_start = None
        process_events(2.0, lambda: bool(fitted) and any(at > fitted[0] for at in painted))
        shown = [at for at in painted if fitted and at > fitted[0]]
        if not shown:
            sys.exit(f"Edit {number} was not drawn.")
        times.add("redrawn", 1e3 * (shown[0] - begun))
        times.add("cpu", 1e3 * (time.thread_time() - cpu))
        times.add("blocked", heart.longest_ms)
        heart.restart()
        process_events(10.0, lambda: not workbench.recalibration.busy)
        times.add("all frames", 1e3 * (time.perf_counter() - begun))
        process_events(1.0, lambda: not workbench.kappa_curve.busy)
        times.add("in thread", heart.longest_ms)
        painted.clear()


def take(viewer: Any, dock: InspectDock, rng: Generator) -> int:
    """Go to some frame and select one of its points: its row in the layer."""
    n, points = dock.workbench.model.inspection.layout.n_crossings, viewer.layers["Crossing points"]
    frame = int(rng.integers(len(dock.workbench.model.sequence)))
    viewer.dims.set_current_step(0, frame)
    process_events(0.4)
    row = frame * n + int(rng.integers(n))
    points.selected_data = {row}
    points._set_drag_start(points.selected_data, points.data[row])
    return row


def held(viewer: Any, dock: InspectDock, heart: Heartbeat, times: Times, rng: Generator) -> None:
    """Drag a point by the mouse, with the button down."""
    canvas, points = viewer.window._qt_viewer.canvas.native, viewer.layers["Crossing points"]
    dock.workbench.navigator.to_frames()
    _, row, col = points.data[take(viewer, dock, rng)]
    process_events(1.0)
    (_, y, x), zoom = viewer.scene.camera.center, viewer.scene.camera.zoom
    middle = canvas.rect().center()
    start = QPoint(middle.x() + round((col - x) * zoom), middle.y() + round((row - y) * zoom))
    QTest.mouseMove(canvas, start)
    process_events(0.2)
    QTest.mousePress(canvas, Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier, start)
    for k in range(1, 121):
        heart.restart()
        cpu = time.thread_time()
        angle = k / 12.0
        way = QPoint(round(9 * np.sin(angle)), round(9 * np.sin(1.3 * angle)))
        QTest.mouseMove(canvas, start + way)
        process_events(1.0 / 60.0)
        times.add("held", heart.longest_ms)
        times.add("held cpu", 1e3 * (time.thread_time() - cpu))
    if dock.workbench.live.dragged_rms_px is None:
        sys.exit("The grid did not follow the dragged point.")
    QTest.mouseRelease(canvas, Qt.MouseButton.LeftButton)
    process_events(2.0)


def kappa(dock: InspectDock, heart: Heartbeat, times: Times) -> None:
    """Drag the slider of kappa from end to end."""
    slider = dock.lens.form["kappa"].slider
    for place in np.linspace(slider.minimum(), slider.maximum(), 240):
        heart.restart()
        cpu = time.thread_time()
        slider.setValue(round(place))
        process_events(1.0 / 60.0)
        times.add("kappa", heart.longest_ms)
        times.add("kappa cpu", 1e3 * (time.thread_time() - cpu))


def main(arguments: list[str]) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sequence", type=Path, help="folder of frames; the sample if not given")
    parser.add_argument("--edits", type=int, default=40)
    print(json.dumps(geometry(parser.parse_args(arguments)), indent=1))
