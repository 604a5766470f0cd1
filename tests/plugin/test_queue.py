from __future__ import annotations

import gc
from typing import Any
from weakref import ref

import pytest
from pytestqt.qtbot import QtBot

from napari_pv_inspect.models.workbench import RunState, WorkbenchModel
from napari_pv_inspect.tasks.run import RunController
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Stage


@pytest.fixture
def runs(tiny_sequence: FrameSequence, qtbot: QtBot) -> RunController:
    model = WorkbenchModel()
    model.open(tiny_sequence)
    model.change_settings(magnification=2.0, max_iterations=5)
    return RunController(model)


def hold(runs: RunController, replayed: Any, qtbot: QtBot) -> None:
    """Start a run and wait until it is in the middle."""
    replayed.go_on = False
    runs.start()
    qtbot.waitUntil(lambda: runs.model.running_stage is Stage.RECONSTRUCT)


def finish(runs: RunController, replayed: Any, qtbot: QtBot) -> None:
    replayed.go_on = True
    qtbot.waitUntil(lambda: runs.model.run_state is RunState.IDLE and not runs.waiting)


def test_a_run_with_changed_settings_takes_the_place_of_the_current_one(
    runs: RunController, replayed: Any, qtbot: QtBot
) -> None:
    hold(runs, replayed, qtbot)
    runs.model.change_settings(prior_weight=0.5)
    assert runs.start()
    qtbot.waitUntil(lambda: len(replayed.starts) == 2)
    assert replayed.closed == 1, "the first one is over before the second begins"
    finish(runs, replayed, qtbot)
    assert runs.model.inspection is not None
    assert runs.model.inspection.settings.prior_weight == 0.5


def test_the_newest_of_many_wishes_is_the_only_one_that_follows(
    runs: RunController, replayed: Any, qtbot: QtBot
) -> None:
    hold(runs, replayed, qtbot)
    for weight in (0.1, 0.2, 0.3):
        runs.model.change_settings(prior_weight=weight)
        assert runs.start()
    finish(runs, replayed, qtbot)
    assert len(replayed.starts) == 2
    assert runs.model.run_settings.prior_weight == 0.3


def test_a_whole_run_follows_the_detection_that_is_under_way(
    runs: RunController, replayed: Any, qtbot: QtBot
) -> None:
    runs.start(until=Stage.CALIBRATE)
    assert runs.start()
    assert runs.waiting
    finish(runs, replayed, qtbot)
    assert len(replayed.starts) == 2
    assert runs.model.inspection is not None
    assert runs.model.inspection.complete


def test_cancel_forgets_the_run_that_waits(
    runs: RunController, replayed: Any, qtbot: QtBot
) -> None:
    hold(runs, replayed, qtbot)
    runs.model.change_settings(prior_weight=0.5)
    runs.start()
    runs.cancel()
    finish(runs, replayed, qtbot)
    qtbot.wait(50)
    assert len(replayed.starts) == 1


def test_a_failure_ends_the_queue_but_not_a_run_with_other_settings(
    runs: RunController, replayed: Any, qtbot: QtBot
) -> None:
    replayed.error = InspectionError("No module was found.")
    runs.start(until=Stage.CELLS)
    runs.start()
    finish(runs, replayed, qtbot)
    assert len(replayed.starts) == 1
    assert runs.model.failure is not None
    assert runs.model.failure.stage is Stage.RECONSTRUCT
    assert runs.model.failure.why == "No module was found."


def test_shutdown_and_another_sequence_forget_the_run_that_waits(
    runs: RunController, replayed: Any, qtbot: QtBot, tiny_folder: Any
) -> None:
    hold(runs, replayed, qtbot)
    runs.model.change_settings(prior_weight=0.5)
    runs.start()
    runs.model.open(FrameSequence.open(tiny_folder))
    finish(runs, replayed, qtbot)
    qtbot.wait(50)
    assert len(replayed.starts) == 1


def test_run_is_offered_while_a_run_with_other_settings_goes_on(
    workbench: Any, replayed: Any, qtbot: QtBot
) -> None:
    _, dock, _ = workbench
    runs = dock.workbench.runs
    hold(runs, replayed, qtbot)
    assert not dock.run.run.isEnabled()
    assert dock.steps.next.text() == "Cancel the run"
    dock.image.form["prior_weight"].number.setValue(0.25)
    assert dock.run.run.isEnabled()
    assert dock.steps.next.text() == "Run anew"
    dock.run.run.click()
    finish(runs, replayed, qtbot)
    assert dock.workbench.model.inspection.settings.prior_weight == 0.25


def test_no_inspection_of_an_earlier_run_is_kept(
    workbench: Any, replayed: Any, qtbot: QtBot
) -> None:
    _, dock, _ = workbench
    runs = dock.workbench.runs
    seen = []
    for weight in (0.1, 0.2, 0.3):
        dock.workbench.model.change_settings(prior_weight=weight)
        runs.start()
        finish(runs, replayed, qtbot)
        seen.append(ref(dock.workbench.model.inspection))
        replayed.starts.clear()

    def is_gone(inspection: ref[Inspection]) -> bool:
        gc.collect()
        return inspection() is None

    qtbot.waitUntil(lambda: [is_gone(inspection) for inspection in seen] == [True, True, False])
