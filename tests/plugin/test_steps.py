from __future__ import annotations

from dataclasses import replace

import pytest

from napari_pv_inspect.models.workbench import WorkbenchModel
from napari_pv_inspect.models.workflow import Status, StepAction, next_step, steps_of
from pv_inspect.detection.layout_guess import LayoutGuess
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.inspection.inspection import Inspection, Step
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Stage

D, N, W = Status.DONE, Status.NEXT, Status.WAITING


@pytest.fixture
def model(tiny_sequence: FrameSequence, tiny_inspection: Inspection) -> WorkbenchModel:
    model = WorkbenchModel()
    model.open(tiny_sequence)
    model.change_settings(**dict(tiny_inspection.settings))
    return model


def finish(model: WorkbenchModel, inspection: Inspection | None) -> None:
    model.begin_run()
    model.end_run(inspection, keep_draft=False)


def statuses(model: WorkbenchModel) -> list[Status]:
    return [step.status for step in steps_of(model)]


def test_the_steps_are_those_of_the_method() -> None:
    names = [step.name for step in steps_of(WorkbenchModel())]
    assert names == [stage.value for stage in Stage] + ["review"]


def test_an_empty_bench_asks_for_frames() -> None:
    model = WorkbenchModel()
    assert statuses(model) == [N, *[W] * 7]
    assert next_step(model).action is StepAction.OPEN


def test_a_guessed_layout_is_confirmed_before_the_grid_is_detected(
    tiny_sequence: FrameSequence,
) -> None:
    model = WorkbenchModel()
    sequence = replace(tiny_sequence, layout_hint={})
    model.open(sequence)
    assert next_step(model).action is StepAction.GIVE_LAYOUT
    model.set_guessing(True)
    assert next_step(model).action is StepAction.WAIT
    model.offer_layout(sequence, LayoutGuess(ModuleLayout(3, 4), 0.9, ()))
    assert next_step(model).text == "Confirm 3 x 4 cells"
    model.confirm_layout()
    assert next_step(model).text == "Detect grid"


def test_a_grid_that_was_found_leads_to_the_run(
    model: WorkbenchModel, tiny_inspection: Inspection
) -> None:
    assert tiny_inspection.calibration is not None
    finish(model, tiny_inspection.with_part(tiny_inspection.calibration))
    assert statuses(model) == [D, D, D, N, W, W, W, W]
    assert next_step(model).text == "Run from register"


def test_a_whole_inspection_leads_to_the_review(
    model: WorkbenchModel, tiny_inspection: Inspection
) -> None:
    finish(model, tiny_inspection)
    assert statuses(model) == [*[D] * 7, N]
    assert next_step(model).action is StepAction.REVIEW


def test_a_changed_setting_makes_its_step_and_all_later_ones_stale(
    model: WorkbenchModel, tiny_inspection: Inspection
) -> None:
    finish(model, tiny_inspection)
    model.change_settings(prior_weight=0.3)
    stale = Status.STALE
    assert statuses(model) == [D, D, D, D, stale, stale, stale, W]
    assert next_step(model).text == "Run from reconstruct"


def test_a_run_shows_what_it_works_on_and_can_be_cancelled_or_renewed(
    model: WorkbenchModel, tiny_inspection: Inspection
) -> None:
    model.begin_run()
    model.take_step(Step(Stage.DETECT, 0.1, "", tiny_inspection.crossings))
    model.take_step(Step(Stage.CALIBRATE, 0.2, ""))
    assert statuses(model)[:4] == [D, D, Status.WORKING, W]
    assert next_step(model).action is StepAction.CANCEL
    model.change_settings(prior_weight=0.3)
    assert next_step(model).text == "Run anew"


def test_a_result_in_doubt_has_no_green_image_and_says_why(
    model: WorkbenchModel, tiny_inspection: Inspection
) -> None:
    finish(model, replace(tiny_inspection, doubts=("These look like 7 modules.",)))
    assert statuses(model) == [D, D, D, D, *[Status.DOUBTED] * 3, N]
    cracks = steps_of(model)[6]
    assert cracks.status.value == "in doubt"
    assert "These look like 7 modules." in cracks.tip
    model.change_settings(prior_weight=0.3)
    assert Status.DOUBTED not in statuses(model)
    assert model.doubts, "what is shown still is in doubt"


def test_a_failed_step_says_why_until_the_next_try(
    model: WorkbenchModel, tiny_inspection: Inspection
) -> None:
    model.begin_run()
    model.take_step(Step(Stage.DETECT, 0.1, "", tiny_inspection.crossings))
    model.end_run(None, keep_draft=False, why="No frame fits.")
    steps = steps_of(model)
    assert steps[2].status is Status.FAILED
    assert "No frame fits." in steps[2].tip
    assert next_step(model).text == "Try again from calibrate"
    model.begin_run()
    assert Status.FAILED not in statuses(model)
