"""What Ctrl-C, a kill and a closed terminal do to a command: it cleans up and says one sentence."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from time import monotonic
from types import FrameType
from typing import Any

from pv_inspect.common import starting
from pv_inspect.common.starting import NUMBERS, word_of

__all__ = [
    "Stopped",
    "came",
    "check",
    "exit_at_once",
    "held_back",
    "ignore",
    "raise_from_now",
    "stop_code",
    "stop_word",
    "usual",
]

# A second Ctrl-C does not disturb the cleaning; when that has taken so long, it ends the process.
_PATIENCE_S = 5.0

_installed = False
_came = 0
_came_at = 0.0


class Stopped(KeyboardInterrupt):
    """A signal asked the process to end.

    Parameters
    ----------
    number : int
        Of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


def exit_at_once() -> None:
    """From now on a signal ends the process on the spot, with one sentence: nothing is at work."""
    global _installed
    _installed = True
    starting.exit_at_once()


def raise_from_now() -> None:
    """From now on a signal raises `Stopped` where the work is, so that it cleans up.

    Does nothing in a process whose signals are not ours: a notebook, a test, another program.
    """
    if _installed:
        _install(_raise)


def ignore() -> None:
    """The work is done: a signal changes nothing more."""
    if _installed:
        _install(signal.SIG_IGN)


def usual() -> None:
    """Give the signals back to Python and the system."""
    global _installed
    if _installed:
        _installed = False
        _install(signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)


def came() -> Stopped | None:
    """Return what asked this process to end.

    Compiled code and callbacks may turn the exception into another one, or lose it.
    """
    return Stopped(_came) if _came else None


def check() -> None:
    """Raise `Stopped` if this process was asked to end; for the steps of long work."""
    if _came:
        raise Stopped(_came)


def stop_code(error: KeyboardInterrupt) -> int:
    """Exit code for what has stopped the process: 128 and the number of the signal."""
    return 128 + getattr(error, "number", signal.SIGINT)


def stop_word(error: KeyboardInterrupt) -> str:
    """What has stopped the process, as the first words of a sentence."""
    return word_of(getattr(error, "number", signal.SIGINT))


@contextmanager
def held_back() -> Iterator[None]:
    """Finish the block whatever signal comes; it acts when the block has ended."""
    if threading.current_thread() is not threading.main_thread():
        yield  # Python handles signals in the main thread
        return
    came: list[int] = []

    def note(number: int, _: FrameType | None) -> None:
        came.append(number)

    before = {number: signal.signal(number, note) for number in NUMBERS if _is_python(number)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])


def _is_python(number: int) -> bool:
    """Whether the handler can be put back."""
    return signal.getsignal(number) is not None


def _install(handler: Any) -> None:
    for number in NUMBERS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as `nohup` has it
            signal.signal(number, handler)


def _raise(number: int, _: FrameType | None) -> None:
    global _came, _came_at
    if not _came:
        _came, _came_at = number, monotonic()
        raise Stopped(number)
    if monotonic() - _came_at > _PATIENCE_S:
        os._exit(128 + number)
