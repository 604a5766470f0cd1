"""Files whose pictures come one after the other: the last one stays open, to go on from there."""

from __future__ import annotations

import atexit
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator
from typing import Any

from numpy.typing import NDArray

from pv_inspect.image_files.problems import damaged

__all__ = ["ForwardReader"]

Pixels = NDArray[Any]

# Threads work on neighbouring frames.
_KEPT = 4


class ForwardReader:
    """Reads the k-th picture of a stream; going far back starts again.

    For several threads, one at a time; they may ask a little out of order.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._key: object = None
        self._stream: Iterator[Pixels] = iter(())
        self._next = 0
        self._last: OrderedDict[int, Pixels] = OrderedDict()
        # While the modules that a stream needs are still there.
        atexit.register(self.close)

    def picture(self, key: object, index: int, begin: Callable[[], Iterator[Pixels]]) -> Pixels:
        """Return picture ``index``.

        Parameters
        ----------
        key : object
            Equal for the same stream of the same state of a file.
        index : int
        begin : callable
            Opens the stream: an iterator over all pictures, which closes what it has opened.

        Raises
        ------
        ImageFileError
            If the stream ends before.
        """
        with self._lock:
            if key == self._key and index in self._last:
                return self._last[index]
            if key != self._key or index < self._next:
                self._close()
                self._stream, self._key = begin(), key
            try:
                while self._next <= index:
                    self._last[self._next] = next(self._stream)
                    self._next += 1
                    if len(self._last) > _KEPT:
                        self._last.popitem(last=False)
            except StopIteration:
                n = self._next
                self._close()
                raise damaged(f"it ends after {n} pictures") from None
            except BaseException:
                self._close()
                raise
            return self._last[index]

    def close(self) -> None:
        """Close what is open."""
        with self._lock:
            self._close()

    def _close(self) -> None:
        close = getattr(self._stream, "close", None)
        if close is not None:
            close()
        self._key, self._stream, self._next = None, iter(()), 0
        self._last.clear()
