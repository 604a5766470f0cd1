from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pytestqt.qtbot import QtBot
from qtpy.QtCore import QModelIndex, QPoint, Qt
from qtpy.QtWidgets import QApplication

from napari_pv_inspect.docks.pages.frames import GRID, NAME, STATUS
from napari_pv_inspect.models.frame_table import FrameRow, frame_rows, ticked
from napari_pv_inspect.models.workbench import RunState
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.registration.register import LEFT_OUT
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from tests.plugin.reviewing import show

TICK = Qt.ItemDataRole.CheckStateRole


def with_registration(
    inspection: Inspection, frame: int, why: str, settings: Settings
) -> Inspection:
    assert inspection.registration is not None
    used = inspection.registration.used.copy()
    used[frame] = False
    reasons = tuple(why if i == frame else w for i, w in enumerate(inspection.registration.why))
    status = replace(inspection.registration, used=used, why=reasons)
    return replace(inspection, registration=status, settings=settings)


def rows(
    sequence: FrameSequence, inspection: Inspection | None, settings: Settings
) -> list[FrameRow]:
    return list(frame_rows(sequence, inspection, settings))


def test_before_a_run_every_frame_is_wanted_and_nothing_is_known(
    tiny_sequence: FrameSequence, tiny_settings: Settings
) -> None:
    for row in rows(tiny_sequence, None, tiny_settings):
        assert row.used is None
        assert row.wanted
        assert np.isnan([row.grid_px, row.residual, row.motion_px]).all()


def test_the_numbers_are_those_of_the_inspection(
    tiny_sequence: FrameSequence, tiny_inspection: Inspection
) -> None:
    row = rows(tiny_sequence, tiny_inspection, tiny_inspection.settings)[2]
    assert tiny_inspection.calibration is not None
    assert tiny_inspection.registration is not None
    assert tiny_inspection.reconstruction is not None
    assert row.grid_px == tiny_inspection.calibration.rms_px[2]
    assert row.residual == tiny_inspection.reconstruction.residual_rms[2]
    assert row.residual != tiny_inspection.registration.rms[2]
    assert row.motion_px == tiny_inspection.reconstruction.motion[2][0]
    assert row.status == "used"


def test_a_used_frame_is_left_out_and_taken_back(
    tiny_sequence: FrameSequence, tiny_inspection: Inspection
) -> None:
    settings = tiny_inspection.settings
    row = rows(tiny_sequence, tiny_inspection, settings)[1]
    without = ticked(settings, row, wanted=False)
    assert without.skip_frames == (row.name,)
    row = rows(tiny_sequence, tiny_inspection, without)[1]
    assert not row.wanted
    assert row.status == "to be left out"
    assert ticked(without, row, wanted=True) == settings


def test_a_rejected_frame_is_kept_and_given_back_to_the_automatic_choice(
    tiny_sequence: FrameSequence, tiny_inspection: Inspection
) -> None:
    settings = tiny_inspection.settings
    rejected = with_registration(tiny_inspection, 3, "shows another module", settings)
    row = rows(tiny_sequence, rejected, settings)[3]
    assert not row.wanted
    assert row.status == "rejected: shows another module"
    keeping = ticked(settings, row, wanted=True)
    assert keeping.keep_frames == (row.name,)
    row = rows(tiny_sequence, rejected, keeping)[3]
    assert row.wanted
    assert ticked(keeping, row, wanted=False) == settings


def test_a_frame_that_a_person_left_out_is_not_called_rejected(
    tiny_sequence: FrameSequence, tiny_inspection: Inspection
) -> None:
    name = tiny_sequence.names[0]
    settings = tiny_inspection.settings.changed(skip_frames=(name,))
    left_out = with_registration(tiny_inspection, 0, LEFT_OUT, settings)
    row = rows(tiny_sequence, left_out, settings)[0]
    assert (row.wanted, row.status) == (False, "left out by you")
    back = ticked(settings, row, wanted=True)
    assert (back.skip_frames, back.keep_frames) == ((), ())
    assert rows(tiny_sequence, left_out, back)[0].wanted


@pytest.fixture
def filled(workbench: Any, replayed: Any, qtbot: QtBot) -> Any:
    _, dock, _ = workbench
    dock.show_page("Frames")
    dock.workbench.runs.start()
    qtbot.waitUntil(lambda: dock.workbench.model.run_state is RunState.IDLE)
    return workbench


