"""Long work: a generator that yields how far it is and returns what it made.

Every stage of the method yields `Progress`. A part of a stage yields the bare share of its own
work, which `forwarded` turns into the progress of the whole. Closing a generator cancels the work.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

__all__ = ["Progress", "forwarded", "result_of"]

A = TypeVar("A")
B = TypeVar("B")
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Progress:
    """How far a stage is.

    Parameters
    ----------
    fraction : float
        Share of the work that is done, 0..1.
    message : str
        What is being done.
    image : (height, width) float32, optional
        Current estimate, for previews; it goes on changing.
    """

    fraction: float
    message: str
    image: NDArray[np.float32] | None = None


def forwarded(work: Generator[A, None, T], tell: Callable[[A], B]) -> Generator[B, None, T]:
    """Do a part of one's work by another generator, which says in its own words how far it is.

    Parameters
    ----------
    work : generator
        Closed with this one.
    tell : callable
        Turns what the part yields into what the whole yields.

    Returns
    -------
    object
        What the work returned.
    """
    try:
        while True:
            try:
                item = next(work)
            except StopIteration as end:
                result: T = end.value
                return result
            yield tell(item)
    finally:
        work.close()


def result_of(work: Generator[A, None, T], each: Callable[[A], Any] | None = None) -> T:
    """Drive work to its end.

    Parameters
    ----------
    work : generator
        Closed if ``each`` raises.
    each : callable, optional
        Gets everything that the work yields.

    Returns
    -------
    object
        What the work returned.
    """
    steps = forwarded(work, each or (lambda _: None))
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: T = end.value
            return result
