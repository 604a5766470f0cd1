"""What becomes of a result folder when two processes write it, are killed, or the disk is full.

    python benchmarks/result_faults.py [--pairs 100] [--kills 30] [--runs 4] [--seed 1]
                                       [--result FOLDER]

Each trial begins with an earlier result. Afterwards the folder has to hold one whole result
(`read_result` reads it, all of it says the same), the exit codes have to be true, and the next run
has to leave nothing beside it. Processes are forked from one that has a finished inspection in
memory, made now or read from FOLDER. The rows of runs start true `pv-inspect run` commands on a
small simulated sequence. The rows of the
full disk need the right to mount a tmpfs. Linux and macOS only.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.results.folder import reserve_result
from pv_inspect.results.read import read_result
from pv_inspect.results.resume import reopen, resume
from pv_inspect.results.write import write_result
from pv_inspect.simulate import SimulationSettings, simulated, write_sequence
from pv_inspect.storage import folders

FIRST = "earlier"
KILLED = -signal.SIGKILL


def marked(inspection: Inspection, mark: str) -> Inspection:
    """Return a result that can be told from others, in its record and in its image."""
    made = inspection.reconstruction
    assert made is not None
    image = made.image + np.float32(sum(map(ord, mark)))
    return replace(inspection, warnings=(mark,), reconstruction=replace(made, image=image))


def what_is_there(out: Path, inspection: Inspection) -> str:
    """Mark of the whole result that lies there, or what is wrong with it."""
    try:
        found = read_result(out)
    except InspectionError as error:
        return f"BROKEN: {error}"
    (mark,) = found.warnings
    expected = marked(inspection, mark).reconstruction
    assert expected is not None
    return mark if np.array_equal(found.image, expected.image) else "BROKEN: a mixture"


def forked(work: Callable[[], Any]) -> int:
    """Do something in a process of its own; its exit code is 1 if it is refused."""
    pid = os.fork()
    if pid:
        return pid
    code = 70
    try:
        work()
        code = 0
    except InspectionError:
        code = 1
    finally:
        os._exit(code)


def ended(pid: int) -> int:
    """Wait for a process; its exit code, negative if a signal ended it."""
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


class Trials:
    """Counts what became of the folder in the trials of one row."""

    def __init__(self, what: str, inspection: Inspection, folder: Path) -> None:
        self.what, self.inspection, self.out = what, inspection, folder / "out"
        self.found: Counter[str] = Counter()
        self.codes: Counter[str] = Counter()
        self.bad: list[str] = []
        self.left = 0

    def begin(self) -> None:
        """Put an earlier result there, and nothing else."""
        for path in self.out.parent.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        write_result(marked(self.inspection, FIRST), self.out)
        (self.out / "note.txt").write_text("not ours")

    def judge(self, codes: dict[str, int], may: set[str] | None = None) -> None:
        """Look at the folder after processes have ended; ``codes`` by mark."""
        found = what_is_there(self.out, self.inspection)
        winners = {mark for mark, code in codes.items() if code == 0}
        if may is None:
            may = winners or {FIRST}
        self.found["earlier" if found == FIRST else "broken" if "BROKEN" in found else "new"] += 1
        self.codes["+".join(str(code) for code in sorted(codes.values()))] += 1
        if found not in may or any(code not in (0, 1, KILLED) for code in codes.values()):
            self.bad.append(f"{found} after {codes}")
        if not (self.out / "note.txt").is_file():
            self.bad.append("the user's file is gone")
        write_result(marked(self.inspection, "next"), self.out)
        self.left += len(list(self.out.parent.iterdir())) - 1

    def tell(self) -> None:
        """Print the row."""
        n = sum(self.found.values())
        codes = ", ".join(f"{code}: {k}" for code, k in sorted(self.codes.items()))
        row = f"{self.what:46}{n:5}{self.found['earlier']:9}{self.found['new']:6}"
        print(f"{row}{self.found['broken']:8}{len(self.bad):8}{self.left:6}  {codes}", flush=True)
        for text in self.bad[:5]:
            print(f"    {text}")


def pairs(trials: Trials, n: int, rng: np.random.Generator, seconds: float, as_run: bool) -> None:
    """Two processes write to one folder, the second a random time after the first."""

    def write(mark: str, wait_s: float) -> None:
        made = marked(trials.inspection, mark)
        time.sleep(wait_s)
        if not as_run:
            write_result(made, trials.out)
            return
        with reserve_result(trials.out) as place:  # as a run does: refused before it computes
            write_result(made, trials.out, place)

    for _ in range(n):
        trials.begin()
        # After a run that was refused at once the other one may be long done: then both succeed.
        wait_s = rng.uniform(0, seconds)
        pids = {
            "A": forked(lambda: write("A", 0.05)),
            "B": forked(lambda wait_s=wait_s: write("B", 0.05 + wait_s)),
        }
        trials.judge({mark: ended(pid) for mark, pid in pids.items()})
    trials.tell()


def aimed_kills(trials: Trials, n: int, rng: np.random.Generator, exchanged: bool) -> None:
    """Kill at the step between the old and the new name, or some microseconds around it."""

    def write() -> None:
        real, rename = folders.exchange, Path.rename

        def die() -> None:
            os.kill(os.getpid(), signal.SIGKILL)

        moment = rng.integers(3)

        def exchange(a: Path, b: Path) -> bool:
            if not exchanged:
                return False
            if moment == 0:
                die()
            if moment == 1:  # from outside, at no moment that we choose
                os.posix_spawn("/bin/kill", ["kill", "-9", str(os.getpid())], {})
                time.sleep(rng.uniform(0, 0.003))
            done = real(a, b)
            if moment == 2:
                die()
            return done

        def cut(self: Path, target: Path) -> Path:
            moved = rename(self, target)
            if self == trials.out:
                assert not trials.out.exists()
                die()
            return moved

        folders.exchange = exchange
        if not exchanged:
            Path.rename = cut  # type: ignore[method-assign,assignment]
        write_result(marked(trials.inspection, "A"), trials.out)
        time.sleep(1)
        die()

    for _ in range(n):
        trials.begin()
        rng.integers(3)  # each child has its own moment
        code = ended(forked(write))
        trials.judge({"A": code}, {FIRST, "A"} if exchanged else {FIRST})
    trials.tell()


def random_kills(trials: Trials, n: int, rng: np.random.Generator, seconds: float) -> None:
    """Kill a process at a random moment of its writing."""
    for _ in range(n):
        trials.begin()
        made = marked(trials.inspection, "A")
        pid = forked(lambda made=made: write_result(made, trials.out))
        time.sleep(rng.uniform(0, 2 * seconds))  # some are done by then
        os.kill(pid, signal.SIGKILL)
        code = ended(pid)
        trials.judge({"A": code}, {"A"} if code == 0 else {FIRST, "A"})
    trials.tell()


def full_disks(trials: Trials, folder: Path) -> None:
    """Write to disks that are full after a part of the new result."""
    trials.begin()
    size = sum(p.stat().st_blocks * 512 for p in trials.out.rglob("*") if p.is_file())
    for share in (0.0, 0.05, 0.3, 0.6, 0.9, 0.97, 1.5):
        room = int(size + share * size) // 4096 * 4096 + 16 * 4096
        disk = folder / "disk"
        disk.mkdir(exist_ok=True)
        mount = ["mount", "-t", "tmpfs", "-o", f"size={room}", "none", str(disk)]
        if subprocess.run(mount, capture_output=True).returncode:
            print(f"{trials.what:46} not done: no right to mount a tmpfs")
            return
        try:
            trials.out = disk / "out"
            trials.begin()
            code = ended(forked(lambda: write_result(marked(trials.inspection, "A"), trials.out)))
            beside = len(list(disk.iterdir())) - 1
            found = what_is_there(trials.out, trials.inspection)
            trials.found["earlier" if found == FIRST else "new" if found == "A" else "broken"] += 1
            trials.codes[str(code)] += 1
            trials.left += beside
            if found != ("A" if code == 0 else FIRST):
                trials.bad.append(f"{found} after exit code {code}")
        finally:
            subprocess.run(["umount", str(disk)], check=True)
    trials.tell()


def command(frames: Path, out: Path, threshold: float) -> subprocess.Popen[bytes]:
    """Start a true run; the threshold tells its result from others."""
    said = ("--out", str(out), "--crack-threshold", str(threshold), "-m", "1", "-q")
    return subprocess.Popen(
        [sys.executable, "-m", "pv_inspect", "run", str(frames), *said], stderr=subprocess.DEVNULL
    )


def run_pairs(frames: Path, folder: Path, n: int, rng: np.random.Generator, kill: bool) -> None:
    """Start two true runs at a random distance, or kill one at a random moment."""
    out = folder / "out"
    shutil.rmtree(out, ignore_errors=True)
    begun = time.perf_counter()
    command(frames, out, 0.3).wait()
    seconds = time.perf_counter() - begun
    last, found, codes, bad = 0.3, Counter[str](), Counter[str](), 0
    for k in range(n):
        thresholds = [0.4 + 0.01 * k, 0.6 + 0.01 * k]
        first = command(frames, out, thresholds[0])
        time.sleep(rng.uniform(0, seconds))
        if kill:
            first.kill()
            ends = [first.storage.wait()]
        else:
            second = command(frames, out, thresholds[1])
            ends = [first.storage.wait(), second.storage.wait()]
        good = [t for t, code in zip(thresholds, ends, strict=False) if code in (0, 3)]
        may = good or [last]
        if kill and KILLED in ends:
            may = [last, thresholds[0]]
        try:
            now = read_result(out).settings.crack_threshold
            found["earlier" if now == last else "new"] += 1
            bad += now not in may
            last = float(now or 0)
        except InspectionError as error:
            print(f"    {error}")
            found["broken"] += 1
            bad += 1
        codes["+".join(str(code) for code in sorted(ends))] += 1
    if kill:
        ended_well = command(frames, out, 0.3).wait()
        bad += ended_well not in (0, 3)
    left = len(list(folder.iterdir())) - 1
    what = "a run killed at a random moment" if kill else "pairs of runs"
    row = f"{what + f' ({seconds:.0f} s each)':46}{n:5}{found['earlier']:9}{found['new']:6}"
    text = ", ".join(f"{code}: {k}" for code, k in sorted(codes.items()))
    print(f"{row}{found['broken']:8}{bad:8}{left:6}  {text}", flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=100)
    parser.add_argument("--kills", type=int, default=30)
    parser.add_argument("--runs", type=int, default=4)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--result", type=Path, help="a result whose frames are still there")
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    settings = SimulationSettings(
        rows=3, cols=4, n_frames=6, width=200, height=160, pixels_per_unit=60, seed=3
    )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        frames = folder / "frames of a module"
        (folder / "made").mkdir()
        if options.runs or options.result is None:
            write_sequence(simulated(settings), frames)
        if options.result is None:
            command(frames, folder / "made" / "out", 0.5).wait()
        result = read_result(options.result or folder / "made" / "out")
        inspection = resume(result, reopen(result))
        begun = time.perf_counter()
        for _ in range(3):
            write_result(marked(inspection, "A"), folder / "made" / "out")
        seconds = (time.perf_counter() - begun) / 3

        def row(what: str) -> Trials:
            place = folder / what.replace(" ", "-")
            place.mkdir()
            return Trials(what, inspection, place)

        print(f"One result is written in {seconds:.2f} s. Exit codes of a pair: sorted, A+B.")
        head = f"{'':46}{'n':>5}{'earlier':>9}{'new':>6}{'broken':>8}{'untrue':>8}{'left':>6}"
        print(f"{head}  exit codes", flush=True)
        pairs(row("pairs that save, each waits"), options.pairs, rng, seconds, as_run=False)
        pairs(row("pairs that reserve, as runs do"), options.pairs, rng, seconds, as_run=True)
        aimed_kills(row("killed around the exchange"), options.kills, rng, exchanged=True)
        aimed_kills(row("killed between two renames"), options.kills, rng, exchanged=False)
        random_kills(row("killed at a random moment of writing"), options.pairs, rng, seconds)
        full_disks(row("disk full after 0 to 97 % of it, and not"), folder)
        for kill in (False, True) if options.runs else ():
            place = folder / f"runs-{kill}"
            place.mkdir()
            run_pairs(frames, place, options.runs, rng, kill)


if __name__ == "__main__":
    main()
