"""What a person sees of a result that is in doubt, can't be judged, or is an earlier one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pytestqt.qtbot import QtBot
from qtpy.QtCore import QRect
from qtpy.QtGui import QImage, QPainter
from qtpy.QtWidgets import QStyleOptionViewItem

from napari_pv_inspect.docks.pages.workflow import COLOURS
from napari_pv_inspect.layers.frames import CAPTION_LETTERS
from napari_pv_inspect.models.workbench import RunState
from napari_pv_inspect.models.workflow import Status, steps_of
from napari_pv_inspect.widgets.wrapped_text import SentenceList
from pv_inspect.cracks import CellState
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.doubts import doubts_of
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.results.read import read_result
from pv_inspect.results.write import write_result
from tests.plugin.reviewing import show

ALL_BLIND = "12 of 12 cells can't be judged from these frames"
LONG = (
    "The frames contradict the module image by 14.8 times their noise, typically 1: check that all "
    "of them show the same module and that the grid fits them."
)


def blinded(inspection: Inspection, n: int) -> Inspection:
    """The same with n cells that can't be judged, one of them with marks, and one that is dark."""
    assert inspection.cracks is not None
    cells = [
        replace(
            cell,
            unsure=i < n,
            weak_marks=False,
            crack_instances=int(i == 0),
            dark_area_share=0.0,
        )
        for i, cell in enumerate(inspection.cracks.cells)
    ]
    if n < len(cells):
        cells[-1] = replace(cells[-1], dark_area_share=0.9)
    blind = replace(inspection, cracks=replace(inspection.cracks, cells=tuple(cells)))
    return replace(blind, doubts=doubts_of(blind))


@pytest.fixture
def blind(tiny_inspection: Inspection) -> Inspection:
    return blinded(tiny_inspection, 12)


def run(dock: Any, qtbot: QtBot) -> None:
    dock.workbench.runs.start()
    qtbot.waitUntil(lambda: dock.workbench.model.run_state is RunState.IDLE)


def shown_words(dock: Any) -> str:
    box = dock.result
    return "\n".join((box.doubts.label.text(), box.summary.text(), box.warnings.label.text()))


def test_a_run_that_ends_in_doubt_is_not_done(
    workbench: Any, replayed: Any, blind: Inspection, qtbot: QtBot
) -> None:
    _, dock, cells = workbench
    replayed.inspection = blind
    told: list[tuple[str, bool]] = []
    dock.workbench.model.noticed.connect(lambda text, is_error: told.append((text, is_error)))
    run(dock, qtbot)
    text, is_error = told[-1]
    assert text.startswith(f"In doubt: {ALL_BLIND}")
    assert is_error
    assert not any("Done" in words for words, _ in told)
    assert [s.status for s in steps_of(dock.workbench.model)].count(Status.DOUBTED) == 3
    assert COLOURS[Status.DOUBTED] != COLOURS[Status.DONE]
    words = shown_words(dock)
    assert words.startswith(f"In doubt: {ALL_BLIND}")
    assert f"{ALL_BLIND}: none suspected, none clean" in words
    assert cells.counts.isVisibleTo(cells)
    assert cells.counts.text().startswith(ALL_BLIND)


def test_a_result_without_its_frames_shows_the_same_doubts(
    workbench: Any, blind: Inspection, tmp_path: Path, qtbot: QtBot
) -> None:
    _, dock, cells = workbench
    show(dock, blind)
    before = shown_words(dock)
    write_result(blind, tmp_path / "out")
    dock.workbench.model.open_result(read_result(tmp_path / "out"))
    assert shown_words(dock) == before
    assert cells.counts.text().startswith(ALL_BLIND)
    assert dock.run.message.text().startswith("In doubt")
    assert Status.DOUBTED in [s.status for s in steps_of(dock.workbench.model)]


def test_a_reopened_result_shows_the_same_doubts(
    workbench: Any, blind: Inspection, tmp_path: Path, qtbot: QtBot
) -> None:
    _, dock, _ = workbench
    show(dock, blind)
    before = shown_words(dock)
    write_result(blind, tmp_path / "out")
    dock.workbench.open(str(tmp_path / "out"))
    model = dock.workbench.model
    qtbot.waitUntil(lambda: model.inspection and model.inspection.stored)
    qtbot.waitUntil(lambda: not dock.workbench.opener.busy)
    assert shown_words(dock) == before
    assert "In doubt" in dock.run.message.text() or "Opened" in dock.run.message.text()


def test_the_gallery_filters_by_what_could_be_judged_and_says_how_many(
    workbench: Any, tiny_inspection: Inspection
) -> None:
    _, dock, cells = workbench
    show(dock, blinded(tiny_inspection, 5))
    texts = [cells.filter.itemText(k) for k in range(cells.filter.count())]
    for text in ("suspected (0)", "can't be judged (5)", "dark (1)", "clean (6)"):
        assert text in texts
    for text, places in (("can't be judged (5)", range(5)), ("dark (1)", [11])):
        cells.filter.setCurrentText(text)
        listed = [cells.cells.cell(cells.cells.index(k)) for k in range(cells.cells.rowCount())]
        assert listed == [divmod(k, 4) for k in places]
    cells.filter.setCurrentText("all")
    assert cells.cells.rowCount() == 12
    assert cells.counts.text().startswith("5 of 12 cells can't be judged from these frames, 1 is")


