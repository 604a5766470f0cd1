"""What the latency benchmarks of the workbench share: a window, its heartbeat, a table."""

from __future__ import annotations

import gc
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
from napari_pv_inspect.sample import sample_folder
from napari_pv_inspect.tasks.memory import limit_malloc_arenas

SIZE = (1280, 800)
LIMIT_S = 30.0


def process_events(seconds: float, until: Callable[[], bool] | None = None) -> None:
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
    """Return a window with a sequence in it, in a process as `application.run` keeps it."""
    limit_malloc_arenas()
    viewer = napari.Viewer(title="pv-inspect", show=True)
    viewer.window._qt_window.resize(*SIZE)
    dock, _ = build(viewer)
    gc.freeze()
    process_events(1.0)
    dock.workbench.open(sequence or sample_folder())
    process_events(LIMIT_S, lambda: dock.workbench.model.sequence is not None)
    process_events(1.0)
    return viewer, dock
