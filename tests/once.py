"""What is dear to make and only looked at: one worker makes it, the others read it."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from typing import TypeVar

import pytest

from tests.waiting import wait_until

T = TypeVar("T")


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[], T]) -> T:
    """Return what one of the workers of pytest-xdist has made.

    Parameters
    ----------
    factory : pytest.TempPathFactory
    name : str
        One for each thing; a name of a file.
    make : callable
        Its result can be pickled. If it fails, the other workers wait in vain and say for what.
    """
    if "PYTEST_XDIST_WORKER" not in os.environ:
        return make()
    folder = factory.getbasetemp().parent
    stored = folder / f"{name}.pickle"
    try:
        (folder / f"{name}.claimed").touch(exist_ok=False)
    except FileExistsError:
        wait_until(stored.exists, what=f"{name}, which another worker makes")
        return pickle.loads(stored.read_bytes())
    made = make()
    half = folder / f"{name}.half"
    half.write_bytes(pickle.dumps(made))
    half.rename(stored)
    return made
