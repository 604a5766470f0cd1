"""The cell in the place of the canvas: how large it is, what it folds and gives back."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pytestqt.qtbot import QtBot
from qtpy.QtCore import Qt
from qtpy.QtTest import QTest

from napari_pv_inspect.docks.large_cell import LargeCell, large_cell
from napari_pv_inspect.napari_internals import canvas_area, main_window
from napari_pv_inspect.widgets.panel_grid import areas
from pv_inspect.inspection.inspection import Inspection

LEFT, NONE = Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier
Opened = tuple[Any, Any, Any, LargeCell]


@given(
    st.integers(300, 4000),
    st.integers(200, 3000),
    st.floats(0.4, 2.5),
    st.integers(1, 4),
)
def test_pictures_lie_in_their_room_and_apart(
    width: int, height: int, aspect: float, n_small: int
) -> None:
    large, small = areas(width, height, aspect, n_small)
    rooms = [large, *small]
    assert all(r.left() >= 0 and r.top() >= 0 for r in rooms)
    assert all(r.right() < width and r.bottom() < height for r in rooms)
    assert all(r.width() > 10 and r.height() > 10 for r in rooms)
    assert not any(a.intersects(b) for k, a in enumerate(rooms) for b in rooms[:k])


@pytest.mark.parametrize(("width", "height"), [(917, 422), (917, 680), (1537, 921), (600, 900)])
def test_the_large_picture_is_the_largest(width: int, height: int) -> None:
    large, small = areas(width, height, 1.0, 3)
    side = min(large.width(), large.height())
    assert all(side > 1.5 * min(r.width(), r.height()) for r in small)
    assert side > 0.7 * min(width, height)


@pytest.fixture
def opened(workbench: Any, tiny_inspection: Inspection, qtbot: QtBot) -> Opened:
    viewer, dock, cells = workbench
    dock.workbench.model.revise(tiny_inspection)
    window = main_window(viewer)
    window.resize(1280, 800)
    window.show()
    qtbot.waitUntil(lambda: cells.isVisible())
    qtbot.wait(100)  # docks settle
    return viewer, dock, cells, large_cell(dock.workbench)


def click(cells: Any, number: int) -> None:
    index = cells.cells.index(number)
    cells.view.scrollTo(index)
    place = cells.view.visualRect(index).center()
    QTest.mouseClick(cells.view.viewport(), LEFT, NONE, place)


def folded(viewer: Any) -> list[bool]:
    canvas = canvas_area(main_window(viewer))
    return [canvas.dockLayerList.isHidden(), canvas.dockLayerControls.isHidden(), canvas.isHidden()]


def test_a_click_shows_the_cell_large_and_back_restores_the_docks(
    opened: Opened, qtbot: QtBot
) -> None:
    viewer, _, cells, place = opened
    before = canvas_area(main_window(viewer)).dockLayerList.size()
    height = cells.height()
    click(cells, 1)
    qtbot.waitUntil(place.view.isVisible)
    assert folded(viewer) == [True] * 3
    assert cells.isVisible()
    qtbot.waitUntil(lambda: place.view.cell_panel.height() >= 400)
    assert place.view.cell_panel.width() >= 400
    QTest.mouseClick(place.view.bar.back, LEFT)
    assert folded(viewer) == [False] * 3
    restored = canvas_area(main_window(viewer)).dockLayerList
    qtbot.waitUntil(lambda: restored.size() == before)
    assert cells.height() == height


def test_enter_folds_the_gallery_too_and_one_key_brings_it_back(
    opened: Opened, qtbot: QtBot
) -> None:
    viewer, dock, cells, place = opened
    main_window(viewer).activateWindow()
    cells.view.setFocus()
    qtbot.waitUntil(cells.view.hasFocus)
    QTest.keyClick(cells.view, Qt.Key.Key_Return)
    qtbot.waitUntil(place.view.hasFocus)
    assert cells.isHidden() or not cells.isVisible()
    qtbot.waitUntil(lambda: place.view.cell_panel.height() >= 600)
    QTest.keyClick(place.view, "g")
    qtbot.waitUntil(cells.view.hasFocus)
    assert place.is_open
    QTest.keyClick(cells.view, Qt.Key.Key_Right)
    assert dock.workbench.model.selected_cell == (0, 1)
    QTest.keyClick(cells.view, Qt.Key.Key_Escape)
    assert not place.is_open
    assert cells.view.hasFocus()


def test_what_the_user_brings_back_or_takes_away_stays_so(opened: Opened) -> None:
    viewer, dock, cells, place = opened
    canvas = canvas_area(main_window(viewer))
    canvas.dockLayerControls.hide()
    click(cells, 1)
    canvas.dockLayerList.show()
    place.leave()
    assert folded(viewer) == [False, True, False]
    canvas.dockLayerList.setFloating(True)
    click(cells, 2)
    assert folded(viewer) == [False, True, True]
    dock.workbench.navigator.to_module()
    assert folded(viewer) == [False, True, False]


def test_number_keys_and_clicks_swap_the_large_picture(opened: Opened, qtbot: QtBot) -> None:
    _, _, cells, place = opened
    click(cells, 1)
    view = place.view
    view.setFocus()
    qtbot.waitUntil(view.hasFocus)
    QTest.keyClick(view, "4")
    assert view.grid.large is view.support_panel
    assert view.support_panel.width() > view.cell_panel.width()
    QTest.mouseClick(view.cell_panel, LEFT, NONE, view.cell_panel.rect().center())
    assert view.grid.large is view.cell_panel
    QTest.keyClick(view, "3")
    QTest.keyClick(view, "d")
    assert view.grid.large is view.cell_panel, "the brush is for the large module image"
    assert view.cell_panel.editable


def test_another_task_brings_the_canvas_back(opened: Opened) -> None:
    _, dock, cells, place = opened
    dock.show_page("Review")
    for leave in (lambda: dock.show_page("Grid"), dock.workbench.navigator.to_frames):
        click(cells, 1)
        assert place.is_open
        leave()
        assert not place.is_open
        dock.show_page("Review")


def test_a_button_of_the_result_shows_the_module_and_not_the_cell(
    opened: Opened, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, dock, cells, place = opened
    navigator, looked = dock.workbench.navigator, []
    monkeypatch.setattr(navigator, "_look_at", lambda *at: looked.append(at[2:4]))
    click(cells, 1)
    navigator.to_module()
    qtbot.waitUntil(lambda: not place.is_waiting)
    assert not place.is_open
    module, cell = max(looked), min(looked)
    assert looked[-1] == module != cell, "the last look is the one that was asked for"


def test_a_run_that_ends_does_not_take_the_large_cell_away(
    opened: Opened, tiny_inspection: Inspection, qtbot: QtBot
) -> None:
    _, dock, cells, place = opened
    qtbot.waitUntil(lambda: not dock.workbench.is_fitting)
    click(cells, 1)
    model = dock.workbench.model
    model.inspection = replace(tiny_inspection, cracks=replace(tiny_inspection.cracks))
    with qtbot.waitSignal(cells.filled):
        model.revise(model.inspection)
    qtbot.waitUntil(lambda: not dock.workbench.is_fitting)
    assert place.is_open
    dock.workbench.navigator.to_all()
    assert not place.is_open


def test_without_large_a_click_only_moves_the_view(opened: Opened) -> None:
    _, dock, cells, place = opened
    cells.large.setChecked(False)
    click(cells, 2)
    assert dock.workbench.model.selected_cell == (0, 2)
    assert not place.is_open


def test_gallery_and_large_cell_leave_room_for_the_live_cell(opened: Opened) -> None:
    """Beside it and the controls 640 px are left of 1280."""
    _, _, cells, place = opened
    click(cells, 1)
    assert cells.minimumSizeHint().width() <= 630
    assert place.minimumSizeHint().width() <= 630


def test_closing_the_window_while_a_cell_is_large_gives_the_docks_back(opened: Opened) -> None:
    viewer, _, cells, place = opened
    click(cells, 1)
    viewer.close()
    assert not place.is_open
