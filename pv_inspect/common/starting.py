"""A signal while the command starts ends it with one sentence: nothing is at work yet.

Loaded first of all, and with next to nothing: the imports of a command take up to a second.
"""

from __future__ import annotations

import os
import signal
import sys

__all__ = ["NUMBERS", "exit_at_once", "is_the_command", "word_of"]

NUMBERS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
"""Signals that ask a process to end."""

_WORDS = {"SIGINT": "Interrupted", "SIGTERM": "Terminated", "SIGHUP": "The terminal was closed"}
_SCRIPTS = ("pv-inspect", "pv-inspect.exe", "pv-inspect-script.py")


def is_the_command() -> bool:
    """Whether this process is the command ``pv-inspect``, and not somebody who imports us."""
    # While Python looks for a module to run, "-m" stands for its path.
    if sys.argv[:1] == ["-m"]:
        return "pv_inspect" in sys.orig_argv
    return bool(sys.argv) and os.path.basename(sys.argv[0]) in _SCRIPTS  # noqa: PTH119


def exit_at_once() -> None:
    """From now on a signal ends the process on the spot."""
    for number in NUMBERS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as `nohup` has it
            signal.signal(number, _exit)


def word_of(number: int) -> str:
    """What has stopped the process, as the first words of a sentence."""
    return _WORDS.get(signal.Signals(number).name, "Stopped")


def _exit(number: int, _: object) -> None:
    os.write(2, f"pv-inspect: {word_of(number)}; nothing was written.\n".encode())
    os._exit(128 + number)
