from __future__ import annotations

import threading

import numba
import numpy as np
import pytest

from pv_inspect import concurrency
from pv_inspect.concurrency import mapped
from pv_inspect.stencil import dot


def test_the_order_is_kept_and_no_thread_lives_on() -> None:
    before = threading.active_count()
    assert mapped(lambda n: n * n, range(20)) == [n * n for n in range(20)]
    assert threading.active_count() == before


def test_compiled_code_says_the_same_as_one_by_one() -> None:
    images = np.random.default_rng(0).random((7, 60, 50)).astype(np.float32)
    assert mapped(lambda f: dot(f, f), images) == [dot(f, f) for f in images]


def test_the_threads_of_the_caller_stay_as_they_are() -> None:
    threads = numba.get_num_threads()
    mapped(lambda n: n, range(3))
    assert numba.get_num_threads() == threads


def test_an_error_reaches_the_caller() -> None:
    with pytest.raises(ZeroDivisionError):
        mapped(lambda n: 1 / n, [2, 1, 0])


def test_a_layer_that_cannot_be_shared_is_not_shared(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(concurrency, "threading_layer", lambda: "workqueue")
    assert set(mapped(lambda _: threading.get_ident(), range(4))) == {threading.get_ident()}
