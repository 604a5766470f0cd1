from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from pytestqt.qtbot import QtBot

from napari_pv_inspect.models.workbench import RunState, WorkbenchModel
from napari_pv_inspect.tasks.run import RunController
from pv_inspect.errors import InspectionError
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Stage


@pytest.fixture
def runs(tiny_sequence: FrameSequence, qtbot: QtBot) -> RunController:
    model = WorkbenchModel()
    model.open(tiny_sequence)
    model.change_settings(magnification=2.0, max_iterations=5)
    return RunController(model)


def wait_until_idle(runs: RunController, qtbot: QtBot) -> None:
    qtbot.waitUntil(lambda: runs.model.run_state is RunState.IDLE)


def test_a_run_brings_the_whole_inspection(
    runs: RunController, replayed: Any, qtbot: QtBot
) -> None:
    assert runs.start()
    wait_until_idle(runs, qtbot)
    assert runs.model.inspection is not None
    assert runs.model.inspection.complete
    assert replayed.closed == 1


def test_a_second_start_is_refused_while_a_run_goes_on(
    runs: RunController, replayed: Any, qtbot: QtBot
) -> None:
    replayed.go_on = False
    assert runs.start()
    assert not runs.start()
    replayed.go_on = True
    wait_until_idle(runs, qtbot)
    assert len(replayed.starts) == 1


def test_run_cancel_run(runs: RunController, replayed: Any, qtbot: QtBot) -> None:
    replayed.go_on = False
    runs.start()
    qtbot.waitUntil(lambda: runs.model.draft.registration is not None)
    runs.cancel()
    wait_until_idle(runs, qtbot)
    assert replayed.closed == 1, "the generator is closed, so that its memory is free"
    assert runs.model.inspection is not None
    assert not runs.model.inspection.complete
    replayed.go_on = True
    assert runs.start()
    wait_until_idle(runs, qtbot)
    assert replayed.starts[1] is not None
    assert replayed.starts[1].registration is replayed.inspection.registration
    assert runs.model.inspection.complete


def test_detect_stops_after_the_calibration(
    runs: RunController, replayed: Any, qtbot: QtBot
) -> None:
    runs.start(until=Stage.CALIBRATE)
    wait_until_idle(runs, qtbot)
    assert runs.model.inspection is not None
    assert runs.model.inspection.calibration is not None
    assert runs.model.inspection.registration is None


@pytest.mark.parametrize(
    "error",
    [InspectionError("No module was found: check rows."), RuntimeError("oh"), OSError(5, "x")],
)
def test_an_error_ends_the_run_with_one_sentence(
    runs: RunController, replayed: Any, qtbot: QtBot, error: Exception
) -> None:
    notices: list[tuple[str, bool]] = []
    runs.model.noticed.connect(lambda text, is_error: notices.append((text, is_error)))
    replayed.error = error
    runs.start()
    wait_until_idle(runs, qtbot)
    ((text, is_error),) = notices
    assert is_error
    assert str(error) in text
    assert "\n" not in text


def test_shutdown_mid_run_closes_the_pipeline_and_reaches_the_model_no_more(
    runs: RunController, replayed: Any, qtbot: QtBot
) -> None:
    replayed.go_on = False
    runs.start()
    qtbot.waitUntil(lambda: runs.model.draft.registration is not None)
    changes: list[object] = []
    runs.model.inspection_changed.connect(changes.append)
    runs.shutdown()
    assert replayed.closed == 1
    qtbot.wait(100)
    assert changes == []


def test_the_run_of_another_sequence_begins_when_that_of_the_last_one_has_stopped(
    runs: RunController, tiny_folder: Path, replayed: Any, qtbot: QtBot
) -> None:
    replayed.go_on, replayed.busy = False, True
    runs.start()
    qtbot.waitUntil(lambda: runs.model.draft.registration is not None)
    runs.model.open(FrameSequence.open(tiny_folder))
    assert runs.model.inspection is None
    assert replayed.closed == 0, "opening does not wait for the run"
    assert runs.start()
    assert len(replayed.starts) == 1, "two runs never overlap"
    replayed.go_on, replayed.busy = True, False
    wait_until_idle(runs, qtbot)
    assert replayed.closed == 2
    assert len(replayed.starts) == 2
    assert runs.model.inspection is not None
    assert runs.model.inspection.complete


def test_a_run_that_waits_for_another_one_to_stop_can_be_cancelled(
    runs: RunController, tiny_folder: Path, replayed: Any, qtbot: QtBot
) -> None:
    replayed.go_on, replayed.busy = False, True
    runs.start()
    qtbot.waitUntil(lambda: runs.model.draft.registration is not None)
    runs.model.open(FrameSequence.open(tiny_folder))
    runs.start()
    runs.cancel()
    replayed.go_on, replayed.busy = True, False
    wait_until_idle(runs, qtbot)
    assert len(replayed.starts) == 1
    assert runs.start()
    wait_until_idle(runs, qtbot)
    assert runs.model.inspection is not None


@pytest.mark.parametrize("whole", [False, True])
def test_cancelling_says_what_is_kept(
    runs: RunController, replayed: Any, qtbot: QtBot, whole: bool
) -> None:
    if whole:
        runs.model.inspection = replayed.inspection
        runs.model.change_settings(max_iterations=4)
    said: list[str] = []
    runs.model.noticed.connect(lambda text, _: said.append(text))
    replayed.go_on = False
    runs.start()
    qtbot.waitUntil(lambda: runs.model.draft.registration is not None)
    runs.cancel()
    wait_until_idle(runs, qtbot)
    kept = "the last whole result" if whole else "what was found so far"
    assert said == [f"Cancelled; {kept} is kept."]


def test_another_sequence_ends_the_run(
    runs: RunController, replayed: Any, qtbot: QtBot, tiny_folder: Any
) -> None:
    replayed.go_on = False
    runs.start()
    qtbot.waitUntil(lambda: runs.model.draft.crossings is not None)
    runs.model.open(FrameSequence.open(tiny_folder))
    assert runs.model.run_state is RunState.IDLE
    qtbot.wait(50)
    assert runs.model.inspection is None


MANY_SIGNALS = """
from qtpy.QtCore import QCoreApplication, QObject, Signal

class Source(QObject):
    told = Signal(object)

class Sink(QObject):
    def take(self, value):
        pass

app = QCoreApplication([])
source, sink = Source(), Sink()
source.told.connect(sink.take)
for _ in range(20_000):
    source.told.emit(source)
"""


def test_the_installed_qt_survives_the_signals_of_a_long_session() -> None:
    # PySide6 6.12.0 drops a reference to True with every emission, which ends Python 3.11.
    done = subprocess.run(
        [sys.executable, "-c", MANY_SIGNALS], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
