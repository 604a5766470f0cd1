"""How long a test waits for what must happen: one limit for all, which no busy machine reaches."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic, sleep
from typing import Any

LONG_S = 120.0
"""A test that waits this long has failed. On idle cores the longest wait takes about 3 s."""
LONG_MS = int(1000 * LONG_S)


def wait_until(
    happened: Callable[[], Any], meanwhile: Callable[[], Any] = lambda: None, what: str = ""
) -> None:
    """Return once something has happened; fail when it has not after `LONG_S`.

    Parameters
    ----------
    happened : callable
    meanwhile : callable
        Called between two looks: what hands over the results of background work.
    what : str
        What is waited for, for the message.
    """
    end = monotonic() + LONG_S
    while not happened():
        assert monotonic() < end, f"in vain: {what}" if what else "waited in vain"
        sleep(0.005)
        meanwhile()
