"""Where a cell is shown large: in the place of the canvas, with the docks beside it folded."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from qtpy.QtCore import Qt, QTimer, Signal
from qtpy.QtWidgets import QDockWidget, QMainWindow, QVBoxLayout, QWidget

from napari_pv_inspect.docks.cell import GALLERY, CellDock, focus_gallery
from napari_pv_inspect.models.workbench import RunState
from napari_pv_inspect.napari_internals import (
    canvas_area,
    central_layout,
    layer_docks,
    main_window,
)
from napari_pv_inspect.review.subject import Subject
from napari_pv_inspect.widgets.docking import dock_of
from napari_pv_inspect.widgets.listen import listen
from napari_pv_inspect.workbench import Workbench

__all__ = ["LargeCell", "large_cell", "open_cell"]

REVIEW_PAGE = "Review"


class LargeCell(QWidget):
    """Shows the cell view instead of the canvas, and gives all back when it leaves.

    The docks are the user's: only those that it has folded itself come back, and only if the user
    did not bring them back before.

    Attributes
    ----------
    view : CellDock
    is_open : bool
    """

    toggled = Signal(bool)

    def __init__(self, workbench: Workbench, window: QMainWindow) -> None:
        super().__init__()
        self._workbench = workbench
        self._folded: list[tuple[QDockWidget, int, int]] = []
        self._then: Callable[[], None] | None = None
        self._layout_timer = QTimer(self)
        self._layout_timer.setSingleShot(True)
        self._layout_timer.timeout.connect(self._on_laid_out)
        self.is_open = False
        self.view = CellDock(workbench.viewer)
        for button in (self.view.bar.back, self.view.bar.gallery):
            button.show()
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.view)
        self.hide()
        central_layout(window).addWidget(self)
        self.view.back_wanted.connect(self.back)
        self.view.gallery_wanted.connect(self.toggle_gallery)
        listen(workbench.review.state.data.subject_changed, self._on_subject)
        listen(workbench.model.run_changed, self._on_run)
        listen(workbench.navigator.canvas_wanted, self._on_canvas_wanted)
        listen(workbench.session.page_turned, self._on_page)
        listen(workbench.closing, self._on_closing)

    @property
    def is_waiting(self) -> bool:
        """Whether something is done once the canvas is laid out."""
        return self._layout_timer.isActive()

    def open(self, alone: bool) -> None:
        """Show the selected cell; ``alone``: with the gallery folded, and the keyboard."""
        if not self.is_open:
            self.is_open = True
            for dock in layer_docks(self._window):
                area = self._window.dockWidgetArea(dock)
                if area == Qt.DockWidgetArea.LeftDockWidgetArea:
                    self._fold(dock)
            canvas_area(self._window).hide()
            self.show()
            self.toggled.emit(True)
        if alone:
            gallery = dock_of(self._gallery)
            if gallery is not None:
                self._fold(gallery)
            self.view.setFocus()

    def back(self) -> None:
        """Show the canvas again, with the cell in its middle."""
        if self.is_open and (cell := self._workbench.model.selected_cell) is not None:
            self._then = partial(self._workbench.navigator.to_cell, *cell)
        self.leave()

    def leave(self) -> None:
        """Show the canvas again."""
        if not self.is_open:
            return
        self._give_back()
        self.toggled.emit(False)
        # The canvas and the docks have their sizes when they are laid out.
        self._layout_timer.start()

    def toggle_gallery(self) -> None:
        """Fold the gallery, or show it; the keyboard goes to what is shown."""
        gallery = dock_of(self._gallery)
        if gallery is None:
            return
        if gallery.isHidden():
            gallery.show()
            self._layout_timer.start()
            focus_gallery(self._workbench)
        else:
            self._fold(gallery)
            self.view.setFocus()

    @property
    def _window(self) -> QMainWindow:
        # Asked for each time: a window that is closed has to be free to go.
        window = main_window(self._workbench.viewer)
        assert window is not None, "made only where there is a window"
        return window

    @property
    def _gallery(self) -> QWidget | None:
        gallery: QWidget | None = self._workbench.viewer.window.dock_widgets.get(GALLERY)
        return gallery

    def _on_canvas_wanted(self, look: Callable[[], None]) -> None:
        if self.is_open:
            self._then = look
            self.leave()

    def _on_page(self, page: str) -> None:
        if page != REVIEW_PAGE:
            self.leave()

    def _on_subject(self, subject: Subject | None) -> None:
        if subject is None:
            self.leave()

    def _on_run(self, state: RunState) -> None:
        # The image that grows is on the canvas.
        if state is RunState.RUNNING:
            self.leave()

    def _on_closing(self) -> None:
        # napari may store where the docks are.
        if self.is_open:
            self._give_back()
        self._layout_timer.stop()
        self._folded.clear()
        self._then = None

    def _fold(self, dock: QDockWidget) -> None:
        if not dock.isHidden() and not dock.isFloating():
            self._folded = [entry for entry in self._folded if entry[0] is not dock]
            self._folded.append((dock, dock.width(), dock.height()))
            dock.hide()

    def _give_back(self) -> None:
        self.is_open = False
        self.hide()
        canvas_area(self._window).show()
        for dock, _, _ in self._folded:
            dock.show()

    def _on_laid_out(self) -> None:
        """Give docks that came back the sizes that they had."""
        back = [entry for entry in self._folded if not entry[0].isHidden()]
        self._folded = [entry for entry in self._folded if entry not in back]
        back = [entry for entry in back if not entry[0].isFloating()]
        if back:
            docks, widths, heights = ([*values] for values in zip(*back, strict=True))
            self._window.resizeDocks(docks, widths, Qt.Orientation.Horizontal)
            self._window.resizeDocks(docks, heights, Qt.Orientation.Vertical)
        then, self._then = self._then, None
        if then is not None and not self.is_open:
            then()


def large_cell(workbench: Workbench) -> LargeCell | None:
    """Return where a workbench shows cells large, made when first asked for.

    None if there is no window.
    """
    window = main_window(workbench.viewer)
    if window is None:
        return None
    return window.findChild(LargeCell) or LargeCell(workbench, window)


def open_cell(workbench: Workbench, alone: bool = True) -> None:
    """Show the selected cell large.

    Parameters
    ----------
    workbench : Workbench
    alone : bool
        Fold the gallery as well, and take the keyboard.
    """
    review = workbench.review.state
    if review.data.subject is None:
        workbench.model.notice(review.data.why_empty)
        return
    own = dock_of(workbench.viewer.window.dock_widgets.get("Cell"))
    if own is not None and own.isVisible():  # a dock that the user has placed, perhaps elsewhere
        own.raise_()
        if alone:
            own.widget().setFocus()
        return
    if (place := large_cell(workbench)) is not None:
        place.open(alone)
