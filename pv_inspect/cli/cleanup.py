"""What a command holds while it works, and what it can truly say when it is stopped."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from types import TracebackType
from typing import Self, TypeVar

from pv_inspect.common import signals

__all__ = ["Cleanup"]

T = TypeVar("T")


class Cleanup:
    """From here on a signal lets the work clean up behind itself; before, it just ends it.

    Attributes
    ----------
    written_so_far : callable
        Tells, as a part of a sentence, what has been written at this moment.
    said : str
        What it told when the work was stopped.
    """

    def __init__(self) -> None:
        self._stack = ExitStack()
        self.written_so_far: Callable[[], str] = lambda: "nothing was written"
        self.said = ""

    def begin(self) -> None:
        """Begin what has to be cleaned up when it is stopped."""
        signals.raise_from_now()

    def hold(self, held: AbstractContextManager[T]) -> T:
        """Begin, and hold something until the command ends."""
        self.begin()
        return self._stack.enter_context(held)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        stop = signals.came()
        if stop is not None or isinstance(error, KeyboardInterrupt):
            self.said = self.written_so_far()
        try:
            self._stack.__exit__(kind, error, trace)
        finally:
            signals.ignore()
        if stop is not None and error is not None:
            raise stop from None  # whatever became of it on the way
