"""Runs work in a background thread; only the latest request is answered."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from threading import Condition, Thread
from typing import Any

from qtpy.QtCore import QObject, Qt, QTimer, Signal

from napari_pv_inspect.tasks.guard import attempt
from pv_inspect.errors import InspectionError

__all__ = ["BackgroundThread", "LatestOnly", "Work"]

# As long as a thread of Qt's pool waits for more.
IDLE_S = 30.0

Work = Callable[[], Any]
"""Returns its answer, or a generator of answers.

Where a generator yields, also None, its work can be given up for a newer request.
"""


@dataclass(frozen=True, eq=False)
class _Request:
    number: int
    work: Work


class BackgroundThread:
    """A thread that works on one request at a time, for one `LatestOnly` or several.

    Those that were made first go before the others: their requests interrupt a generator of the
    others, which is begun again afterwards. The thread is a daemon, and ends when it had nothing
    to do for a while.

    Parameters
    ----------
    name : str
        For debuggers.
    """

    def __init__(self, name: str = "pv-inspect") -> None:
        self._name = name
        self._changed = Condition()
        self._waiting: dict[LatestOnly, _Request | None] = {}
        self._working_for: LatestOnly | None = None
        self._thread: Thread | None = None

    def serve(self, asker: LatestOnly) -> None:
        """Work on the requests of one more."""
        with self._changed:
            self._waiting[asker] = None

    def leave(self, asker: LatestOnly) -> None:
        """Take no more requests of one; what is being done for it is ended in its own time."""
        with self._changed:
            self._waiting.pop(asker, None)
            self._changed.notify_all()

    def put(self, asker: LatestOnly, request: _Request | None) -> None:
        """Work on a request next, in place of the one that waits; None: on none."""
        with self._changed:
            self._waiting[asker] = request
            if request is not None and self._thread is None:
                self._thread = Thread(target=self._run, name=self._name, daemon=True)
                self._thread.start()
            self._changed.notify_all()

    def has_newer(self, asker: LatestOnly) -> bool:
        """Whether a request waits, or none of this one is taken any more."""
        with self._changed:
            return asker not in self._waiting or self._waiting[asker] is not None

    def works_for(self, asker: LatestOnly) -> bool:
        """Whether a request of this one is being worked on."""
        return self._working_for is asker

    def wait_for_end(self, asker: LatestOnly, timeout_s: float) -> None:
        """Wait until no request of this one is being worked on."""
        with self._changed:
            self._changed.wait_for(lambda: self._working_for is not asker, timeout_s)

    def interrupts(self, asker: LatestOnly, request: _Request) -> bool:
        """Whether a request waits that goes before this one, which then waits again."""
        with self._changed:
            for other, waiting in self._waiting.items():
                if other is asker:
                    return False
                if waiting is not None:
                    if asker in self._waiting and self._waiting[asker] is None:
                        self._waiting[asker] = request
                    return True
        return False

    def _run(self) -> None:
        while (taken := self._next()) is not None:
            asker, request = taken
            asker.work_on(request, self)
            with self._changed:
                self._working_for = None
                self._changed.notify_all()

    def _next(self) -> tuple[LatestOnly, _Request] | None:
        with self._changed:
            is_idle = False
            while True:
                for asker, request in self._waiting.items():
                    if request is not None:
                        self._waiting[asker] = None
                        self._working_for = asker
                        return asker, request
                if is_idle or not self._waiting:
                    self._thread = None
                    return None
                is_idle = not self._changed.wait(IDLE_S)


class LatestOnly(QObject):
    """Runs one request at a time in a thread; a newer one makes older answers void.

    All methods are called in the main thread, where the callbacks run too.

    Parameters
    ----------
    answered : callable
        Gets each answer.
    failed : callable
        Gets the InspectionError if the work raised something.
    failure : str
        What to say of an unexpected error, without a full stop.
    delay_ms : int
        Quiet time before work starts: a burst of requests costs one.
    thread : BackgroundThread, optional
        Shared with others; else there is one of its own.
    at_once : bool
        Begin a newer request while an older one that can't be interrupted still works.
    older_count : bool
        Whether an older request still brings its first answer, if it is being worked on. Without
        it, requests that follow each other quickly would never be answered.
    """

    _answered = Signal(int, object, bool)
    _failed = Signal(int, object)
    _ended = Signal(int)

    def __init__(
        self,
        answered: Callable[[Any], None],
        failed: Callable[[InspectionError], None],
        *,
        failure: str = "This failed unexpectedly",
        delay_ms: int = 0,
        thread: BackgroundThread | None = None,
        at_once: bool = False,
        older_count: bool = False,
    ) -> None:
        super().__init__()
        self._on_answer, self._on_failure = answered, failed
        self._failure = failure
        self._at_once, self._older_count = at_once, older_count
        self._number = self._finished = 0
        # Answers up to this number are void.
        self._void = 0
        self._closed = False
        self._delayed: _Request | None = None
        self._thread = thread or BackgroundThread()
        self._thread.serve(self)
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._timer.setInterval(delay_ms)
        self._timer.timeout.connect(self._submit)
        queued = Qt.ConnectionType.QueuedConnection
        self._answered.connect(self._take_answer, queued)
        self._failed.connect(self._take_failure, queued)
        self._ended.connect(self._finish, queued)

    @property
    def busy(self) -> bool:
        """Whether the latest request is still to be answered."""
        return self._finished < self._number

    def superseded(self) -> bool:
        """Whether a newer request waits; may be asked in the thread as well."""
        return self._thread.has_newer(self)

    def ask(self, work: Work) -> None:
        """Do this next, in place of what was asked for before."""
        if self._closed:
            return
        self._number += 1
        if not self._older_count:
            self._void = self._number - 1
        self._delayed = _Request(self._number, work)
        if self._timer.interval() > 0:
            self._timer.start()
        else:
            self._submit()

    def cancel(self) -> None:
        """Forget all requests; an answer that is under way is ignored."""
        if self._closed:
            return
        self._timer.stop()
        self._forget()

    def _forget(self) -> None:
        self._delayed = None
        self._void = self._finished = self._number
        self._thread.put(self, None)

    def close(self, wait_s: float = 0.0) -> None:
        """Take no more requests, and answer none; wait for what is being done at most so long."""
        if self._closed:
            return
        with suppress(RuntimeError):  # at the end of the program Qt has deleted the timer
            self._timer.stop()
        self._forget()
        self._closed = True
        self._thread.leave(self)
        if wait_s > 0:
            self._thread.wait_for_end(self, wait_s)

    def _submit(self) -> None:
        if self._at_once and self._thread.works_for(self):
            self._thread.leave(self)
            self._thread = BackgroundThread()
            self._thread.serve(self)
        self._thread.put(self, self._delayed)
        self._delayed = None

    def _take_answer(self, number: int, answer: Any, is_last: bool) -> None:
        if number > self._void:
            if is_last:
                self._finish(number)
            self._on_answer(answer)

    def _take_failure(self, number: int, error: InspectionError) -> None:
        if number > self._void:
            self._finish(number)
            self._on_failure(error)

    def _finish(self, number: int) -> None:
        self._finished = max(self._finished, number)

    # What follows runs in the thread.

    def work_on(self, request: _Request, thread: BackgroundThread) -> None:
        """Work on a request and tell its answers."""
        failed = attempt(partial(self._work_on, request, thread), self._failure)
        if failed is not None:
            self._failed.emit(request.number, failed)

    def _work_on(self, request: _Request, thread: BackgroundThread) -> None:
        number = request.number
        if number <= self._void:
            return
        result = request.work()
        if not isinstance(result, Generator):
            self._answered.emit(number, result, True)
            return
        has_answered = False
        try:
            for answer in result:
                if answer is not None:
                    self._answered.emit(number, answer, False)
                    has_answered = True
                if number <= self._void:
                    return
                if thread.has_newer(self) and (has_answered or not self._older_count):
                    return
                if thread.interrupts(self, request):
                    return
            self._ended.emit(number)
        finally:
            result.close()
