"""The dock has room for its pages at 1280 x 800, and one button for one thing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from pytestqt.qtbot import QtBot
from qtpy.QtCore import Qt
from qtpy.QtWidgets import (
    QAbstractButton,
    QAbstractSpinBox,
    QApplication,
    QComboBox,
    QDockWidget,
    QLabel,
    QSlider,
)

from napari_pv_inspect.application import build
from napari_pv_inspect.docks.cell import CellDock
from napari_pv_inspect.docks.gallery import CellsDock
from napari_pv_inspect.docks.inspect import WIDTH
from napari_pv_inspect.docks.placing import show_live_cell
from napari_pv_inspect.models.workbench import RunState
from napari_pv_inspect.napari_internals import main_window
from napari_pv_inspect.widgets.elided import ElidedLabel
from napari_pv_inspect.widgets.style import style
from pv_inspect.sequence.sequence import FrameSequence

SIZE = (1280, 800)


@pytest.fixture
def window(
    make_napari_viewer: Callable[..., Any],
    tiny_sequence: FrameSequence,
    replayed: Any,
    qtbot: QtBot,
) -> tuple[Any, Any]:
    """Window of 1280 x 800 with a whole inspection, gallery below, and its dock.

    Warnings are shown whole and take room of the page; five steps of the solver bring one.
    """
    replayed.inspection = replace(replayed.inspection, warnings=())
    viewer = make_napari_viewer(show=True)
    main = main_window(viewer)
    dock, _ = build(viewer)
    dock.workbench.model.open(tiny_sequence)
    dock.workbench.model.change_settings(magnification=2.0, max_iterations=5)
    main.resize(*SIZE)
    dock.run.run.click()
    qtbot.waitUntil(lambda: dock.workbench.model.run_state is RunState.IDLE)
    qtbot.wait(100)
    return viewer, dock


@pytest.mark.xvfb
@pytest.mark.parametrize("running", [False, True])
def test_no_page_scrolls_at_1280_x_800(
    window: tuple[Any, Any], replayed: Any, qtbot: QtBot, running: bool
) -> None:
    viewer, dock = window
    if running:
        replayed.go_on = False
        dock.workbench.model.change_settings(prior_weight=0.5)
        dock.run.run.click()
        qtbot.waitUntil(lambda: dock.run.progress.value() > 600)
    main = main_window(viewer)
    assert (main.width(), main.height()) == SIZE
    for page in ("Frames", "Grid", "Image", "Review"):
        dock.show_page(page)
        qtbot.wait(50)
        area = dock.pages.currentWidget()
        qtbot.waitUntil(lambda area=area: area.verticalScrollBar().maximum() == 0)
        assert area.widget().minimumSizeHint().width() <= area.viewport().width(), page
    replayed.go_on = True
    qtbot.waitUntil(lambda: dock.workbench.model.run_state is RunState.IDLE)


@pytest.mark.xvfb
def test_gallery_live_cell_and_controls_fit_beside_each_other_at_1280_x_800(
    window: tuple[Any, Any], qtbot: QtBot
) -> None:
    viewer, dock = window
    dock.image.show_live.click()
    qtbot.wait(300)
    main = main_window(viewer)
    assert (main.width(), main.height()) == SIZE
    for page in ("Frames", "Grid", "Image", "Review"):
        dock.show_page(page)
        qtbot.wait(50)
        area = dock.pages.currentWidget()
        assert area.widget().minimumSizeHint().width() <= area.viewport().width(), page
        qtbot.waitUntil(lambda area=area: area.verticalScrollBar().maximum() == 0)


@pytest.mark.xvfb
def test_the_narrowest_dock_has_sliders_wide_enough_for_the_hand(
    window: tuple[Any, Any], qtbot: QtBot
) -> None:
    _, dock = window
    holder = dock
    while not isinstance(holder, QDockWidget):
        holder = holder.parentWidget()
    holder.setFloating(True)
    holder.resize(WIDTH, 700)
    for page in ("Grid", "Image"):
        dock.show_page(page)
        qtbot.wait(50)
        area = dock.pages.currentWidget()
        assert area.widget().minimumSizeHint().width() <= area.viewport().width()
        sliders = [s for s in dock.pages.currentWidget().findChildren(QSlider) if s.isVisible()]
        assert sliders
        assert all(slider.width() >= 200 for slider in sliders)
        for label in dock.pages.currentWidget().findChildren(QLabel):
            if label.isVisible():
                assert label.width() >= label.minimumSizeHint().width(), label.text()
    holder.setFloating(False)


def test_there_is_one_primary_button_in_every_state(
    workbench: Any, replayed: Any, qtbot: QtBot
) -> None:
    _, dock, _ = workbench
    model = dock.workbench.model

    def buttons() -> list[tuple[str, bool]]:
        both = (dock.steps.next, dock.run.run)
        return [(b.text(), bool(b.property("primary"))) for b in both if b.isVisibleTo(dock)]

    assert buttons() == [("Detect grid", True), ("Run all", False)]
    assert not dock.run.progress.isVisibleTo(dock)
    replayed.go_on = False
    dock.run.run.click()
    qtbot.waitUntil(lambda: dock.run.progress.value() > 600)
    assert buttons() == []
    assert dock.run.cancel.isVisibleTo(dock)
    assert dock.run.progress.isVisibleTo(dock)
    model.change_settings(prior_weight=0.5)
    assert buttons() == [("Run anew", True)]
    model.change_settings(prior_weight=None)
    replayed.go_on = True
    qtbot.waitUntil(lambda: model.run_state is RunState.IDLE)
    assert buttons() == [("Review cells", True)]
    assert not dock.run.cancel.isVisibleTo(dock)
    model.change_settings(prior_weight=0.5)
    assert buttons() == [("Run from reconstruct", True)]


def test_a_long_name_is_cut_in_its_middle_and_whole_in_its_tooltip(workbench: Any) -> None:
    _, dock, _ = workbench
    name = "2026-11-22_string-04_module-0017_forward-bias_" * 4
    dock.show_name(name, "5 frames", f"/data/{name}")
    assert dock.name.text() == name
    assert dock.name.minimumSizeHint().width() < 100
    assert name in dock.name.toolTip()
    assert "5 frames" in dock.headline.text()


def test_an_elided_label_shows_both_ends(qtbot: QtBot) -> None:
    label = ElidedLabel("a" * 60 + "i" * 60)
    qtbot.addWidget(label)
    label.resize(120, 20)
    short = label.grab().toImage()
    label.setText("a" * 60 + "-" * 60)
    assert label.grab().toImage() != short


@pytest.mark.xvfb
def test_the_tab_key_goes_down_the_image_page_and_is_seen(
    window: tuple[Any, Any], qtbot: QtBot
) -> None:
    viewer, dock = window
    dock.show_page("Image")
    main_window(viewer).activateWindow()
    image = dock.image
    dock.workbench.model.change_settings(prior_weight=0.5, psf_sigma_lr_px=0.5)
    image.show_live.setFocus()
    qtbot.waitUntil(image.show_live.hasFocus)
    for widget in (
        image.presets,
        image.form["magnification"].number,
        image.form["magnification"].slider,
        image.form["prior_weight"].automatic,
        image.form["prior_weight"].number,
        image.form["prior_weight"].slider,
        image.form["psf_sigma_lr_px"].automatic,
        image.form["psf_sigma_lr_px"].number,
        image.form["psf_sigma_lr_px"].slider,
        image.form["prior"],
        image.form["motion_blur"],
        image.form.more,
    ):
        without = widget.grab().toImage()
        qtbot.keyClick(QApplication.focusWidget(), Qt.Key.Key_Tab)
        assert QApplication.focusWidget() is widget
        assert widget.grab().toImage() != without


@pytest.mark.xvfb
def test_the_tab_key_leaves_every_page_downwards(window: tuple[Any, Any], qtbot: QtBot) -> None:
    viewer, dock = window
    main_window(viewer).activateWindow()
    for page in ("Frames", "Grid", "Image", "Review"):
        dock.show_page(page)
        dock.open_folder.setFocus()
        qtbot.waitUntil(dock.open_folder.hasFocus)
        reached = []
        while dock.result.save not in reached:
            qtbot.keyClick(QApplication.focusWidget(), Qt.Key.Key_Tab)
            assert QApplication.focusWidget() not in reached
            reached.append(QApplication.focusWidget())
        assert dock.steps.next in reached


def test_every_control_has_a_tooltip(workbench: Any) -> None:
    _, dock, _ = workbench
    for kind in (QAbstractButton, QAbstractSpinBox, QComboBox, QSlider):
        for control in dock.findChildren(kind):
            above = control.parentWidget()
            if above is dock.pages.tabBar() or isinstance(above, QAbstractSpinBox | QComboBox):
                continue
            assert control.toolTip() or above.toolTip(), control.objectName()


def test_all_our_docks_show_the_focus_under_every_theme(workbench: Any, qtbot: QtBot) -> None:
    viewer, dock, cells = workbench
    large = CellDock(viewer)
    qtbot.addWidget(large)
    docks = (dock, cells, large, show_live_cell(dock.workbench, dock))
    for theme in ("light", "dark"):
        viewer.theme = theme
        assert [one.styleSheet() for one in docks] == [style(theme)] * 4
    assert style("light") != style("dark")


def test_the_bar_of_the_gallery_folds_beside_the_live_cell(
    make_napari_viewer: Callable[..., Any], qtbot: QtBot
) -> None:
    cells = CellsDock(make_napari_viewer())
    qtbot.addWidget(cells)
    cells.resize(600, 260)
    cells.show()
    qtbot.waitUntil(lambda: cells.bar.width() > 500)
    assert cells.bar.is_folded
    for control in (cells.order, cells.filter, cells.opacity, cells.threshold, cells.zoom):
        assert control.width() >= control.minimumSizeHint().width()
    assert cells.opacity.width() >= 80
    cells.resize(1100, 260)
    qtbot.waitUntil(lambda: not cells.bar.is_folded)
