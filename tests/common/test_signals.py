"""Whatever ends a command, it cleans up, says one sentence that is true, and has its exit code."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.waiting import LONG_S

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals are POSIX's")

# The command as it is, with a run that works until it is told to stop.
COMMAND = """
import sys
from pathlib import Path
sys.argv = ["pv-inspect", "run", {frames!r}, "--out", {out!r}, "-q"]
import pv_inspect
from pv_inspect import __main__, pipeline
from pv_inspect.cli import app as cli
from pv_inspect.results import write as results
from pv_inspect.sequence import sequence
from pv_inspect.storage import folders
from pv_inspect.inspection.inspection import Step
from pv_inspect.settings import Stage
from tests.handmade import made_inspection

{changes}
__main__.main()
"""
WAITS = """
def inspect_steps(*_):
    Path({ready!r}).touch()
    for _ in range(6000):
        yield Step(Stage.DETECT, 0.0, "looking")
        time.sleep(0.01)

import time
pipeline.inspect_steps = inspect_steps
"""
LOSES_IT = """
import time

def inspect_steps(*_):
    yield Step(Stage.DETECT, 0.0, "looking")
    try:
        Path({ready!r}).touch()
        time.sleep(60)
    except BaseException:
        {lost}
    yield Step(Stage.DETECT, 0.5, "looking")
    raise AssertionError("went on")

pipeline.inspect_steps = inspect_steps
"""
ENDS_AFTER_THE_EXCHANGE = """
import os, signal, time

def inspect_steps(*_):
    return made_inspection()
    yield

real = folders.exchange
def exchange(a, b):
    done = real(a, b)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(0.05)
    return done

pipeline.inspect_steps = inspect_steps
folders.exchange = exchange
"""


@pytest.fixture
def stopped(tmp_path: Path) -> Callable[..., tuple[int, str]]:
    """Run the command on a folder of frames and send it a signal when it is at work."""
    import numpy as np
    import tifffile

    frames = tmp_path / "frames"
    frames.mkdir()
    for k in range(3):
        noise = np.random.default_rng(k).integers(0, 9000, (96, 128))
        tifffile.imwrite(frames / f"f{k}.tif", noise.astype(np.uint16))
    (frames / "module.json").write_text('{"rows": 2, "cols": 3}')

    def run(changes: str, number: int | None) -> tuple[int, str]:
        ready = tmp_path / "ready"
        code = COMMAND.format(
            frames=str(frames),
            out=str(tmp_path / "results" / "out"),
            changes=changes.replace("{ready!r}", repr(str(ready))),
        )
        process = subprocess.Popen(
            [sys.executable, "-c", code],
            stderr=subprocess.PIPE,
            text=True,
            cwd=Path(__file__).parents[2],
        )
        if number is not None:
            while not ready.exists() and process.poll() is None:
                time.sleep(0.01)
            process.send_signal(number)
        said = process.communicate(timeout=LONG_S)[1]
        ready.unlink(missing_ok=True)
        return process.returncode, said

    return run


@pytest.mark.parametrize(
    ("number", "code", "word"),
    [(signal.SIGTERM, 143, "Terminated"), (signal.SIGINT, 130, "Interrupted")],
)
def test_a_run_that_is_stopped_leaves_nothing_and_says_so(
    tmp_path: Path, stopped: Callable[..., tuple[int, str]], number: int, code: int, word: str
) -> None:
    said = f"pv-inspect: {word}; nothing was written.\n"
    assert stopped(WAITS, number) == (code, said)
    assert {path.name for path in tmp_path.iterdir()} == {"frames"}


@pytest.mark.parametrize("lost", ["pass", 'raise SystemError("in compiled code") from None'])
def test_a_signal_that_is_lost_on_the_way_ends_the_run_all_the_same(
    tmp_path: Path, stopped: Callable[..., tuple[int, str]], lost: str
) -> None:
    code, said = stopped(LOSES_IT.replace("{lost}", lost), signal.SIGTERM)
    assert (code, said) == (143, "pv-inspect: Terminated; nothing was written.\n")
    assert not (tmp_path / "results").exists()


def test_a_signal_during_the_exchange_lets_it_end_and_the_new_result_is_told(
    tmp_path: Path, stopped: Callable[..., tuple[int, str]]
) -> None:
    from pv_inspect.results.read import read_result
    from pv_inspect.results.write import write_result
    from tests.handmade import made_inspection

    out = tmp_path / "results" / "out"
    write_result(made_inspection(warnings=("first",)), out)
    code, said = stopped(ENDS_AFTER_THE_EXCHANGE, None)
    assert (code, said) == (143, f"pv-inspect: Terminated; the new result is in {out}.\n")
    assert read_result(out).warnings != ("first",)
    assert os.listdir(out.parent) == ["out"]  # noqa: PTH208


def test_a_signal_while_the_command_loads_is_one_sentence_without_a_traceback() -> None:
    """Sent by the first import that comes after the package itself."""
    code = (
        "import os, signal, sys\n"
        "class Finder:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'typer':\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Finder())\n"
        "sys.argv = ['pv-inspect', '--version']\n"
        "from pv_inspect.__main__ import main\n"
        "main()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 130
    assert done.stderr == "pv-inspect: Interrupted; nothing was written.\n"
    assert done.stdout == ""


def test_who_imports_the_package_keeps_its_own_signals() -> None:
    code = (
        "import signal, pv_inspect, pv_inspect.cli.app\n"
        "assert signal.getsignal(signal.SIGINT) is signal.default_int_handler\n"
        "assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
