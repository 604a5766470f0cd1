"""The slider with a number: what is automatic, unknown, or confirmed by hand."""

from __future__ import annotations

import pytest
from pytestqt.qtbot import QtBot
from qtpy.QtCore import QEvent, QPoint, Qt
from qtpy.QtGui import QFocusEvent
from qtpy.QtWidgets import QApplication, QStyle, QStyleOptionSlider

from napari_pv_inspect.forms.form import SettingsForm
from napari_pv_inspect.models.workbench import WorkbenchModel
from napari_pv_inspect.widgets.number_slider import NumberSlider
from pv_inspect.settings import Group

Given = list[float | None]


@pytest.fixture
def shown(qtbot: QtBot) -> tuple[NumberSlider, Given]:
    """A number on automatic, which stands for 0.2, and what is told of it."""
    widget = NumberSlider("kappa", (-0.6, 0.6), (None, None), 4, automatic="fitted")
    qtbot.addWidget(widget)
    widget.resize(300, 60)
    widget.show()
    widget.show_value(None)
    widget.show_number(0.2)
    given: Given = []
    widget.changed.connect(given.append)
    return widget, given


def handle_of(widget: NumberSlider) -> QPoint:
    """Return the middle of the slider's handle."""
    option = QStyleOptionSlider()
    widget.slider.initStyleOption(option)
    part = QStyle.SubControl.SC_SliderHandle
    control = QStyle.ComplexControl.CC_Slider
    return widget.slider.style().subControlRect(control, option, part, widget.slider).center()


def test_a_click_on_the_handle_keeps_the_automatic_number(
    shown: tuple[NumberSlider, Given], qtbot: QtBot
) -> None:
    widget, given = shown
    qtbot.mouseClick(widget.slider, Qt.MouseButton.LeftButton, pos=handle_of(widget))
    assert given == [0.2]
    assert widget.value() == 0.2
    qtbot.mouseClick(widget.slider, Qt.MouseButton.LeftButton, pos=handle_of(widget))
    assert given == [0.2]


@pytest.mark.parametrize("typed", ["", "0.2"])
def test_enter_keeps_the_automatic_number(
    shown: tuple[NumberSlider, Given], qtbot: QtBot, typed: str
) -> None:
    widget, given = shown
    if typed:
        widget.number.selectAll()
        qtbot.keyClicks(widget.number, typed)
    qtbot.keyClick(widget.number, Qt.Key.Key_Return)
    assert given == [0.2]
    assert widget.automatic is not None
    assert not widget.automatic.isChecked()


def test_another_number_is_told_once(shown: tuple[NumberSlider, Given], qtbot: QtBot) -> None:
    widget, given = shown
    widget.number.selectAll()
    qtbot.keyClicks(widget.number, "0.1")
    qtbot.keyClick(widget.number, Qt.Key.Key_Return)
    assert given == [0.1]


def test_no_number_stands_beside_the_mark_while_nobody_knows_it(
    shown: tuple[NumberSlider, Given], qtbot: QtBot
) -> None:
    widget, given = shown
    widget.show_number(None)
    assert widget.number.text() == ""
    assert widget.slider.value() == widget.slider.maximum() // 2
    qtbot.keyClick(widget.number, Qt.Key.Key_Return)
    assert given == []
    assert widget.number.text() == ""
    widget.show_number(0.3)
    assert widget.number.text() == "0.3000"


@pytest.mark.parametrize("end", ["Enter", "elsewhere"])
@pytest.mark.parametrize("typed", ["0.1", "0"])
def test_a_number_is_typed_where_none_stood(
    shown: tuple[NumberSlider, Given], qtbot: QtBot, typed: str, end: str
) -> None:
    widget, given = shown
    widget.show_number(None)
    qtbot.keyClicks(widget.number, typed)
    if end == "Enter":
        qtbot.keyClick(widget.number, Qt.Key.Key_Return)
    else:
        QApplication.sendEvent(widget.number, QFocusEvent(QEvent.Type.FocusOut))
    assert given == [float(typed)]
    assert widget.number.text() == f"{float(typed):.4f}"


def test_a_number_that_was_emptied_comes_back(
    shown: tuple[NumberSlider, Given], qtbot: QtBot
) -> None:
    widget, _ = shown
    widget.number.selectAll()
    qtbot.keyClick(widget.number, Qt.Key.Key_Backspace)
    qtbot.keyClick(widget.number, Qt.Key.Key_Return)
    assert widget.number.text() == "0.2000"


def test_without_its_mark_an_unknown_number_begins_in_the_middle(
    shown: tuple[NumberSlider, Given],
) -> None:
    widget, given = shown
    widget.show_number(None)
    assert widget.automatic is not None
    widget.automatic.click()
    assert given == [0.0]
    assert widget.number.text() == "0.0000"


def test_the_forms_show_no_number_that_nobody_knows(qtbot: QtBot) -> None:
    model, known = WorkbenchModel(), {"kappa": -0.25}
    form = SettingsForm(model, Group.LENS, lambda: known)
    qtbot.addWidget(form)
    assert form["kappa"].number.text() == "-0.2500"
    known.clear()
    form.refresh()
    assert form["kappa"].number.text() == ""
    assert form["kappa"].automatic.isChecked()
    assert model.settings.kappa is None
