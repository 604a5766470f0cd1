"""Several independent pieces of work at once, on the cores that compiled code may use."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from threading import RLock
from typing import TypeVar

import numba
import numpy as np
from numba.np.ufunc.parallel import threading_layer

from pv_inspect.common.compiling import compiled

__all__ = ["one_at_a_time", "parallel_map"]

A = TypeVar("A")
B = TypeVar("B")

_turn = RLock()


def parallel_map(function: Callable[[A], B], items: Iterable[A]) -> list[B]:
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


@contextmanager
def one_at_a_time() -> Iterator[None]:
    """Let one thread at a time work in here, if compiled code may not be entered from several.

    Where numba has no OpenMP it would end the process: when a cell is shown while a run goes on.
    """
    with nullcontext() if _may_be_shared() else _turn:
        yield


def _may_be_shared() -> bool:
    """Whether compiled code may be entered from several threads: numba's own pool forbids it."""
    try:
        layer = threading_layer()  # type: ignore[no-untyped-call]
    except ValueError:
        # It is known only once parallel code has run.
        with _turn:
            _fill(np.zeros(1))
        layer = threading_layer()  # type: ignore[no-untyped-call]
    return bool(layer != "workqueue")


@compiled(parallel=True)
def _fill(values):  # type: ignore[no-untyped-def]
    for k in numba.prange(len(values)):
        values[k] = 1.0
