"""How long the database of a review takes: storing, undoing, reading.

    python benchmarks/review.py [FOLDER]

FOLDER is where the database is made and removed again; the disk it lies on decides. What the disk
needs to make one write durable is measured as well: a verdict needs some four of these.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np

from pv_inspect.review import ReviewStore, Verdict, VerdictKind

N = 100
HISTORY = 500
KINDS = list(VerdictKind)


def timed(what: str, act: Callable[[int], object], n: int = N) -> None:
    """Print median and 95th percentile of ``n`` calls."""
    seconds = []
    for i in range(n):
        begun = perf_counter()
        act(i)
        seconds.append(perf_counter() - begun)
    median, high = 1e3 * np.percentile(seconds, [50, 95])
    print(f"{what:32}{median:10.1f}{high:10.1f}")


def main() -> None:
    """Print a table in milliseconds."""
    with tempfile.TemporaryDirectory(dir=sys.argv[1] if sys.argv[1:] else None) as name:
        folder = Path(name)
        print(f"{'milliseconds':32}{'median':>10}{'95 %':>10}")
        handle = os.open(folder / "plain", os.O_CREAT | os.O_WRONLY)

        def durable(_: int) -> None:
            os.write(handle, bytes(4096))
            os.fsync(handle)

        timed("one durable write of the disk", durable)
        os.close(handle)
        rng = np.random.default_rng(0)
        mask = rng.random((600, 600)) < 0.01
        with ReviewStore(folder) as store:
            timed(
                "give a verdict",
                lambda i: store.give(Verdict(i // 10 % 6, i % 10, KINDS[i % 8], "Ann")),
                HISTORY,
            )
            timed("undo", lambda _: store.undo("Ann"))
            timed("redo", lambda _: store.redo("Ann"))
            timed("correct a mask of 600 x 600 px", lambda _: store.correct((0, 0), "Ann", mask))
            timed("read all current verdicts", lambda _: store.current())
            timed("read a mask", lambda _: store.mask((0, 0), "Ann"))
            timed("ask whether others have stored", lambda _: store.data_version())


if __name__ == "__main__":
    main()
