from __future__ import annotations

from dataclasses import replace

from pytestqt.qtbot import QtBot

from napari_pv_inspect.docks.pages.module import ModuleBox
from napari_pv_inspect.models.workbench import WorkbenchModel
from pv_inspect.detection.layout_guess import LayoutGuess
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.sequence.sequence import FrameSequence


def test_a_guess_names_the_layout_that_fits_nearly_as_well(
    qtbot: QtBot, tiny_sequence: FrameSequence
) -> None:
    sequence = replace(tiny_sequence, layout_hint={})
    model = WorkbenchModel()
    box = ModuleBox(model)
    qtbot.addWidget(box)
    model.open(sequence)
    assert box.confirm.isHidden()
    right, other = ModuleLayout(3, 4), ModuleLayout(6, 4, 2.0)
    model.offer_layout(sequence, LayoutGuess(right, 0.5, (other,), other))
    assert not box.confirm.isHidden()
    assert "6 x 4 cells of aspect 2 nearly as well" in box.confirm.text()
    model.change_settings(rows=5)
    assert box.confirm.isHidden()
