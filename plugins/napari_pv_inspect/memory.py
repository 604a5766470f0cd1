"""Gives memory that a run has used back to the system."""

from __future__ import annotations

import ctypes
import sys

__all__ = ["release"]


def release() -> None:
    """Hand free pages back, in a few milliseconds.

    glibc keeps what worker threads have freed for later threads, which do not always reuse it: run
    after run the window would grow. Other systems hand it back by themselves.
    """
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)
