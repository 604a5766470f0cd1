"""Limits what malloc and the garbage collector cost a window that stays open for hours."""

from __future__ import annotations

import ctypes
import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["gc_frozen", "limit_malloc_arenas"]

# Of glibc's malloc.h.
_M_ARENA_MAX = -8


def limit_malloc_arenas() -> None:
    """Limit glibc's malloc to two arenas for all threads; call it before a window is made.

    glibc gives threads up to 8 arenas per core, and the end of each is never handed back to the
    system: with the short-lived threads of a run that is some 200 MiB after a few runs. Other
    systems are left as they are.
    """
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
        if mallopt is not None:
            mallopt(_M_ARENA_MAX, 2)


@contextmanager
def gc_frozen() -> Iterator[None]:
    """Exclude all objects that exist now from garbage collection inside the context.

    A window of napari holds some 300,000 objects for as long as it is open. Collecting over all of
    them takes a quarter of a second, at any moment: while a slider moves, say.
    """
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
