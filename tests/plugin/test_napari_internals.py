"""The private names of napari that the workbench uses are there, and in one file only."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import napari
import pytest
from napari.components import ViewerModel
from qtpy.QtWidgets import QDockWidget, QWidget

import napari_pv_inspect
from napari_pv_inspect import napari_internals as internals

PRIVATE = re.compile(r"_qt_(viewer|window)\b|\bnapari\._|from napari\.\S+\._|__wrapped__")


def test_they_were_seen_on_the_napari_that_is_installed() -> None:
    installed = tuple(int(n) for n in napari.__version__.split(".")[:2])
    assert installed == internals.SEEN_ON, "look at napari_internals.py, then change SEEN_ON"


def test_a_window_has_the_canvas_in_its_middle_and_two_docks_for_layers(workbench: Any) -> None:
    viewer, *_ = workbench
    window = internals.main_window(viewer)
    assert window is not None
    canvas = internals.canvas_area(window)
    layout = internals.central_layout(window)
    assert layout.indexOf(canvas) >= 0
    assert canvas.isAncestorOf(viewer.window._qt_viewer.canvas.native)
    controls, layers = internals.layer_docks(window)
    assert controls is not layers
    assert {controls, layers} <= set(window.findChildren(QDockWidget))


def test_a_viewer_without_a_window_has_none() -> None:
    assert internals.main_window(ViewerModel()) is None


def test_the_proxy_that_plugins_get_is_unwrapped(workbench: Any) -> None:
    from napari.utils._proxies import PublicOnlyProxy

    viewer, *_ = workbench
    assert internals.unwrapped(PublicOnlyProxy(viewer)) is viewer
    assert internals.unwrapped(viewer) is viewer


def test_a_window_that_napari_did_not_make_is_refused(qtbot: Any) -> None:
    from qtpy.QtWidgets import QMainWindow

    window = QMainWindow()
    qtbot.addWidget(window)
    with pytest.raises(RuntimeError, match="central layout"):
        internals.central_layout(window)
    window.setCentralWidget(QWidget())
    with pytest.raises(RuntimeError, match="central layout"):
        internals.central_layout(window)


def test_a_message_of_several_lines_is_shown_whole(workbench: Any, qtbot: Any) -> None:
    from napari._qt.dialogs.qt_notification import NapariQtNotification

    viewer, *_ = workbench
    window = internals.main_window(viewer)
    assert window is not None
    canvas = viewer.window._qt_viewer.canvas.native
    text = "A sentence that is longer than a line. " * 8
    message = NapariQtNotification(text, "error", parent=canvas)
    message.show()
    internals.expand_newest_message(window)
    assert message.property("expanded")
    internals.expand_newest_message(window)
    assert message.property("expanded"), "a second call folds nothing"
    message.close()


def test_no_other_file_of_the_workbench_uses_a_private_name() -> None:
    root = Path(napari_pv_inspect.__file__).parent
    own = Path(internals.__file__)
    found = [
        f"{path.relative_to(root)}: {match.group()}"
        for path in sorted(root.rglob("*.py"))
        if path != own
        for match in PRIVATE.finditer(path.read_text(encoding="utf-8"))
    ]
    assert not found
    assert PRIVATE.search(own.read_text(encoding="utf-8")), "the pattern finds them"
