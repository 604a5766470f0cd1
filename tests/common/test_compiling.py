"""Without a place for compiled code everything works, and it is said once."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Generator
from pathlib import Path

import numpy as np
import pytest

from pv_inspect.common import compiling
from pv_inspect.common.compiling import cache_problem, compiled
from pv_inspect.common.work import Progress
from pv_inspect.progress import follow as progress

PACKAGE = Path(compiling.__file__).parents[1]
# Compiles one small function, and follows work as the command line does.
PROGRAM = """
import numpy as np
from pv_inspect.progress.follow import follow
from pv_inspect.common.work import Progress
from pv_inspect.observation.stencil import dot

def work():
    yield Progress(1.0, "work")
    return float(dot(np.ones((2, 3), np.float32), np.ones((2, 3), np.float32)))

print(follow(work(), "work"))
"""


@pytest.fixture
def nowhere(tmp_path: Path) -> dict[str, str]:
    """Environment in which neither the program's folder nor a home can be written.

    Also for the administrator: in the place of the folders there are files.
    """
    shutil.copytree(PACKAGE, tmp_path / "pv_inspect", ignore=shutil.ignore_patterns("__pycache__"))
    for folder in (tmp_path / "pv_inspect").rglob("*"):
        if folder.is_dir():
            (folder / "__pycache__").write_text("no folder")
    (tmp_path / "pv_inspect" / "__pycache__").write_text("no folder")
    kept = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "PYTHONPATH")}
    home = {"HOME": os.devnull, "XDG_CACHE_HOME": f"{os.devnull}/cache", "LOCALAPPDATA": os.devnull}
    return {**kept, **home, "PYTHONPATH": str(tmp_path), "PYTHONWARNINGS": "error"}


def test_without_a_place_for_compiled_code_it_works_and_is_said_once(
    nowhere: dict[str, str], tmp_path: Path
) -> None:
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=nowhere, capture_output=True, text=True, cwd=tmp_path
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout == "6.0\n"
    assert run.stderr.count("Compiled code can't be kept") == 1
    assert "set NUMBA_CACHE_DIR to a folder that can be written" in run.stderr


def test_a_folder_that_is_named_is_used(nowhere: dict[str, str], tmp_path: Path) -> None:
    place = tmp_path / "cache"
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env={**nowhere, "NUMBA_CACHE_DIR": str(place)},
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert (run.returncode, run.stdout) == (0, "6.0\n"), run.stderr
    assert "can't be kept" not in run.stderr
    assert list(place.rglob("*.nbi"))


def twice(x: float) -> float:
    return 2.0 * x


def test_a_disk_that_is_full_and_a_damaged_file_stop_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(compiling, "_problems", [])
    assert compiled()(twice)(2.0) == 4.0
    assert cache_problem() == ""
    kept = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert kept
    for path in kept:
        path.write_bytes(path.read_bytes()[:-7] + b"damaged")
    assert compiled()(twice)(3.0) == 6.0

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile.save", full)
    function = compiled()(twice)
    assert function(np.float32(2.0)) == 4.0
    assert function(4) == 8.0
    assert "set NUMBA_CACHE_DIR" in cache_problem()


def test_quiet_says_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def work() -> Generator[Progress, None, int]:
        yield Progress(1.0, "work")
        return 5

    monkeypatch.setattr(compiling, "_problems", ["no place"])
    assert progress.follow(work(), "work", quiet=True) == 5
    assert capsys.readouterr() == ("", "")
