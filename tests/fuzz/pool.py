"""Readers in a process of their own, which may crash, hang or grow."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Self

from tests.fuzz.case import MOST_MIB, Case, Outcome

__all__ = ["Reader"]

ROOT = Path(__file__).resolve().parents[2]
# A process that waits for something that never comes costs no processor time. On a busy machine a
# case may take long, but it gets on.
_IDLE_S = 10.0
_WAITS_S = 300.0
# A new process now and then: what one case leaves behind must not add up over thousands.
_CASES = 2000


class Reader:
    """A worker process that is started when needed and again after a crash."""

    def __init__(self) -> None:
        # In memory where there is such a place: thousands of small files are written.
        memory = Path("/dev/shm")
        place = memory if os.access(memory, os.W_OK) else None
        self._folder = Path(tempfile.mkdtemp(prefix="pv-inspect-fuzz-", dir=place))
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None
        self._cases = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop()
        shutil.rmtree(self._folder, ignore_errors=True)

    def read(self, case: Case) -> Outcome:
        """Let the worker read a case."""
        if self._cases >= _CASES:
            self._stop()
        if self._process is None:
            self._start()
        self._cases += 1
        assert self._process is not None
        assert self._connection is not None
        try:
            self._connection.send(case)
            if not self._answered():
                self._stop()
                return Outcome(fault="did not end, waiting for something")
            outcome: Outcome = self._connection.recv()
        except (EOFError, OSError):
            return Outcome(fault=self._died())
        if outcome.peak_mib > MOST_MIB:  # give it back
            self._stop()
        return outcome

    def _answered(self) -> bool:
        assert self._connection is not None
        used = self._used()
        for _ in range(round(_WAITS_S / _IDLE_S)):
            if self._connection.poll(_IDLE_S):
                return True
            before, used = used, self._used()
            if before is not None and used == before:
                return False
        return False

    def _used(self) -> str | None:
        """Processor time of the worker, in the system's own words; None where it does not tell."""
        assert self._process is not None
        try:
            fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return None
        return " ".join(fields[11:13])

    def _start(self) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)
        self._folder.mkdir()
        ours, theirs = Pipe()
        path = os.pathsep.join([str(ROOT), str(ROOT / "plugins"), os.environ.get("PYTHONPATH", "")])
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.fuzz.worker", str(theirs.fileno()), str(self._folder)],
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            cwd=ROOT,
            env={**os.environ, "PYTHONPATH": path, "QT_QPA_PLATFORM": "offscreen"},
        )
        theirs.close()
        self._connection, self._cases = ours, 0

    def _died(self) -> str:
        assert self._process is not None
        code = self._process.wait()
        output = self._folder / "output"
        said = output.read_text(errors="replace") if output.is_file() else ""
        said = said.partition("\nExtension modules")[0][-1500:]
        self._stop()
        if code == -signal.SIGXCPU:
            return f"did not end: {said}"
        name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return f"the process died of {name}: {said}"

    def _stop(self) -> None:
        if self._connection is not None:
            self._connection.close()
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        self._process = self._connection = None
        self._cases = 0
