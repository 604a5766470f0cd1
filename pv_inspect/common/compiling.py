"""Compiled functions that are kept for the next start where there is a place for them."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

# Threads that spin while they wait take the processor from those that work. It must be said before
# compiled code starts its threads; whoever has said otherwise is right.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numba
from numba.core.caching import FunctionCache
from numpy.typing import NDArray

__all__ = ["cache_problem", "compiled", "read_only"]

_problems: list[str] = []


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function when it is first called, as `numba.njit` does, and keep the code.

    numba refuses to compile at all where nothing can be kept: a program on a read-only disk, and no
    home folder. Here it then compiles at every start; see `cache_problem`.

    Parameters
    ----------
    **options
        Those of `numba.njit`, without ``cache``.
    """

    def decorated(function: Callable[..., Any]) -> Any:
        dispatcher = numba.njit(**options)(function)
        try:
            kept: Any = _KeptIfPossible
            dispatcher._cache = kept(function)
        except (RuntimeError, OSError) as error:  # nowhere to keep it
            _problems.append(str(error))
        return dispatcher

    return decorated


def read_only(*arrays: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """Views of arrays that can't be written.

    A compiled function is compiled once more for arrays that can be written; its inputs are not.
    """
    views = tuple(array.view() for array in arrays)
    for view in views:
        view.flags.writeable = False
    return views


def cache_problem() -> str:
    """Say in one sentence that compiled code can't be kept; "" if it can, as far as is known."""
    if not _problems:
        return ""
    return (
        "Compiled code can't be kept, so that every start takes about a minute longer: set "
        "NUMBA_CACHE_DIR to a folder that can be written, or make your home folder writable."
    )


class _KeptIfPossible(FunctionCache):
    """Cache of which neither a damaged file nor a full disk stops anything."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except Exception:  # damaged files raise whatever reading them does
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        except Exception as error:
            self.disable()  # type: ignore[no-untyped-call]
            _problems.append(str(error))
