"""Connects a dock to the model for as long as the dock lives."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any
from weakref import WeakMethod

from psygnal import SignalInstance

__all__ = ["listen"]


def listen(signal: SignalInstance, method: Callable[..., None]) -> None:
    """Call a method of a widget on every emission, until Qt destroys the widget.

    A closed dock may live on in Python while its part in Qt is gone: without this, the next
    change of the model would call it.
    """
    weak = WeakMethod(method)

    def call(*values: Any) -> None:
        if (bound := weak()) is not None:
            bound(*values)

    signal.connect(call)
    owner = method.__self__  # type: ignore[attr-defined]
    owner.destroyed.connect(partial(_leave, signal, call))


def _leave(signal: SignalInstance, call: Callable[..., None], _: object = None) -> None:
    signal.disconnect(call, missing_ok=True)
