"""Memory: what a run has used goes back to the system, what lives on is not looked at again."""

from __future__ import annotations

import ctypes
import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["few_arenas", "left_alone", "release"]

# Of glibc's malloc.h.
_M_ARENA_MAX = -8


def few_arenas() -> None:
    """Let all threads take their memory from two places; to be called before a window is made.

    glibc gives up to 8 places per core to the threads, and each keeps the end of what it had for
    itself, which no `release` gets back: with the short-lived threads of a run that is some 200 MiB
    after a few runs. Nothing happens on other systems.
    """
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
        if mallopt is not None:
            mallopt(_M_ARENA_MAX, 2)


def release() -> None:
    """Hand free pages back, in a few milliseconds.

    glibc keeps what worker threads have freed for later threads, which do not always reuse it: run
    after run the window would grow. Other systems hand it back by themselves.
    """
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)


@contextmanager
def left_alone() -> Iterator[None]:
    """Let Python's garbage collector pass over all that lives now, until the end of the context.

    A window of napari holds some 300,000 objects for as long as it is open. To look at all of them
    takes a quarter of a second, and that at any moment: while a slider moves, say.
    """
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
