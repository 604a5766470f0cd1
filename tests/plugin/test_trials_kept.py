"""The trials of the tuning live in the result folder."""

from __future__ import annotations

from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from napari_pv_inspect.models.cell_picture import CellPicture
from napari_pv_inspect.models.history import History
from napari_pv_inspect.models.trials import Tuning
from napari_pv_inspect.models.workbench import WorkbenchModel
from napari_pv_inspect.session.trials import TrialStore
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.results.read import read_result
from pv_inspect.results.trials import read_trials
from pv_inspect.results.write import write_result
from pv_inspect.sequence.sequence import FrameSequence


class Bench:
    """Model, tuning and keeper without a window."""

    def __init__(self) -> None:
        self.model = WorkbenchModel()
        self.tuning = Tuning(self.model, History())
        self.keeper = TrialStore(self.model, self.tuning)
        self.said: list[str] = []
        self.model.noticed.connect(lambda text, _: self.said.append(text))

    def try_(self, weight: float, cell: tuple[int, int] = (0, 1)) -> None:
        self.model.change_settings(prior_weight=weight)
        self.tuning.commit()
        image = np.full((6, 5), 0.25, np.float32)
        self.tuning.pictured(CellPicture(image, cell, "", self.model.settings))

    def reopen(self, folder: Path) -> None:
        result = read_result(folder)
        self.model.open_result(result)
        self.keeper.resume(result)


@pytest.fixture
def new_bench(qtbot: QtBot) -> Generator[Callable[[], Bench]]:
    """Make benches; they are closed at the end."""
    made: list[Bench] = []

    def make() -> Bench:
        made.append(Bench())
        return made[-1]

    yield make
    for workbench in made:
        workbench.keeper.close()


@pytest.fixture
def folder(tiny_inspection: Inspection, tmp_path: Path) -> Path:
    """A result folder."""
    write_result(tiny_inspection, tmp_path / "result")
    return tmp_path / "result"


def titles(workbench: Bench) -> list[str]:
    return [trial.title for trial in workbench.tuning.trials]


def test_trials_come_back_with_their_names_and_the_list_goes_on(
    new_bench: Callable[[], Bench], folder: Path
) -> None:
    workbench = new_bench()
    workbench.reopen(folder)
    workbench.try_(1.0)
    workbench.try_(2.0)
    workbench.tuning.rename(workbench.tuning.trials[1], "sharp")
    workbench.keeper.close()

    again = new_bench()
    again.reopen(folder)
    assert titles(again) == ["first setting", "sharp"]
    assert again.tuning.trials[1].settings.prior_weight == 2.0
    np.testing.assert_allclose(again.tuning.trials[1].picture.image, 0.25)
    again.try_(2.0)
    assert again.tuning.current is again.tuning.trials[1]
    again.try_(3.0)
    assert [trial.number for trial in again.tuning.trials] == [1, 2, 3]
    again.tuning.restore(again.tuning.trials[0])
    assert again.model.settings.prior_weight == 1.0


def test_trials_are_written_soon_after_a_change(
    new_bench: Callable[[], Bench], folder: Path, qtbot: QtBot
) -> None:
    workbench = new_bench()
    workbench.reopen(folder)
    workbench.try_(1.0)
    qtbot.waitUntil(lambda: len(read_trials(folder)) == 1)


def test_saving_elsewhere_leaves_the_newest_trial_in_the_folder_before_as_well(
    new_bench: Callable[[], Bench],
    folder: Path,
    tiny_inspection: Inspection,
    tmp_path: Path,
) -> None:
    write_result(tiny_inspection, tmp_path / "elsewhere")
    workbench = new_bench()
    workbench.reopen(folder)
    workbench.try_(1.0)
    workbench.keeper.attach(tmp_path / "elsewhere")
    workbench.keeper.close()
    for place in (folder, tmp_path / "elsewhere"):
        assert [trial.settings.prior_weight for trial in read_trials(place)] == [1.0]


def test_trials_made_before_the_first_save_go_with_it(
    new_bench: Callable[[], Bench], folder: Path
) -> None:
    workbench = new_bench()
    workbench.try_(1.0)
    workbench.keeper.attach(folder)
    workbench.keeper.close()
    assert [trial.settings.prior_weight for trial in read_trials(folder)] == [1.0]


def test_another_sequence_takes_nothing_from_the_folder_of_the_last(
    new_bench: Callable[[], Bench], folder: Path, tiny_sequence: FrameSequence
) -> None:
    workbench = new_bench()
    workbench.reopen(folder)
    workbench.try_(1.0)
    workbench.model.open(tiny_sequence)
    workbench.try_(5.0)
    workbench.keeper.close()
    assert [trial.settings.prior_weight for trial in read_trials(folder)] == [1.0]


def test_damaged_trials_are_one_sentence_and_a_new_list_begins(
    new_bench: Callable[[], Bench], folder: Path
) -> None:
    (folder / "trials.npz").write_bytes(b"PK\x03\x04 and no more")
    workbench = new_bench()
    workbench.reopen(folder)
    assert sum("can't be read" in text for text in workbench.said) == 1
    workbench.try_(1.0)
    workbench.keeper.close()
    assert len(read_trials(folder)) == 1


def test_a_trial_of_a_cell_that_the_module_has_not_is_left_out(
    new_bench: Callable[[], Bench], folder: Path
) -> None:
    workbench = new_bench()
    workbench.reopen(folder)
    workbench.try_(1.0, cell=(0, 0))
    workbench.try_(2.0, cell=(40, 0))
    workbench.keeper.close()
    again = new_bench()
    again.reopen(folder)
    assert titles(again) == ["first setting"]


def test_a_folder_that_went_away_is_told_once(
    new_bench: Callable[[], Bench], folder: Path, qtbot: QtBot
) -> None:
    workbench = new_bench()
    workbench.reopen(folder)
    folder.rename(folder.with_name("elsewhere"))
    for weight in (1.0, 2.0):
        workbench.try_(weight)
        workbench.keeper.write()
    workbench.keeper.wait()
    qtbot.waitUntil(lambda: bool(workbench.said))
    qtbot.wait(50)
    assert [("the folder is gone" in text) for text in workbench.said] == [True]


@pytest.mark.parametrize("at_once", [False, True])
def test_the_workbench_keeps_them_also_if_it_is_closed_while_it_saves(
    at_once: bool,
    workbench: tuple[Any, Any, Any],
    tiny_inspection: Inspection,
    qtbot: QtBot,
    tmp_path: Path,
) -> None:
    viewer, dock, _ = workbench
    model, tuning = dock.workbench.model, dock.workbench.tuning
    model.revise(tiny_inspection)
    tuning.commit()
    image = np.zeros((6, 5), np.float32)
    tuning.pictured(CellPicture(image, (0, 0), "", model.settings))
    dock.save(tmp_path / "out")
    if not at_once:
        qtbot.waitUntil(lambda: dock.workbench.trials.folder is not None)
    viewer.close()
    assert len(read_trials(tmp_path / "out")) == 1
