"""Runs requests in one thread; a newer request ends the work on an older one. No Qt."""

from __future__ import annotations

import logging
from collections.abc import Callable
from threading import Condition, Thread

__all__ = ["Job", "NewestWins"]

log = logging.getLogger(__name__)

Job = Callable[[Callable[[], bool]], bool]
"""Work that is given a function which says whether something waits that goes before it.

It returns whether it is done; what was given up is begun again later, unless a newer request came.
"""


class NewestWins:
    """Works on requests by slot; in a slot only the newest is kept.

    Parameters
    ----------
    *slots : str
        The first goes before the others.

    Notes
    -----
    The thread is a daemon: a window that closes never waits for it for long.
    """

    def __init__(self, *slots: str) -> None:
        self._waiting: dict[str, Job | None] = dict.fromkeys(slots)
        self._changed = Condition()
        self._closed = False
        self._thread: Thread | None = None

    def submit(self, slot: str, job: Job) -> None:
        """Request work; what still waits in the slot is dropped."""
        with self._changed:
            if self._closed:
                return
            self._waiting[slot] = job
            if self._thread is None:
                self._thread = Thread(target=self._run, name="live cell", daemon=True)
                self._thread.start()
            self._changed.notify()

    def clear(self) -> None:
        """Drop all waiting requests."""
        with self._changed:
            self._waiting = dict.fromkeys(self._waiting)

    def close(self, wait_s: float = 2.0) -> None:
        """Take no more work; wait briefly for what is under way."""
        with self._changed:
            self._closed = True
            self._waiting = dict.fromkeys(self._waiting)
            self._changed.notify()
        if self._thread is not None:
            self._thread.join(wait_s)

    def _run(self) -> None:
        while (taken := self._next()) is not None:
            slot, job = taken

            def superseded(slot: str = slot) -> bool:
                return self._closed or self._waits_before(slot)

            try:
                done = job(superseded)
            except Exception:
                log.exception("work on the live cell failed")
                continue
            if not done:
                self._put_back(slot, job)

    def _next(self) -> tuple[str, Job] | None:
        with self._changed:
            while not self._closed:
                for slot, job in self._waiting.items():
                    if job is not None:
                        self._waiting[slot] = None
                        return slot, job
                self._changed.wait()
        return None

    def _put_back(self, slot: str, job: Job) -> None:
        with self._changed:
            if not self._closed and self._waiting[slot] is None:
                self._waiting[slot] = job

    def _waits_before(self, slot: str) -> bool:
        """Whether something newer waits in this slot, or something in one that goes before it."""
        for name, job in self._waiting.items():
            if job is not None:
                return True
            if name == slot:
                return False
        return False
