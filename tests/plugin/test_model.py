from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from napari_pv_inspect.models.workbench import RunState, WorkbenchModel, best_start
from pv_inspect.detection.layout_guess import LayoutGuess
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.inspection.inspection import Inspection, Step
from pv_inspect.results.read import read_result
from pv_inspect.results.write import write_result
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings, Stage


@pytest.fixture
def model(tiny_sequence: FrameSequence) -> WorkbenchModel:
    model = WorkbenchModel()
    model.open(tiny_sequence)
    model.change_settings(magnification=2.0, max_iterations=5)
    return model


def test_rows_and_columns_come_from_the_sidecar(model: WorkbenchModel) -> None:
    assert (model.settings.rows, model.settings.cols) == (3, 4)


def test_a_value_out_of_range_is_a_notice_and_changes_nothing(model: WorkbenchModel) -> None:
    notices: list[tuple[str, bool]] = []
    model.noticed.connect(lambda text, is_error: notices.append((text, is_error)))
    before = model.settings
    model.change_settings(magnification=17.0)
    assert model.settings == before
    assert notices[0][1]
    assert "magnification" in notices[0][0]


def test_a_run_needs_a_sequence_and_only_one_runs_at_a_time(model: WorkbenchModel) -> None:
    with pytest.raises(InspectionError, match="open a folder"):
        WorkbenchModel().begin_run()
    model.begin_run()
    with pytest.raises(InspectionError, match="under way"):
        model.begin_run()


def test_unknown_rows_keep_a_run_from_starting_and_leave_the_model_idle(
    tiny_sequence: FrameSequence,
) -> None:
    model = WorkbenchModel()
    model.open(replace(tiny_sequence, layout_hint={}))
    with pytest.raises(InspectionError, match="rows and cols"):
        model.begin_run()
    assert model.run_state is RunState.IDLE


GUESS = LayoutGuess(ModuleLayout(3, 4), 0.9, ())


def test_a_guessed_layout_fills_the_settings_until_a_person_changes_it(
    tiny_sequence: FrameSequence,
) -> None:
    model = WorkbenchModel()
    sequence = replace(tiny_sequence, layout_hint={})
    model.open(sequence)
    model.offer_layout(sequence, GUESS)
    assert (model.settings.rows, model.settings.cols, model.settings.cell_aspect) == (3, 4, 1.0)
    assert model.layout_is_guessed
    model.change_settings(cols=5)
    assert not model.layout_is_guessed


def test_a_guess_comes_too_late_for_another_sequence_or_for_a_person(
    tiny_sequence: FrameSequence,
) -> None:
    model = WorkbenchModel()
    sequence = replace(tiny_sequence, layout_hint={})
    model.open(sequence)
    model.offer_layout(replace(sequence), GUESS)
    assert model.settings.rows is None
    model.change_settings(rows=7)
    model.offer_layout(sequence, GUESS)
    assert (model.settings.rows, model.settings.cols) == (7, None)


def test_a_cancelled_first_run_keeps_what_it_found(
    model: WorkbenchModel, tiny_inspection: Inspection
) -> None:
    model.begin_run()
    model.take_step(Step(Stage.DETECT, 0.1, "", tiny_inspection.crossings))
    model.end_run(None, keep_draft=False)
    assert model.inspection is not None
    assert model.inspection.crossings is tiny_inspection.crossings
    assert Stage.DETECT not in model.to_do


def test_a_cancelled_rerun_keeps_the_last_whole_result_and_resumes_from_the_draft(
    model: WorkbenchModel, tiny_inspection: Inspection
) -> None:
    model.begin_run()
    model.end_run(tiny_inspection, keep_draft=False)
    model.change_settings(kappa=-0.25)
    assert model.begin_run() is tiny_inspection
    model.take_step(Step(Stage.CALIBRATE, 0.2, "", tiny_inspection.calibration))
    model.end_run(None, keep_draft=False)
    assert model.inspection is tiny_inspection
    resumed = model.begin_run()
    assert resumed is not None
    assert Stage.CALIBRATE not in resumed.stale(model.settings)


