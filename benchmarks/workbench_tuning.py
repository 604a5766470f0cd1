"""How fast the live cell follows the sliders, and how long the main thread is held up.

xvfb-run -a -s "-screen 0 1600x1000x24" env QT_QPA_PLATFORM=xcb LIBGL_ALWAYS_SOFTWARE=1 \
        python benchmarks/workbench_tuning.py [--sequence FOLDER]

Wall times from the change of a control to the picture painted with it. *block* is the longest time
between two turns of the event loop, and the processor time that the main thread spent in it: on a
machine that does other things too the wall time counts their share.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import napari
import numpy as np
from qtpy.QtCore import QTimer
from qtpy.QtWidgets import QApplication

from napari_pv_inspect.application import build
from napari_pv_inspect.docks.inspect import InspectDock
from napari_pv_inspect.docks.live_cell import LiveDock
from napari_pv_inspect.docks.placing import show_live_cell
from napari_pv_inspect.live.cell_renderer import CellRenderer
from napari_pv_inspect.models.cell_picture import CellPicture
from napari_pv_inspect.models.workbench import RunState
from napari_pv_inspect.sample import sample_folder
from napari_pv_inspect.tasks.memory import gc_frozen, limit_malloc_arenas
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.pipeline import inspect
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings, Stage

SIZE = (1280, 800)
FIRST_BAR_MS, NEXT_BAR_MS, BLOCK_BAR_MS = 300.0, 150.0, 100.0
LIMIT_S = 30.0
TICK_S = 1 / 60


@dataclass(frozen=True)
class Latency:
    """Times of one kind of change.

    Attributes
    ----------
    name : str
    bar_ms : float
    wall_ms : tuple of float
    """

    name: str
    bar_ms: float
    wall_ms: tuple[float, ...]

    def __str__(self) -> str:
        median, p95 = np.percentile(self.wall_ms, (50, 95))
        verdict = "ok" if p95 <= self.bar_ms else "over"
        return (
            f"{self.name:32s} {len(self.wall_ms):3d} {median:8.0f} {p95:8.0f} {self.bar_ms:6.0f} "
            f"{verdict}"
        )


class Heartbeat:
    """Longest time between two turns of the event loop."""

    def __init__(self) -> None:
        self._timer = QTimer()
        self._timer.setInterval(0)
        self._timer.timeout.connect(self._beat)
        self.gaps_ms: list[tuple[float, float]] = []
        self._last = (time.perf_counter(), time.thread_time())

    def start(self) -> None:
        """Begin to count."""
        self._last = (time.perf_counter(), time.thread_time())
        self._timer.start()

    def stop(self) -> None:
        """End."""
        self._timer.stop()

    def _beat(self) -> None:
        now = (time.perf_counter(), time.thread_time())
        self.gaps_ms.append((1e3 * (now[0] - self._last[0]), 1e3 * (now[1] - self._last[1])))
        self._last = now


class Watch:
    """Notes when a picture of which settings and cell was painted."""

    def __init__(self, live: LiveDock) -> None:
        self._live = live
        self._picture: CellPicture | None = None
        self.painted: list[tuple[float, CellPicture]] = []
        live.workbench.live_cell.pictured.connect(self._on_picture)
        live.view.painted.connect(self._on_paint)

    def _on_picture(self, picture: CellPicture) -> None:
        self._picture = picture

    def _on_paint(self) -> None:
        if self._picture is not None:
            self.painted.append((time.perf_counter(), self._picture))
            self._picture = None

    def time_of(self, change: Callable[[], None]) -> float:
        """Milliseconds from a change to the first picture with the new settings and cell."""
        model = self._live.workbench.model
        self.painted.clear()
        begun = time.perf_counter()
        change()
        settings, cell = model.settings, self._live.workbench.live_cell.cell
        wait_until(lambda: any(p.settings == settings and p.cell == cell for _, p in self.painted))
        when = next(t for t, p in self.painted if p.settings == settings and p.cell == cell)
        return 1e3 * (when - begun)

    def wait_for_end(self) -> None:
        """Let the picture get as good as it gets."""
        wait_until(lambda: self._live.picture is not None and self._live.picture.finished)


def wait_until(condition: Callable[[], bool]) -> None:
    """Let the window work until something is so."""
    end = time.perf_counter() + LIMIT_S
    while not condition():
        QApplication.processEvents()
        if time.perf_counter() > end:
            sys.exit(f"The live cell did not answer within {LIMIT_S:.0f} s.")
        time.sleep(0.0005)


def measure(dock: InspectDock, inspection: Inspection) -> tuple[list[Latency], Heartbeat, Watch]:
    """Measure the live cell of a window.

    Parameters
    ----------
    dock : InspectDock
        Its sequence is that of the inspection.
    inspection : Inspection
        Complete.
    """
    model = dock.workbench.model
    model.inspection = inspection
    model.inspection_changed.emit(inspection)
    dock.show_page("Image")
    live = show_live_cell(dock.workbench, dock)
    watch, heart = Watch(live), Heartbeat()
    wait_until(lambda: live.picture is not None and live.picture.finished)
    # The gallery and the layers are drawn once; that is not what is measured here.
    time.sleep(0.5)
    QApplication.processEvents()
    heart.start()
    layout = inspection.layout
    cells = [(r, c) for r in range(layout.rows) for c in range(layout.cols)][1::3][:16]
    results = [
        Latency(
            "another cell (first view)",
            FIRST_BAR_MS,
            tuple(watch.time_of(lambda at=cell: model.select_cell(at)) for cell in cells),
        )
    ]
    watch.wait_for_end()
    image, kappa = dock.image, dock.lens.form["kappa"].slider
    for name, slider, positions in (
        ("lambda", image.form["prior_weight"].slider, range(250, 370, 4)),
        ("PSF sigma", image.form["psf_sigma_lr_px"].slider, range(150, 220, 4)),
        ("magnification", image.form["magnification"].slider, range(160, 300, 8)),
        ("kappa", kappa, range(kappa.value() - 12, kappa.value() + 13, 2)),
    ):
        times = []
        for position in positions:
            before = model.settings
            change = slider.setValue
            if slider.value() == position:
                continue
            times.append(watch.time_of(lambda p=position, set_=change: set_(p)))
            assert model.settings != before
        results.append(Latency(f"{name}, one step each", NEXT_BAR_MS, tuple(times)))
        watch.wait_for_end()
    results.append(
        Latency("lambda, dragged at 60 Hz", NEXT_BAR_MS, _drag(dock, watch, range(180, 360)))
    )
    heart.stop()
    return results, heart, watch


def measure_in_a_run(dock: InspectDock, watch: Watch) -> str:
    """Drag lambda for five seconds while a whole run goes on, and say how that went."""
    runs, model = dock.workbench.runs, dock.workbench.model
    heart = Heartbeat()
    runs.start()
    wait_until(lambda: model.running_stage is Stage.RECONSTRUCT)
    heart.start()
    ages = _drag(dock, watch, range(60, 360))
    heart.stop()
    still = model.run_state is not RunState.IDLE
    runs.cancel()
    wait_until(lambda: model.run_state is RunState.IDLE)
    wall = [gap for gap, _ in heart.gaps_ms]
    return (
        f"dragged for 5 s while a run goes on{'' if still else ' (it ended before)'}: "
        f"{len(ages)} pictures for 300 positions, age median {np.median(ages):.0f}, 95 % "
        f"{np.percentile(ages, 95):.0f} ms; turns of the window: 95 % {np.percentile(wall, 95):.0f}"
        f", longest {max(wall):.0f} ms"
    )


def _drag(dock: InspectDock, watch: Watch, positions: range) -> tuple[float, ...]:
    """Ages of the pictures that are painted while lambda is dragged at 60 Hz.

    Every position is there once, or the age of a picture would be ambiguous.
    """
    slider, model = dock.image.form["prior_weight"].slider, dock.workbench.model
    when: dict[float | None, float] = {}
    watch.painted.clear()
    tick = time.perf_counter()
    for position in positions:
        slider.setValue(position)
        when[model.settings.prior_weight] = time.perf_counter()
        # A hand waits for nobody: what is late shortens the time to the next position.
        tick += TICK_S
        QApplication.processEvents()
        while time.perf_counter() < tick:
            QApplication.processEvents()
            time.sleep(0.0005)
    watch.wait_for_end()
    seen = set()
    ages = []
    for at, picture in watch.painted:
        assert picture.settings is not None
        weight = picture.settings.prior_weight
        if weight not in seen and weight in when:
            seen.add(weight)
            ages.append(1e3 * (at - when[weight]))
    return tuple(ages)


def computing(inspection: Inspection) -> dict[str, float]:
    """Median processor time to the first picture, ms: what the load of the machine leaves alone."""
    renderer, settings = CellRenderer(), inspection.settings
    assert inspection.registration is not None
    assert inspection.reconstruction is not None
    kappa = inspection.registration.camera.kappa
    weight = inspection.reconstruction.prior_weight
    changes: dict[str, list[tuple[tuple[int, int], Settings]]] = {
        "cell": [((1, c % inspection.layout.cols), settings) for c in range(7)],
        "lambda": [((1, 1), settings.changed(prior_weight=weight * 1.1**k)) for k in range(7)],
        "PSF": [((1, 1), settings.changed(psf_sigma_lr_px=0.3 + 0.05 * k)) for k in range(7)],
        "magnification": [((1, 1), settings.changed(magnification=3 + 0.2 * k)) for k in range(7)],
        "kappa": [((1, 1), settings.changed(kappa=kappa + 0.004 * k)) for k in range(7)],
    }
    found = {}
    for name, tried in changes.items():
        times = []
        for cell, wanted in tried:
            begun = time.thread_time()
            pictures = renderer.pictures(inspection, cell, wanted)
            while next(pictures) is None:
                pass
            times.append(1e3 * (time.thread_time() - begun))
        # The first of each kind is another change too.
        found[name] = float(np.median(times[1:]))
    return found


def report(results: list[Latency], heart: Heartbeat) -> str:
    """Return a table of the results."""
    load = os.getloadavg()[0]
    lines = [f"{'change to picture':32s}   n   median     95 %    bar   (ms; load {load:.1f})"]
    lines += [str(result) for result in results]
    wall, cpu = max(heart.gaps_ms)
    busiest = max(cpu for _, cpu in heart.gaps_ms)
    over = sum(gap > BLOCK_BAR_MS for gap, _ in heart.gaps_ms)
    lines.append(
        f"longest block of the main thread: {wall:.0f} ms wall ({cpu:.0f} ms of it computing); "
        f"most computing in one turn {busiest:.0f} ms; {over} of {len(heart.gaps_ms)} turns over "
        f"{BLOCK_BAR_MS:.0f} ms wall"
    )
    return "\n".join(lines)


def main(arguments: list[str]) -> None:
    """Inspect once, open the window, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sequence", type=Path, help="folder of frames; the sample if not given")
    options = parser.parse_args(arguments)
    sequence = FrameSequence.open(options.sequence or sample_folder())
    hint = {k: sequence.layout_hint.get(k) for k in ("rows", "cols", "cell_aspect")}
    limit_malloc_arenas()
    viewer = napari.Viewer(title="pv-inspect", show=True)
    viewer.window._qt_window.resize(*SIZE)
    dock, _ = build(viewer)
    with gc_frozen():
        inspection = inspect(sequence, Settings(**hint))
        dock.workbench.model.open(sequence)
        results, heart, watch = measure(dock, inspection)
        print(report(results, heart))
        print(measure_in_a_run(dock, watch))
    viewer.close()
    times = ", ".join(f"{name} {ms:.0f}" for name, ms in computing(inspection).items())
    print(f"processor time to the first picture, ms: {times}")


if __name__ == "__main__":
    main(sys.argv[1:])
