"""Several independent pieces of work at once, on the cores that compiled code may use."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numba
import numpy as np
from numba.np.ufunc.parallel import threading_layer

from pv_inspect.stencil import dot

__all__ = ["mapped"]

A = TypeVar("A")
B = TypeVar("B")


def mapped(function: Callable[[A], B], items: Iterable[A]) -> list[B]:
    """Return ``[function(item) for item in items]``, several items at once.

    Small pieces of work gain more from this than from threads inside of each: compiled code that
    they call keeps to one thread. No thread lives on after the return.

    Parameters
    ----------
    function : callable
        Must not write what another call reads.
    items : iterable
    """
    every = list(items)
    threads = min(numba.get_num_threads(), len(every))
    if threads < 2 or not _may_be_shared():
        return [function(item) for item in every]
    with ThreadPoolExecutor(threads, initializer=numba.set_num_threads, initargs=(1,)) as pool:
        return list(pool.map(function, every))


def _may_be_shared() -> bool:
    """Whether compiled code may be entered from several threads: numba's own pool forbids it."""
    # The layer is known only once parallel code has run.
    dot(np.zeros((1, 1), np.float32), np.zeros((1, 1), np.float32))
    return bool(threading_layer() != "workqueue")  # type: ignore[no-untyped-call]