def test_settings_changed_during_a_run_do_not_relabel_its_parts(
    model: WorkbenchModel, tiny_inspection: Inspection
) -> None:
    model.begin_run()
    model.change_settings(kappa=0.3)
    model.take_step(Step(Stage.CALIBRATE, 0.2, "", tiny_inspection.calibration))
    assert model.draft is not None
    assert model.draft.settings.kappa is None


def test_a_preview_is_told_but_is_no_part(model: WorkbenchModel) -> None:
    previews: list[object] = []
    model.preview_changed.connect(previews.append)
    model.begin_run()
    image = np.zeros((4, 4), np.float32)
    model.take_step(Step(Stage.RECONSTRUCT, 0.5, "", image))
    assert previews == [image]
    assert model.draft is not None
    assert model.draft.reconstruction is None


def test_the_start_with_the_fewest_stages_left_is_the_best(tiny_inspection: Inspection) -> None:
    settings = tiny_inspection.settings
    partial = tiny_inspection.with_part(tiny_inspection.calibration)  # type: ignore[arg-type]
    assert best_start(settings, partial, tiny_inspection) is tiny_inspection
    assert best_start(settings, None) is None
    assert best_start(Settings(), None, partial) is partial


class Counts:
    """How often each signal of a model was emitted."""

    def __init__(self, model: WorkbenchModel) -> None:
        self.counts: Counter[str] = Counter()
        for name in (
            "changed",
            "sequence_changed",
            "settings_changed",
            "inspection_changed",
            "result_opened",
            "run_changed",
            "cell_selected",
        ):
            getattr(model, name).connect(partial(self._count, name), check_nargs=False)

    def _count(self, name: str, *_: object) -> None:
        self.counts[name] += 1

    def take(self) -> dict[str, int]:
        """Return the counts since the last time."""
        found, self.counts = dict(self.counts), Counter()
        return found


def test_each_change_of_the_model_is_told_once(
    model: WorkbenchModel, tiny_sequence: FrameSequence, tiny_inspection: Inspection, tmp_path: Path
) -> None:
    write_result(tiny_inspection, tmp_path / "out")
    result = read_result(tmp_path / "out")
    unknown = replace(tiny_sequence, layout_hint={})
    new = ("sequence_changed", "settings_changed", "inspection_changed")
    counts = Counts(model)
    steps: list[tuple[Callable[[], object], tuple[str, ...] | None]] = [
        (lambda: model.open(tiny_sequence), new),
        (lambda: model.change_settings(kappa=-0.1, magnification=2.0), ("settings_changed",)),
        (lambda: model.change_settings(kappa=-0.1), ()),
        (model.begin_run, ("run_changed",)),
        (
            lambda: model.take_step(Step(Stage.DETECT, 0.1, "", tiny_inspection.crossings)),
            ("inspection_changed",),
        ),
        (lambda: model.end_run(tiny_inspection, False), ("run_changed", "inspection_changed")),
        (lambda: model.select_cell((1, 1)), ("cell_selected",)),
        (lambda: model.reopen(tiny_sequence), (*new, "cell_selected")),
        (lambda: model.restore(tiny_inspection), new),
        (lambda: model.open_result(result), (*new, "result_opened")),
        (lambda: model.open(unknown), new),
        (lambda: model.set_guessing(True), None),
        (lambda: model.offer_layout(unknown, GUESS), ("settings_changed",)),
        (model.confirm_layout, ("settings_changed",)),
    ]
    for change, told in steps:
        change()
        once = dict.fromkeys(told or (), 1)
        assert counts.take() == ({} if told == () else {**once, "changed": 1})


def test_listeners_see_the_whole_change(model: WorkbenchModel, tiny_inspection: Inspection) -> None:
    seen: list[tuple[RunState, object]] = []
    model.begin_run()
    model.run_changed.connect(lambda state: seen.append((state, model.inspection)))
    model.end_run(tiny_inspection, keep_draft=False)
    assert seen == [(RunState.IDLE, tiny_inspection)]
