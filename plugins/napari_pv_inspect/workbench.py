"""One workbench per viewer: makes, connects and closes its model, layers and controllers."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar
from weakref import WeakKeyDictionary

import numpy as np
from napari.components import ViewerModel
from napari.layers import Layer
from napari.utils.notifications import show_error
from psygnal import Signal
from qtpy.QtCore import QEvent, QObject, Qt, QTimer
from superqt.utils import qthrottled

from napari_pv_inspect.io.drops import DropHandler
from napari_pv_inspect.io.opener import Opener
from napari_pv_inspect.io.saver import Saver
from napari_pv_inspect.layers.corrections import CorrectionLayers
from napari_pv_inspect.layers.frames import FramesLayer
from napari_pv_inspect.layers.geometry import GeometryLayers
from napari_pv_inspect.layers.layer_data import RESULT_KEY
from napari_pv_inspect.layers.module import ModuleLayers
from napari_pv_inspect.layers.navigation import Navigator
from napari_pv_inspect.layers.points import PointsLayer
from napari_pv_inspect.live.cell import LiveCell
from napari_pv_inspect.live.grid import LiveKappa
from napari_pv_inspect.live.kappa_curve import KappaCurve
from napari_pv_inspect.live.layout_guess import LayoutGuesser
from napari_pv_inspect.live.recalibration import Recalibration
from napari_pv_inspect.models.history import History
from napari_pv_inspect.models.point_editor import PointEditor
from napari_pv_inspect.models.trials import Tuning
from napari_pv_inspect.models.workbench import WorkbenchModel
from napari_pv_inspect.napari_internals import (
    canvas_area,
    expand_newest_message,
    main_window,
    unwrapped,
)
from napari_pv_inspect.review.controller import Reviewer
from napari_pv_inspect.session.trials import TrialStore
from napari_pv_inspect.session.view_state import SessionStore
from napari_pv_inspect.tasks.garbage import collect_anywhere, collect_in_main_thread
from napari_pv_inspect.tasks.run import RunController
from napari_pv_inspect.widgets.shortcuts import Key, Shortcuts
from pv_inspect.inspection.inspection import Inspection

__all__ = ["Workbench"]

PREVIEW_MS = 300
STATUS_LETTERS = 90


class Workbench(QObject):
    """Everything of pv-inspect that belongs to one viewer, except the docks that show it."""

    closing = Signal()

    _of_viewer: ClassVar[WeakKeyDictionary[Any, Workbench]] = WeakKeyDictionary()

    @classmethod
    def of(cls, viewer: ViewerModel) -> Workbench:
        """Return the workbench of a viewer, made when first asked for."""
        viewer = unwrapped(viewer)
        if viewer not in cls._of_viewer:
            cls._of_viewer[viewer] = cls(viewer)
        return cls._of_viewer[viewer]

    def __init__(self, viewer: ViewerModel) -> None:
        super().__init__()
        self.viewer = viewer
        self.has_gallery = False
        self.model = WorkbenchModel()
        self.history = History()
        self.runs = RunController(self.model)
        self.editor = PointEditor(self.model, self.history)
        self.frames = FramesLayer(viewer, self.model)
        self.geometry = GeometryLayers(viewer, self.model)
        self.module = ModuleLayers(viewer, self.model)
        self.guesser = LayoutGuesser(self.model)
        self.points = PointsLayer(viewer, self.model, self.frames, self.editor)
        self.live = LiveKappa(viewer, self.model, self.frames, self.geometry, self.editor)
        self.points.dragged.connect(self.live.drag)
        self.recalibration = Recalibration(self.model, self.editor)
        self.kappa_curve = KappaCurve(self.model)
        self.tuning = Tuning(self.model, self.history)
        self.live_cell = LiveCell(self.model, self.tuning)
        self.history.committing.connect(self.live_cell.commit)
        self.navigator = Navigator(viewer, self.model, self.module)
        self.navigator.layers_wanted.connect(self._bring_back)
        self.opener = Opener(self.model)
        self.saver = Saver(self.model)
        self.session = SessionStore(viewer, self.model, self.frames)
        self.trials = TrialStore(self.model, self.tuning)
        self.review = Reviewer(self.model, self.history)
        self.corrections = CorrectionLayers(viewer, self.module, self.review.state)
        self.opener.may_leave = self._may_leave
        self._preview: Any = None
        self._show_preview = qthrottled(self._draw_preview, timeout=PREVIEW_MS)
        self.model.preview_changed.connect(self._on_preview)
        self.model.noticed.connect(self._on_notice)
        self.model.sequence_changed.connect(self._on_sequence)
        # Last: taking a layer may remove another, which napari's list must be ready for.
        viewer.layers.events.inserted.connect(self._on_inserted, position="last")
        self._main_window = main_window(viewer)
        self._refused = False
        self._canvas_size = (0, 0)
        self._fit_timer = QTimer(self)
        self._fit_timer.setSingleShot(True)
        self._fit_timer.setInterval(50)
        self._fit_timer.timeout.connect(self.fit_if_laid_out)
        self.opener.result_opened.connect(self._on_result)
        self.saver.saved.connect(self._on_saved)
        self.shortcuts: Shortcuts | None = None
        self._drops: DropHandler | None = None
        if self._main_window is not None:
            collect_in_main_thread(self)
            # The controls keep their height when the gallery comes.
            self._main_window.setCorner(
                Qt.Corner.BottomRightCorner, Qt.DockWidgetArea.RightDockWidgetArea
            )
            self._drops = DropHandler(canvas_area(self._main_window), self.open)
            self._main_window.installEventFilter(self)
            # `viewer.close()` closes the canvas first: without it no question can be asked.
            canvas_area(self._main_window).installEventFilter(self)
            self.shortcuts = Shortcuts(self._main_window)
            self.shortcuts.add(Key("Ctrl+Z", "Undo", "Everywhere"), self.history.undo)
            self.shortcuts.add(Key("Ctrl+Shift+Z", "Redo", "Everywhere"), self.history.redo)
        for layer in list(viewer.layers):
            self._take_layer(layer)

    def open(self, path: Any) -> None:
        """Open frames or a result folder in the background; what is wrong becomes a notice."""
        self.opener.open(path)

    def close(self) -> None:
        """Stop a run and disconnect from the viewer; called when its window closes."""
        if self.viewer not in self._of_viewer:
            return
        self.closing.emit()
        del self._of_viewer[self.viewer]
        self.runs.shutdown()
        self._show_preview.cancel()
        self._fit_timer.stop()
        saved = self.saver.close()
        if saved is not None and saved[0] is self.model.inspection:
            self.session.attach(saved[1])
            self.trials.attach(saved[1])
        self.session.close()
        self.trials.close()
        self.opener.close()
        if self._drops is not None:
            self._drops.close()
        self.live.close()
        self.points.close()
        self.recalibration.close()
        self.kappa_curve.close()
        self.live_cell.close()
        self.guesser.close()
        self.review.close()
        self.frames.close()
        self.viewer.layers.events.inserted.disconnect(self._on_inserted)
        collect_anywhere(self)
        if self._main_window is not None:
            self._main_window.removeEventFilter(self)
            canvas_area(self._main_window).removeEventFilter(self)
            if self.shortcuts is not None:
                self.shortcuts.close()
            self._main_window = None

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: N802 (Qt's name)
        """Close with the window, and before it."""
        if event.type() != QEvent.Type.Close or self._main_window is None:
            return False
        canvas = canvas_area(self._main_window)
        if watched not in (self._main_window, canvas):
            return False
        # napari closes the window right after the canvas: the user is not asked twice.
        refused, self._refused = self._refused, False
        if not refused and self.review.may_close(self._main_window):
            self.close()
            return False
        self._refused = watched is canvas
        event.ignore()
        return True

    def fit_view(self) -> None:
        """Show everything, once docks that come or go have settled."""
        self._canvas_size = (0, 0)
        self._fit_timer.start()

    @property
    def is_fitting(self) -> bool:
        """Whether the view is still to be fitted."""
        return self._fit_timer.isActive()

    def fit_if_laid_out(self) -> None:
        """Show everything if the canvas has kept its size since the last time, else try later."""
        if self.viewer.canvas.size != self._canvas_size:
            self._canvas_size = self.viewer.canvas.size
            self._fit_timer.start()
        elif not self.session.aim():
            self.navigator.fit()

    def _bring_back(self) -> None:
        for layers in (self.frames, self.points, self.geometry, self.module):
            layers.bring_back()

    def _may_leave(self) -> bool:
        return self.review.may_leave(self._main_window)

    def _on_result(self, result: Inspection) -> None:
        self.session.resume(result)
        self.trials.resume(result)
        self.fit_view()

    def _on_saved(self, inspection: Inspection, folder: Path) -> None:
        if inspection is self.model.inspection:
            self.session.attach(folder)
            self.trials.attach(folder)
            self.review.saved(folder)

    def _on_sequence(self, _: object) -> None:
        self.history.clear()
        self.fit_view()

    def _on_inserted(self, event: Any) -> None:
        self._take_layer(event.value)

    def _take_layer(self, layer: Layer) -> None:
        if self.frames.take_layer(layer):
            return
        self.module.take_layer(layer)
        if isinstance(result := layer.metadata.get(RESULT_KEY), Inspection):
            self.opener.restore(result)

    def _on_preview(self, image: Any) -> None:
        self._preview = image
        if image is None:
            self._show_preview.cancel()
        else:
            self._show_preview()

    def _draw_preview(self) -> None:
        if isinstance(self._preview, np.ndarray):
            self.module.preview(self._preview)

    def _on_notice(self, text: str, is_error: bool) -> None:
        # Good news stands in the dock and in the status bar: it needs no pop-up over the image.
        # A long sentence would be cut off there.
        self.viewer.status = text if len(text) <= STATUS_LETTERS else ""
        if is_error:
            show_error(text)
            if self._main_window is not None:
                expand_newest_message(self._main_window)
