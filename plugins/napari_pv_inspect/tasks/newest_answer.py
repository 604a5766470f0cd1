"""Runs work in a background thread; only the newest request is answered."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from napari.qt.threading import create_worker
from qtpy.QtCore import QObject, QTimer

from napari_pv_inspect.tasks.guard import attempt

__all__ = ["NewestAnswer"]


class NewestAnswer(QObject):
    """Runs one piece of work at a time in a thread; a newer request makes older answers void.

    Parameters
    ----------
    done : callable
        Gets the answer, or the InspectionError, in the main thread.
    delay_ms : int
        Quiet time before work starts: a burst of requests costs one.
    """

    def __init__(self, done: Callable[[Any], None], delay_ms: int) -> None:
        super().__init__()
        self._done: Callable[[Any], None] | None = done
        self._wanted: Callable[[], Any] | None = None
        self._number = 0
        self._worker: Any = None
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._timer.setInterval(delay_ms)
        self._timer.timeout.connect(self._begin)

    @property
    def busy(self) -> bool:
        """Whether an answer is still to come."""
        return self._wanted is not None or self._worker is not None

    def ask(self, work: Callable[[], Any]) -> None:
        """Do this next, in place of what was asked for before."""
        if self._done is None:
            return
        self._number += 1
        self._wanted = work
        self._timer.start()

    def drop(self) -> None:
        """Forget all requests; an answer that is under way is ignored."""
        self._number += 1
        self._wanted = None
        self._timer.stop()

    def close(self) -> None:
        """Forget all requests for good: the window closes."""
        self.drop()
        self._done = None

    def _begin(self) -> None:
        if self._worker is not None or self._wanted is None:
            return
        work, self._wanted = self._wanted, None
        self._worker = worker = create_worker(partial(_answer, self._number, work))
        worker.returned.connect(self._on_answer)
        worker.finished.connect(self._on_finish)
        worker.start()

    def _on_answer(self, answer: tuple[int, Any]) -> None:
        number, result = answer
        if number == self._number and self._done is not None:
            self._done(result)

    def _on_finish(self) -> None:
        self._worker = None
        if self._wanted is not None and not self._timer.isActive():
            self._begin()


def _answer(number: int, work: Callable[[], Any]) -> tuple[int, Any]:
    return number, attempt(work, "This failed unexpectedly")
