"""The hands and eyes of the scripted expert: mouse, keyboard, patience, and a camera."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from qtpy.QtCore import QMimeData, QPoint, QPointF, Qt, QTimer, QUrl
from qtpy.QtGui import QDragEnterEvent, QDropEvent
from qtpy.QtTest import QTest
from qtpy.QtWidgets import (
    QAbstractItemView,
    QAbstractSpinBox,
    QApplication,
    QFileDialog,
    QLineEdit,
    QSlider,
    QWidget,
)

from napari_pv_inspect.application import build
from napari_pv_inspect.models.workbench import RunState

__all__ = ["SIZE", "Expert"]

SIZE = (1280, 800)
NO_DITHER = Image.Dither.NONE
LEFT, NONE = Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier


class Expert:
    """Sits before one window of the workbench at a time.

    Parameters
    ----------
    open_viewer : callable
        Returns a napari viewer in a new window.
    out : Path
        Folder of the pictures.
    """

    def __init__(self, open_viewer: Callable[[], Any], out: Path) -> None:
        self._open_viewer = open_viewer
        self._out = out
        out.mkdir(parents=True, exist_ok=True)
        self.pictures: list[Path] = []

    def sit_down(self) -> None:
        """Open a window."""
        self.viewer = self._open_viewer()
        self.window = self.viewer.window._qt_window
        self.window.resize(*SIZE)
        self.dock, self.cells = build(self.viewer)
        self.workbench = self.dock.workbench
        self.model = self.workbench.model
        self._activate()
        self.wait(1.0)

    def leave(self) -> None:
        """Close the window."""
        self.viewer.close()
        self.wait(0.5)

    # Patience

    def wait(self, seconds: float) -> None:
        """Let the window work for a while."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            QApplication.processEvents()
            time.sleep(0.005)

    def until(self, happened: Callable[[], Any], what: str, timeout_s: float = 60.0) -> None:
        """Wait for something; AssertionError if it does not come."""
        end = time.monotonic() + timeout_s
        while not happened():
            assert time.monotonic() < end, f"Waited {timeout_s:.0f} s in vain: {what}."
            self.wait(0.02)

    def until_idle(self) -> None:
        """Wait for the end of the run."""
        self.until(lambda: self.model.run_state is RunState.IDLE, "the end of the run", 300.0)
        self.wait(0.5)

    # Mouse and keyboard

    def click(self, widget: QWidget, at: QPoint | None = None) -> None:
        """Click a widget that is seen and enabled."""
        assert widget.isVisible(), f"{widget} is not on the screen."
        assert widget.isEnabled(), f"{widget} is greyed out."
        QTest.mouseClick(widget, LEFT, NONE, widget.rect().center() if at is None else at)
        self.wait(0.15)

    def turn_to(self, page: str) -> None:
        """Click the tab of a page of the controls."""
        bar = self.dock.pages.tabBar()
        (k,) = (k for k in range(bar.count()) if bar.tabText(k) == page)
        self.click(bar, bar.tabRect(k).center())

    def press(self, widget: QWidget, *keys: Any) -> None:
        """Press keys in a widget."""
        widget.window().activateWindow()
        widget.setFocus()
        self.until(widget.hasFocus, f"the keyboard in {widget}", 5.0)
        for key in keys:
            QTest.keyClick(widget, key)
            self.wait(0.1)

    def write(self, line: QLineEdit, text: str) -> None:
        """Fill in a line."""
        self.press(line)
        line.selectAll()
        QTest.keyClicks(line, text)
        QTest.keyClick(line, Qt.Key.Key_Return)
        self.wait(0.1)

    def fill_in(self, number: QAbstractSpinBox, value: float) -> None:
        """Type a number into its field."""
        self.press(number)
        number.selectAll()
        QTest.keyClicks(number, f"{value:g}")
        QTest.keyClick(number, Qt.Key.Key_Return)
        self.wait(0.1)

    def drop(self, path: Path) -> None:
        """Drop a file or folder on the canvas."""
        data = QMimeData()
        data.setUrls([QUrl.fromLocalFile(str(path))])
        copy, middle = Qt.DropAction.CopyAction, self.canvas.rect().center()
        # Qt delivers a drop only where the drag was let in.
        QApplication.sendEvent(self.canvas, QDragEnterEvent(middle, copy, data, LEFT, NONE))
        QApplication.sendEvent(self.canvas, QDropEvent(QPointF(middle), copy, data, LEFT, NONE))
        self.wait(0.1)

    def undo(self) -> None:
        """Press Ctrl+Z in the window."""
        where = QApplication.focusWidget() or self.canvas
        QTest.keyClick(where, Qt.Key.Key_Z, Qt.KeyboardModifier.ControlModifier)
        self.wait(0.2)

    def drag(self, widget: QWidget, *way: QPoint) -> None:
        """Drag the mouse with the left button from point to point."""
        QTest.mouseMove(widget, way[0])
        self.wait(0.1)
        QTest.mousePress(widget, LEFT, NONE, way[0])
        for start, end in pairwise(way):
            for share in np.linspace(0.2, 1.0, 5):
                QTest.mouseMove(widget, start + (end - start) * float(share))
                self.wait(0.03)
        QTest.mouseRelease(widget, LEFT, NONE, way[-1])
        self.wait(0.3)

    def slide(self, slider: QSlider, by: float) -> None:
        """Drag the handle of a slider by a share of its range."""
        room = slider.width() - 16
        at = 8 + room * (slider.value() - slider.minimum()) / (slider.maximum() - slider.minimum())
        y = slider.height() // 2
        self.drag(slider, QPoint(round(at), y), QPoint(round(at + by * room), y))

    def click_row(self, view: QAbstractItemView, index: Any, from_left: int | None = None) -> None:
        """Click an entry of a list or table."""
        view.scrollTo(index)
        box = view.visualRect(index)
        place = box.center()
        if from_left is not None:
            place.setX(box.left() + from_left)
        self.click(view.viewport(), place)

    @property
    def canvas(self) -> QWidget:
        """The widget that the layers are drawn in."""
        return self.viewer.window._qt_viewer.canvas.native

    def on_canvas(self, row: float, col: float) -> QPoint:
        """Where a place of the world, (row, col), is on the canvas."""
        camera, size = self.viewer.scene.camera, self.canvas.rect()
        _, y, x = camera.center
        dx, dy = (col - x) * camera.zoom, (row - y) * camera.zoom
        return QPoint(round(size.width() / 2 + dx), round(size.height() / 2 + dy))

    def choose(self, opens_dialog: Callable[[], None], path: Path) -> None:
        """Do what opens a file dialog, and type a path into it."""
        timer, done = QTimer(), []

        def answer() -> None:
            dialog = QApplication.activeModalWidget()
            if isinstance(dialog, QFileDialog) and not done:
                done.append(dialog)
                line = dialog.findChild(QLineEdit)
                # Typed, its completer gets in the way.
                line.setText(str(path))
                QTimer.singleShot(0, dialog, dialog.accept)

        timer.timeout.connect(answer)
        timer.start(100)
        opens_dialog()
        timer.stop()
        assert done, "no file dialog came"
        self._activate()
        self.wait(0.2)

    def _activate(self) -> None:
        # There is no window manager that would do it.
        self.window.activateWindow()

    # Camera

    def photograph(self, name: str) -> None:
        """Save what the window shows, in few colours."""
        self.wait(0.6)
        picture = self.window.screen().grabWindow(self.window.winId()).toImage()
        picture = picture.convertToFormat(picture.Format.Format_RGB888)
        height, width = picture.height(), picture.width()
        rows = np.asarray(picture.constBits(), np.uint8).reshape(height, picture.bytesPerLine())
        pixels = rows[:, : 3 * width].reshape(height, width, 3)
        assert pixels.max() > 0, "the picture is black"
        file = self._out / f"{name}.png"
        few = Image.fromarray(pixels).quantize(256, Image.Quantize.MAXCOVERAGE, dither=NO_DITHER)
        few.save(file, optimize=True)
        self.pictures.append(file)
        sys.stdout.write(f"{file}\n")
