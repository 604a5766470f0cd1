from __future__ import annotations

import os
import subprocess
import sys
import threading
from contextlib import suppress

import numba
import numpy as np
import pytest

from pv_inspect.common import parallel as concurrency
from pv_inspect.common.parallel import one_at_a_time, parallel_map
from pv_inspect.observation.stencil import dot
from tests.waiting import LONG_S


def test_the_order_is_kept_and_no_thread_lives_on() -> None:
    before = threading.active_count()
    assert parallel_map(lambda n: n * n, range(20)) == [n * n for n in range(20)]
    assert threading.active_count() == before


def test_compiled_code_says_the_same_as_one_by_one() -> None:
    images = np.random.default_rng(0).random((7, 60, 50)).astype(np.float32)
    assert parallel_map(lambda f: dot(f, f), images) == [dot(f, f) for f in images]


def test_the_threads_of_the_caller_stay_as_they_are() -> None:
    threads = numba.get_num_threads()
    parallel_map(lambda n: n, range(3))
    assert numba.get_num_threads() == threads


def test_an_error_reaches_the_caller() -> None:
    with pytest.raises(ZeroDivisionError):
        parallel_map(lambda n: 1 / n, [2, 1, 0])


def test_a_layer_that_cannot_be_shared_is_not_shared(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(concurrency, "threading_layer", lambda: "workqueue")
    assert set(parallel_map(lambda _: threading.get_ident(), range(4))) == {threading.get_ident()}


@pytest.mark.parametrize(("layer", "at_once"), [("workqueue", 1), ("omp", 2)])
def test_where_the_layer_cannot_be_shared_threads_take_turns(
    monkeypatch: pytest.MonkeyPatch, layer: str, at_once: int
) -> None:
    monkeypatch.setattr(concurrency, "threading_layer", lambda: layer)
    inside, most = 0, 0
    met = threading.Barrier(2)

    def work() -> None:
        nonlocal inside, most
        with one_at_a_time(), one_at_a_time():  # the same thread may come in again
            inside += 1
            with suppress(threading.BrokenBarrierError):
                met.wait(0.2 if at_once == 1 else LONG_S)
            most = max(most, inside)
            inside -= 1

    threads = [threading.Thread(target=work) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == at_once


def test_a_cell_is_shown_while_a_run_goes_on_without_openmp() -> None:
    # numba ends the process if two threads come together: so it needs one of its own.
    script = """
from threading import Thread
from pv_inspect.common.parallel import one_at_a_time
from pv_inspect.reconstruction.preview import Preview, Region
from pv_inspect.reconstruction.reconstruct import reconstruct
from tests.recording import recording, settings_with

sequence, registration, _ = recording(6)
settings = settings_with(max_iterations=40)

def run():
    for _ in range(3):
        steps = reconstruct(sequence, registration, settings)
        while True:
            with one_at_a_time():
                if next(steps, None) is None:
                    break

def look():
    view = Preview(sequence, registration)
    for k in range(60):
        view.show(Region(1, 1), settings.changed(prior_weight=0.1 * 1.1**k))

threads = [Thread(target=run), Thread(target=look)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
print("alive")
"""
    done = subprocess.run(
        [sys.executable, "-c", script],
        env={**os.environ, "NUMBA_THREADING_LAYER": "workqueue"},
        capture_output=True,
        text=True,
    )
    assert done.stdout.split() == ["alive"], done.stderr
