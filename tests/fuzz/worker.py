"""A process that reads one case after the other and measures itself.

What the readers print, on whatever way, goes into a file. The processor time of a case is limited,
so that a reader that never ends ends the process; the pool starts another one.
"""

from __future__ import annotations

import faulthandler
import math
import os
import resource
import shutil
import sys
import traceback
import warnings
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from time import process_time

from tests.fuzz.case import MOST_CPU_S, MOST_MIB, Case, Outcome, fault_of

# Ends a reader that does not end by itself; well above what is allowed, to measure the others.
KILLED_AFTER_S = 2 * MOST_CPU_S
# Addresses, not memory in use: keeps the machine alive.
_MOST_ADDRESSES = 8 * 2**30


Read = Callable[[Path, tuple[str, ...]], None]


def main() -> None:
    connection, folder = Connection(int(sys.argv[1])), Path(sys.argv[2])
    output = os.open(folder / "output", os.O_RDWR | os.O_CREAT | os.O_APPEND)
    os.dup2(output, 1)
    os.dup2(output, 2)
    faulthandler.enable(file=output)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    from tests.fuzz.readers import READERS, prepared

    for kind in (RuntimeWarning, UserWarning, ResourceWarning):
        warnings.simplefilter("always", kind)
    with suppress(ValueError, OSError):  # not every system limits it
        resource.setrlimit(resource.RLIMIT_AS, (_MOST_ADDRESSES, resource.RLIM_INFINITY))
    warm: set[str] = set()
    while True:
        try:
            case: Case = connection.recv()
        except EOFError:
            return
        place = folder / "deep" / "down" / "case"  # "../.." does not lead out
        if case.reader not in warm:  # what is compiled or loaded once is not the case's
            prepared(case.reader, place)
            valid = _tried(READERS[case.reader].read, place, READERS[case.reader].args)
            if valid.said or valid.fault:
                connection.send(Outcome(valid.said, f"the valid input is refused: {valid}"))
                continue
            warm.add(case.reader)
        prepared(case.reader, place)
        case.write(place)
        os.ftruncate(output, 0)
        connection.send(_measured(READERS[case.reader].read, place, case, output))
        os.chdir(folder)
        shutil.rmtree(place, ignore_errors=True)


def _measured(read: Read, place: Path, case: Case, output: int) -> Outcome:
    _forget_peak()
    before = _peak_mib()
    begun = _cpu_s()
    _limit_cpu(process_time() + KILLED_AFTER_S)
    try:
        outcome = _tried(read, place, case.args)
    finally:
        _limit_cpu(None)
    cpu_s, grown = _cpu_s() - begun, _peak_mib() - before
    sys.stdout.flush()
    sys.stderr.flush()
    printed = os.pread(output, 2000, 0)
    fault = outcome.fault or (fault_of(outcome.said) if outcome.said else "")
    if not fault and printed:
        fault = f"printed {printed!r}"
    # Before the time: to take memory costs time as well, on a busy machine much.
    if not fault and grown > MOST_MIB:
        fault = f"took {grown:.0f} MiB"
    if not fault and cpu_s > MOST_CPU_S:
        fault = f"took {cpu_s:.1f} s of processor time"
    return Outcome(outcome.said, fault, cpu_s, grown, outcome.where)


def _tried(read: Read, place: Path, args: tuple[str, ...]) -> Outcome:
    from pv_inspect.errors import InspectionError

    os.chdir(place)
    try:
        read(place, args)
    except InspectionError as error:
        return Outcome(str(error) or " ")
    except BaseException as error:
        own = [
            f"{Path(frame.filename).name}:{frame.lineno}"
            for frame in traceback.extract_tb(error.__traceback__)
            if "pv_inspect" in frame.filename or "tests" in frame.filename
        ]
        text = " ".join(str(error).split())[:300]
        return Outcome("", f"{type(error).__name__}: {text}", where=" > ".join(own[-4:]))
    return Outcome()


def _cpu_s() -> float:
    """Processor time of this process and of those that it has started and that have ended."""
    used = os.times()
    return process_time() + used.children_user + used.children_system


def _limit_cpu(at_s: float | None) -> None:
    soft = resource.RLIM_INFINITY if at_s is None else math.ceil(at_s)
    resource.setrlimit(resource.RLIMIT_CPU, (soft, resource.RLIM_INFINITY))


def _forget_peak() -> None:
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:  # then the peak since the start: an upper bound
        return


def _peak_mib() -> float:
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return kib / (2**20 if sys.platform == "darwin" else 2**10)
    return float(status.partition("VmHWM:")[2].split()[0]) / 2**10


if __name__ == "__main__":
    main()