def place(box: Any, row: int, column: int = NAME) -> QModelIndex:
    index: QModelIndex = box.sorted.index(row, column)
    return index


def test_row_and_time_slider_go_together_also_when_sorted(filled: Any, qtbot: QtBot) -> None:
    viewer, dock, _ = filled
    box = dock.frames
    box.view.sortByColumn(GRID, Qt.SortOrder.DescendingOrder)
    shown = [float(place(box, i, GRID).data()) for i in range(5)]
    assert shown == sorted(shown, reverse=True)
    box.view.setCurrentIndex(place(box, 0))
    assert viewer.dims.current_step[0] == box.sorted.mapToSource(place(box, 0)).row()
    qtbot.keyClick(box.view, Qt.Key.Key_Down)
    assert viewer.dims.current_step[0] == box.sorted.mapToSource(place(box, 1)).row()
    for frame in (4, 0, 2):
        viewer.dims.set_current_step(0, frame)
        assert box.sorted.mapToSource(box.view.currentIndex()).row() == frame
        assert viewer.dims.current_step[0] == frame


def test_the_reason_of_a_frame_that_is_not_used_is_shown_whole(
    filled: Any, tiny_inspection: Inspection
) -> None:
    _, dock, _ = filled
    why = (
        "it does not show the same module as the others (correlation 0.12, typically 0.93): the "
        "cell in row 2, column 3 is another one"
    )
    show(dock, with_registration(tiny_inspection, 3, why, tiny_inspection.settings))
    box = dock.frames
    box.view.sortByColumn(NAME, Qt.SortOrder.DescendingOrder)
    box.view.resize(290, 300)
    box.view.show()
    QApplication.processEvents()
    assert box.table.index(3, GRID).data() == f"rejected: {why}"
    (row,) = (k for k in range(5) if box.sorted.mapToSource(place(box, k)).row() == 3)
    usual = box.view.verticalHeader().defaultSectionSize()
    rect = box.view.visualRect(place(box, row, GRID))
    assert box.view.columnSpan(row, GRID) == 4
    needed = box.view.fontMetrics().boundingRect(
        rect.adjusted(0, 0, 0, 999), Qt.TextFlag.TextWordWrap, f"rejected: {why}"
    )
    assert rect.height() >= needed.height() > usual
    assert [box.view.rowHeight(k) for k in range(5) if k != row] == [usual] * 4
    show(dock, tiny_inspection)
    assert [box.view.rowHeight(k) for k in range(5)] == [usual] * 5


def test_a_tick_changes_the_settings_and_can_be_undone(filled: Any) -> None:
    _, dock, _ = filled
    model, box = dock.workbench.model, dock.frames
    name = model.sequence.names[1]
    box.table.setData(box.table.index(1, NAME), Qt.CheckState.Unchecked, TICK)
    assert model.settings.skip_frames == (name,)
    assert box.table.index(1, NAME).data(TICK) == Qt.CheckState.Unchecked
    assert box.table.index(1, STATUS).data() == "to be left out"
    assert dock.workbench.history.undo_text == f"Leave out {name}"
    assert dock.steps.next.text() == "Run from register"
    dock.workbench.history.undo()
    assert model.settings.skip_frames == ()
    assert dock.steps.next.text() == "Review cells"
    dock.workbench.history.redo()
    assert model.settings.skip_frames == (name,)


def test_the_mouse_ticks(filled: Any, qtbot: QtBot) -> None:
    _, dock, _ = filled
    view = dock.frames.view
    corner = view.visualRect(place(dock.frames, 2)).topLeft()
    qtbot.mouseClick(view.viewport(), Qt.MouseButton.LeftButton, pos=corner + QPoint(9, 10))
    assert dock.workbench.model.settings.skip_frames == (dock.workbench.model.sequence.names[2],)


def test_another_sequence_has_no_ticks_of_the_one_before(
    filled: Any, tiny_sequence: FrameSequence
) -> None:
    _, dock, _ = filled
    dock.frames.table.setData(dock.frames.table.index(1, NAME), Qt.CheckState.Unchecked, TICK)
    dock.workbench.model.open(replace(tiny_sequence))
    assert dock.workbench.model.settings.skip_frames == ()
    assert dock.workbench.history.undo_text is None
