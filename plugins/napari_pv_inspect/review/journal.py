"""A queue of writes to the store of a review, in a thread of its own. No Qt, no napari.

Storing waits for the disk, so that no other thread may do it. What can't be stored stays first in
the line and is tried again: nothing that was submitted is skipped or overtaken.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from threading import Condition, Thread
from time import monotonic
from typing import Any

from pv_inspect.errors import InspectionError
from pv_inspect.review import ReviewStore

__all__ = ["Journal", "wait_for_all"]

RETRY_S = 2.0
POLL_S = 2.0

Job = Callable[[ReviewStore], Any]
Done = Callable[[Any], None]


@dataclass(frozen=True, eq=False)
class _Entry:
    job: Job
    done: Done


class Journal:
    """Queue of things to store in a result folder.

    Until there is a folder they wait.

    Parameters
    ----------
    on_failure : callable
        Gets one sentence, once per series of failures.
    watch : Job
        Asked every ``poll_s`` while there is nothing to store.
    on_watched : Done
        Gets what ``watch`` returned, unless it is None.
    open_store : callable, optional
        Opens the store of a folder.
    retry_s, poll_s : float

    Notes
    -----
    Callbacks run in the thread that calls `collect`.
    """

    def __init__(
        self,
        on_failure: Callable[[str], None],
        watch: Job,
        on_watched: Done,
        open_store: Callable[[Path], ReviewStore] = ReviewStore,
        retry_s: float = RETRY_S,
        poll_s: float = POLL_S,
    ) -> None:
        self.folder: Path | None = None
        self._on_failure = on_failure
        self._watch = _Entry(watch, on_watched)
        self._open_store = open_store
        self._retry_s, self._poll_s = retry_s, poll_s
        self._changed = Condition()
        self._line: deque[_Entry] = deque()
        self._idle: deque[_Entry] = deque()
        self._finished: deque[Callable[[], None]] = deque()
        self._attempt = self._failed_attempt = 0
        self._failing = self._closing = self._giving_up = self._hurry = False
        self._thread: Thread | None = None

    @property
    def pending(self) -> int:
        """How many things are not stored yet."""
        return len(self._line)

    @property
    def failing(self) -> bool:
        """Whether the last attempt to store something failed."""
        return self._failing

    def submit(self, job: Job, done: Done) -> None:
        """Put something at the end of the queue; ``done`` gets what it returned."""
        with self._changed:
            self._line.append(_Entry(job, done))
            self._changed.notify_all()

    def later(self, job: Callable[[], Any], done: Done) -> None:
        """Have something done when there is nothing to store; at the end it is dropped.

        It is done without a folder too.
        """
        with self._changed:
            self._idle.append(_Entry(lambda _: job(), done))
            self._changed.notify_all()
        self._begin()

    def attach(self, folder: Path, first: Job, done: Done) -> None:
        """Begin to store into a folder; ``first`` goes before all that waits.

        Has no effect on a journal that has its folder.
        """
        if self.folder is not None:
            return
        with self._changed:
            self.folder = folder
            self._line.appendleft(_Entry(first, done))
            self._changed.notify_all()
        self._begin()

    def collect(self) -> None:
        """Report what happened since the last time."""
        while self._finished:
            self._finished.popleft()()

    def wait(self, timeout_s: float) -> bool:
        """Try what failed again now and wait; returns whether everything is stored.

        An attempt that fails ends the wait.
        """
        if self.folder is None:
            return not self._line
        with self._changed:
            self._hurry = True
            self._changed.notify_all()
            before = self._attempt
            self._changed.wait_for(
                lambda: not self._line or self._failed_attempt > before, timeout_s
            )
            return not self._line

    def close(self, give_up: bool) -> None:
        """End the thread as soon as the queue is empty; ``give_up``: also if storing fails."""
        with self._changed:
            self._closing = self._hurry = True
            self._giving_up = give_up
            self._changed.notify_all()

    def _begin(self) -> None:
        if self._thread is None:
            self._thread = Thread(target=self._work, name="pv-inspect review", daemon=True)
            self._thread.start()

    def _work(self) -> None:
        store: ReviewStore | None = None
        try:
            while (entry := self._next()) is not None:
                if store is None and self.folder is not None:
                    store = self._open_store(self.folder)
                self._try(store, entry)
        finally:
            if store is not None:
                store.close()

    def _next(self) -> _Entry | None:
        """Wait for something to do; None: it is time to end."""
        with self._changed:
            if self._failing and self.folder is not None:
                self._changed.wait_for(lambda: self._hurry, self._retry_s)
                self._hurry = False
            else:
                poll_s = None if self.folder is None else self._poll_s
                self._changed.wait_for(self._has_work, poll_s)
            line = self._line if self.folder is not None else ()
            if self._closing and (not line or (self._failing and self._giving_up)):
                return None
            if line:
                self._attempt += 1
                return line[0]
            return self._idle.popleft() if self._idle else self._watch

    def _has_work(self) -> bool:
        return bool((self._line and self.folder) or self._idle or self._closing)

    def _try(self, store: Any, entry: _Entry) -> None:
        try:
            value = entry.job(store)
        except Exception as error:  # the thread must live on: what waits is not lost
            sentence = str(error)
            if not isinstance(error, InspectionError):
                sentence = f"The review can't be stored ({type(error).__name__}: {error})."
            if not self._failing:
                self._finished.append(lambda: self._on_failure(sentence))
            with self._changed:
                self._failing = True
                if entry is not self._watch:
                    self._failed_attempt = self._attempt
                self._changed.notify_all()
            return
        if entry is not self._watch or value is not None:
            self._finished.append(lambda: entry.done(value))
        with self._changed:
            self._failing = False
            if self._line and entry is self._line[0]:
                self._line.popleft()
            self._changed.notify_all()


def wait_for_all(journals: list[Journal], timeout_s: float) -> bool:
    """Wait until all journals have stored everything; False if the time did not suffice."""
    end = monotonic() + timeout_s
    return all(journal.wait(max(end - monotonic(), 0.0)) for journal in journals)