def test_a_tile_carries_its_state(workbench: Any, tiny_inspection: Inspection) -> None:
    _, dock, cells = workbench

    def corner(state_count: int) -> QImage:
        show(dock, blinded(tiny_inspection, state_count))
        assert dock.workbench.review.state.cells.state_of((0, 1)) is (
            CellState.UNDECIDABLE if state_count > 1 else CellState.CLEAN
        )
        option = QStyleOptionViewItem()
        option.rect = (
            QRect(0, 0, *cells.delegate.tile().toTuple())
            if hasattr(cells.delegate.tile(), "toTuple")
            else QRect(0, 0, cells.delegate.tile().width(), cells.delegate.tile().height())
        )
        image = QImage(option.rect.size(), QImage.Format.Format_RGB32)
        image.fill(0)
        painter = QPainter(image)
        cells.delegate.paint(painter, option, cells.cells.index(1))
        painter.end()
        return image.copy(0, 0, 20, 20)

    amber = [
        sum(
            image.pixelColor(x, y).name().upper() == "#E69F00" for x in range(20) for y in range(20)
        )
        for image in (corner(1), corner(5))
    ]
    assert amber[0] == 0
    assert amber[1] > 50


def test_long_sentences_are_shown_whole(workbench: Any, tiny_inspection: Inspection) -> None:
    _, dock, _ = workbench
    unused = "frame_003.tif is not used: black."
    show(dock, replace(tiny_inspection, doubts=(LONG,), warnings=(unused, "Guessed.")))
    box = dock.result
    assert box.doubts.label.text() == f"In doubt: {LONG}"
    assert box.doubts.label.wordWrap()
    assert box.warnings.label.text() == "Guessed.", "the list of frames tells the reasons"
    assert not box.warnings.isHidden()
    show(dock, tiny_inspection)
    assert box.doubts.isHidden()


def test_a_told_text_is_as_high_as_its_lines(qtbot: QtBot) -> None:
    told = SentenceList("#ffffff")
    qtbot.addWidget(told)
    told.resize(300, 20)
    told.show_sentences((LONG, LONG))
    told.show()
    line = told.fontMetrics().lineSpacing()
    assert told.sizeHint().height() >= told.label.heightForWidth(300) > 4 * line
    told.show_sentences((LONG,) * 20)
    assert told.sizeHint().height() < 14 * line


def test_a_long_reason_over_the_canvas_is_wrapped(
    workbench: Any, tiny_inspection: Inspection
) -> None:
    viewer, dock, _ = workbench
    assert tiny_inspection.registration is not None
    poses = tiny_inspection.registration
    fate = replace(poses, used=np.zeros_like(poses.used), why=(LONG,) * len(poses.used))
    show(dock, replace(tiny_inspection, registration=fate))
    lines = viewer.canvas.overlays.text.text.splitlines()
    assert len(lines) > 1
    assert max(map(len, lines)) <= CAPTION_LETTERS
    assert " ".join(lines).endswith(LONG)


def test_after_a_failed_run_with_other_rows_the_old_result_is_hidden(
    workbench: Any, replayed: Any, tiny_inspection: Inspection, qtbot: QtBot
) -> None:
    viewer, dock, cells = workbench
    run(dock, qtbot)
    model, state = dock.workbench.model, dock.workbench.review.state
    assert state.data.subject is not None
    assert "Module image" in viewer.layers
    model.change_settings(rows=model.settings.rows - 1)
    replayed.error = InspectionError("No frame shows 2 x 4 cells.")
    run(dock, qtbot)
    assert dock.run.message.text() == "No frame shows 2 x 4 cells."
    assert "The run with 2 x 4 cells failed" in dock.result.summary.text()
    assert "clean" not in shown_words(dock)
    assert state.data.subject is None
    assert "is hidden" in cells.view.message
    assert "Module image" not in viewer.layers
    assert "Fitted grid" not in viewer.layers
    assert "grid fits" not in viewer.canvas.overlays.text.text
    assert not dock.result.save.isEnabled()
    model.change_settings(rows=3)
    assert state.data.subject is not None
    assert {"Module image", "Fitted grid"} <= {layer.name for layer in viewer.layers}
    assert "grid fits" in viewer.canvas.overlays.text.text
    assert "clean" in shown_words(dock)
    assert dock.result.save.isEnabled()
    assert "Earlier" not in shown_words(dock)
    model.change_settings(prior_weight=0.3)
    assert "Earlier result" in shown_words(dock), "the last run did not bring this"
