"""Kill -9 in the middle of it: what was acknowledged is there, the last whole result loads."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from time import sleep
from typing import Any

import numpy as np
import platformdirs
import pytest
from pytestqt.qtbot import QtBot

from napari_pv_inspect.application import build
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.results.read import read_result
from pv_inspect.results.write import write_result
from pv_inspect.review import ReviewStore, VerdictKind
from tests.waiting import LONG_S

pytestmark = pytest.mark.xvfb

START = """
import sys
from pathlib import Path
from qtpy.QtCore import QTimer
import napari_pv_inspect
from napari_pv_inspect import application
from pv_inspect.review import VerdictKind

build = application.build

def say(*words):
    print(*words, flush=True)

def build_and_act(viewer):
    dock, cells = build(viewer)
    timer = QTimer(dock)
    timer.timeout.connect(lambda: act(viewer, dock))
    timer.start(5)
    return dock, cells

application.build = build_and_act
"""

JUDGE = """
kinds, given = list(VerdictKind), []

def act(viewer, dock):
    state = dock.workbench.review.state
    if state.storage.folder is None or state.storage.pending:
        return
    if given:
        say("stored", *given[-1])
    n = len(given)
    cell, kind = (n % 3, n // 3 % 4), kinds[n * 7 // 12 % len(kinds)]
    state.commands.give(cell, kind)
    given.append((*cell, kind.value))

napari_pv_inspect.launch(Path(sys.argv[1]))
"""

RUN = """
weights = [0.5 + 0.01 * k for k in range(400)]

def act(viewer, dock):
    workbench = dock.workbench
    if workbench.model.inspection is None or workbench.opener.busy or workbench.saver.busy:
        return
    if workbench.model.run_state.value != "idle":
        return
    if workbench.model.to_do:
        workbench.runs.start()
        return
    say("whole")
    workbench.saver.save(workbench.model.inspection, Path(sys.argv[1]))
    workbench.model.change_settings(prior_weight=weights.pop())

napari_pv_inspect.launch(Path(sys.argv[1]))
"""


@pytest.fixture
def folder(tiny_inspection: Inspection, tmp_path: Path) -> Path:
    """Return the saved result of the tiny module."""
    write_result(tiny_inspection, tmp_path / "out")
    return tmp_path / "out"


@contextmanager
def killed_at_the_end(script: str, folder: Path) -> Generator[subprocess.Popen[str]]:
    """Run the real application; it gets no chance to say goodbye."""
    config = {"XDG_CONFIG_HOME": str(folder.parent / "config")}
    process = subprocess.Popen(
        [sys.executable, "-c", START + script, str(folder)],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, **config},
    )
    try:
        yield process
    finally:
        process.send_signal(signal.SIGKILL)
        assert process.stdout is not None
        process.stdout.close()
        process.wait(LONG_S)


def test_every_verdict_that_was_acknowledged_is_there_after_kill_9(
    folder: Path,
    make_napari_viewer: Callable[..., Any],
    qtbot: QtBot,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given: dict[tuple[int, int], VerdictKind] = {}
    with killed_at_the_end(JUDGE, folder) as process:
        assert process.stdout is not None
        for _ in range(25):
            word, row, col, kind = process.stdout.readline().split()
            assert word == "stored"
            given[int(row), int(col)] = VerdictKind(kind)
    with ReviewStore(folder) as store:
        found = {verdict.cell: verdict.kind for verdict in store.current()}
    # The last ones may have been stored after what was read here.
    later = {cell for cell in found if found[cell] != given.get(cell)}
    assert set(given) <= set(found)
    assert len(later) < 12
    with ReviewStore(folder) as store:
        (rater,) = {verdict.rater for verdict in store.current()}
    other = str(folder.parent / "other")
    monkeypatch.setattr(platformdirs, "user_config_dir", lambda _: other)
    viewer = make_napari_viewer(show=True)
    dock, _ = build(viewer)
    dock.workbench.review.set_rater(rater)
    dock.workbench.open(folder)
    state = dock.workbench.review.state
    qtbot.waitUntil(lambda: state.storage.folder is not None and state.storage.pending == 0)
    state.storage.collect()
    assert {cell: state.cells.verdict(cell).kind for cell in found} == found


@pytest.mark.parametrize("delay_s", [0.0, 0.05, 0.2, 1.0])
def test_the_last_whole_result_loads_after_kill_9_during_a_run_or_while_saving(
    folder: Path,
    delay_s: float,
    make_napari_viewer: Callable[..., Any],
    qtbot: QtBot,
) -> None:
    with killed_at_the_end(RUN, folder) as process:
        assert process.stdout is not None
        # napari writes its notices there too: with another lambda no cell may be decidable.
        told = (line.strip() for line in process.stdout if not line.startswith("ERROR: In doubt:"))
        assert [next(told) for _ in range(3)] == ["whole"] * 3
        sleep(delay_s)
    result = read_result(folder)
    assert np.isfinite(result.need(Reconstruction).image).any()
    viewer = make_napari_viewer(show=True)
    dock, _ = build(viewer)
    dock.workbench.open(folder)
    qtbot.waitUntil(lambda: not dock.workbench.opener.busy)
    assert dock.workbench.model.inspection is not None
    assert dock.workbench.model.inspection.complete
