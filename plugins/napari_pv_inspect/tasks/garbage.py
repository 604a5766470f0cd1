"""Runs Python's garbage collection in the main thread alone while a workbench is open."""

from __future__ import annotations

import gc
from weakref import WeakSet

from qtpy.QtCore import QCoreApplication, QObject, QThreadPool, QTimer

__all__ = ["collect_anywhere", "collect_in_main_thread"]

INTERVAL_MS = 1000


class _Collector(QObject):
    """Collects at a timer as automatic collection would, by the thresholds of `gc`."""

    def __init__(self, parent: QObject) -> None:
        super().__init__(parent)
        self.users: WeakSet[QObject] = WeakSet()
        self._was_enabled = gc.isenabled()
        self._timer = QTimer(self)
        self._timer.timeout.connect(self.collect)
        self._timer.start(INTERVAL_MS)

    def collect(self) -> None:
        """Collect the oldest generation that is due."""
        if not self.users and not QThreadPool.globalInstance().activeThreadCount():
            self._end()
            return
        gc.disable()  # other code may have switched it on again
        counts, thresholds = gc.get_count(), gc.get_threshold()
        for generation in (2, 1, 0):
            if counts[generation] > thresholds[generation] > 0:
                gc.collect(generation)
                return

    def _end(self) -> None:
        """Give collection back to Python, with nothing of a closed window left to collect."""
        global _collector
        _collector = None
        # It lives on until the event loop comes to delete it, and must not end its successor.
        self._timer.stop()
        gc.collect()
        if self._was_enabled:
            gc.enable()
        self.deleteLater()


_collector: _Collector | None = None


def collect_in_main_thread(user: QObject) -> None:
    """Keep garbage collection out of other threads until `collect_anywhere`, or ``user`` is gone.

    Python collects in whichever thread allocates. A window of napari leaves cycles of widgets and
    layers behind; a run that collects them in its own thread destroys them there, which Qt forbids:
    the window then hangs or the process ends (napari issue 1029). Call it in the main thread.
    """
    global _collector
    application = QCoreApplication.instance()
    if application is None:
        return
    if _collector is None:
        _collector = _Collector(application)
    gc.disable()
    _collector.users.add(user)


def collect_anywhere(user: QObject) -> None:
    """End what `collect_in_main_thread` began for ``user``, once no background work goes on."""
    if _collector is not None:
        _collector.users.discard(user)
