"""What libraries in C print themselves is kept from the user's terminal."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TypeVar

import cv2

__all__ = ["heard_on_stderr", "silent_opencv"]

T = TypeVar("T")
_STDERR = 2

_silence = threading.Lock()
_silent_users = 0
_level_before = 0
_redirection = threading.Lock()


@contextmanager
def silent_opencv() -> Iterator[None]:
    """Keep OpenCV from logging; for several threads at a time."""
    global _silent_users, _level_before
    with _silence:
        if _silent_users == 0:
            _level_before = cv2.utils.logging.getLogLevel()
            cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        _silent_users += 1
    try:
        yield
    finally:
        with _silence:
            _silent_users -= 1
            if _silent_users == 0:
                cv2.utils.logging.setLogLevel(_level_before)


def heard_on_stderr(action: Callable[[], T], ours: Callable[[str], bool]) -> tuple[T, list[str]]:
    """Do something and hear what is written to the process's stderr meanwhile.

    libjpeg writes there, past Python and past OpenCV's log, and nowhere else says that data are
    damaged. One thread at a time.

    Parameters
    ----------
    action : callable
    ours : callable
        Whether a line was caused by ``action``; what other threads wrote is passed on.

    Returns
    -------
    result
        What ``action`` returned.
    lines : list of str
        The lines that are ours; empty where the process has no stderr.
    """
    with _redirection:
        try:
            before = os.dup(_STDERR)
        except OSError:
            return action(), []
        with suppress(AttributeError, ValueError, OSError):  # none, or closed
            sys.stderr.flush()
        reading, writing = os.pipe()
        for end in (reading, writing):  # rather lose lines than wait
            os.set_blocking(end, False)
        try:
            os.dup2(writing, _STDERR)
            os.close(writing)
            result = action()
        finally:
            os.dup2(before, _STDERR)
            os.close(before)
            heard = _emptied(reading).decode(errors="replace").splitlines(keepends=True)
            with suppress(OSError):
                os.write(_STDERR, "".join(line for line in heard if not ours(line)).encode())
    return result, [line.strip() for line in heard if ours(line)]


def _emptied(pipe: int) -> bytes:
    parts = []
    with suppress(BlockingIOError):
        while part := os.read(pipe, 65536):
            parts.append(part)
    os.close(pipe)
    return b"".join(parts)
