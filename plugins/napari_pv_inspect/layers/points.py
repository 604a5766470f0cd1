"""Crossing points over the frames, which the user can edit: measured, predicted, edited."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager
from typing import Any

import numpy as np
from napari.components import ViewerModel
from napari.layers import Points
from napari.layers.base import ActionType
from napari.utils.colormaps.standardize_color import transform_color
from numpy.typing import NDArray
from psygnal import Signal

from napari_pv_inspect import appearance
from napari_pv_inspect.layers.frames import FramesLayer
from napari_pv_inspect.layers.overlays import CrossingMarks, crossing_marks
from napari_pv_inspect.layers.slot import LayerSlot
from napari_pv_inspect.models.point_editor import PointEditor
from napari_pv_inspect.models.point_edits import Point
from napari_pv_inspect.models.workbench import RunState, WorkbenchModel

__all__ = ["PointsLayer"]

COLOURS = transform_color(
    [appearance.MEASURED_COLOUR, appearance.PREDICTED_COLOUR, appearance.EDITED_COLOUR]
)
# Rings leave the crossing visible; thin crosses would not be seen.
FACES = COLOURS * np.array([[0.0], [1.0], [0.0]])
DONE = (ActionType.CHANGED, ActionType.ADDED, ActionType.REMOVED)


class PointsLayer:
    """Shows the points of the editor in a layer, and passes the user's edits to the editor.

    napari changes the layer first and sends its event afterwards: each edit is read off, given to
    the editor, and the layer is drawn again from what the editor made of it. Only points of the
    shown frame can be changed; whatever else happens to the layer is taken back.
    """

    mode_changed = Signal(str)
    dragged = Signal(int, object)
    """Frame, and where its dragged crossings are: {number: (x, y)}; {} when the drag ends."""

    def __init__(
        self, viewer: ViewerModel, model: WorkbenchModel, frames: FramesLayer, editor: PointEditor
    ) -> None:
        self._viewer = viewer
        self._model = model
        self._frames = frames
        self._editor = editor
        self._marks: CrossingMarks | None = None
        self._drawn: tuple[object, ...] = ()
        self._layer: Points | None = None
        self._writing = False
        self._dragged: dict[int, Point] = {}
        self._frame = 0
        self._slot = LayerSlot(
            viewer,
            Points,
            name=appearance.POINTS,
            ndim=3,
            size=appearance.POINT_SIZES[0],
            symbol=appearance.POINT_SYMBOLS[0],
            face_color="transparent",
            border_width=0.22,
            opacity=0.95,
        )
        model.sequence_changed.connect(self._on_sequence)
        model.inspection_changed.connect(self._on_change)
        model.run_changed.connect(self._on_run)
        editor.changed.connect(self._on_change)
        viewer.dims.events.current_step.connect(self._on_step)

    def close(self) -> None:
        """Disconnect from the viewer."""
        self._viewer.dims.events.current_step.disconnect(self._on_step)

    @property
    def layer(self) -> Points | None:
        """The layer, None while there are no points or the user has deleted it."""
        return self._slot.layer

    @property
    def marks(self) -> CrossingMarks | None:
        """What the layer shows, a row for each of its points."""
        return self._marks

    @property
    def mode(self) -> str:
        """What the mouse does on the layer, as napari calls it: "select", "add", "pan_zoom"."""
        layer = self._slot.layer
        return str(layer.mode) if layer is not None else "pan_zoom"

    def use(self, mode: str) -> None:
        """Let the mouse move the view, select and drag, or add; brings a deleted layer back."""
        if self._slot.layer is None:
            self._draw(anew=True)
        layer = self._slot.layer
        if layer is None:
            self._model.notice("There are no crossing points yet: detect the grid first.")
            self.mode_changed.emit("pan_zoom")
            return
        if self._model.run_state is not RunState.IDLE and mode != "pan_zoom":
            self._model.notice("Points can be edited when the run has ended.")
            mode = "pan_zoom"
        layer.visible = True
        self._viewer.layers.selection.active = layer
        layer.mode = mode
        self.mode_changed.emit(self.mode)

    def bring_back(self) -> None:
        """Show the points again if the user deleted them all."""
        if self._slot.layer is None:
            self._draw(anew=True)

    def delete_selected(self) -> None:
        """Delete the selected points of the shown frame."""
        layer = self._slot.layer
        chosen = () if layer is None else layer.selected_data
        if not len(chosen):
            self._model.notice("Select points first: click on one, or draw a box around some.")
            return
        self._remove(list(chosen))
        self._draw(anew=True)

    def _on_sequence(self, _: object) -> None:
        self._marks, self._drawn = None, ()
        self._slot.drop()

    def _on_change(self, _: object = None) -> None:
        self._draw()

    def _on_run(self, state: RunState) -> None:
        if (layer := self._slot.layer) is not None:
            layer.editable = state is RunState.IDLE

    def _on_step(self, _: object = None) -> None:
        """Drop selection and unfinished drags when another frame is shown."""
        layer, frame = self._slot.layer, self._frames.frame
        # The event comes too when a point beyond the others widens the range of rows or columns.
        if layer is None or self._marks is None or frame == self._frame:
            return
        self._frame = frame
        if len(layer.selected_data):
            layer.selected_data = set()
        self._restore()

    def _draw(self, anew: bool = False) -> None:
        shown = self._model.shown
        if shown is None or shown.crossings is None:
            return
        crossings, calibration = shown.crossings, shown.calibration
        if crossings is self._editor.crossings:
            source: tuple[object, ...] = (crossings, self._editor.calibration)
            predicted: Callable[[int], NDArray[np.float64]] | None = self._editor.predicted
        else:
            source = (crossings, calibration)
            predicted = None if calibration is None else calibration.crossings_px
        if not anew and _same(source, self._drawn):
            return  # Also if the user deleted the layer: the tools bring it back.
        self._drawn = source
        marks = crossing_marks(crossings, predicted)
        with self._own_writing():
            if len(marks.points) == 0:
                self._slot.drop()
                self._marks = None
            else:
                self._show(marks)

    def _show(self, marks: CrossingMarks) -> None:
        before, self._marks = self._marks, marks
        looks: dict[str, Any] = {}
        if (
            before is None
            or self._slot.layer is not self._layer
            or not np.array_equal(before.kind, marks.kind)
        ):
            looks = {
                "features": {"crossing": marks.crossing, "kind": marks.kind},
                "symbol": np.array(appearance.POINT_SYMBOLS)[marks.kind],
                "size": np.array(appearance.POINT_SIZES)[marks.kind],
                "border_color": COLOURS[marks.kind],
                "face_color": FACES[marks.kind],
            }
        # napari moves points within the array that it was given.
        layer = self._slot.redraw(marks.points.copy(), **looks)
        if layer is not self._layer:
            self._layer = layer
            layer.events.data.connect(self._on_data)
            layer.events.mode.connect(self._on_mode)
            layer.events.set_data.connect(self._on_drawn)
            # napari pastes without telling anybody.
            layer.bind_key("Control-V", self._on_paste, overwrite=True)
        layer.editable = self._model.run_state is RunState.IDLE
        self._set_dragged({})

    @contextmanager
    def _own_writing(self) -> Generator[None]:
        self._writing = True
        try:
            yield
        finally:
            self._writing = False

    def _on_mode(self, _: object = None) -> None:
        self.mode_changed.emit(self.mode)

    def _on_paste(self, _: object = None) -> None:
        self._model.notice("Points can't be pasted: every crossing has one. Drag or add instead.")

    def _on_drawn(self, _: object = None) -> None:
        """Read where points are dragged to: napari sends no data event before the release."""
        marks, layer = self._marks, self._layer
        if self._writing or self._slot.layer is not layer or marks is None or layer is None:
            return
        if not layer.events.data.blocked():
            return
        data = np.asarray(layer.data)
        if data.shape == marks.points.shape:
            self._set_dragged(self._elsewhere(data, marks))

    def _set_dragged(self, dragged: dict[int, Point]) -> None:
        if dragged != self._dragged:
            self._dragged = dragged
            self.dragged.emit(self._frames.frame, dragged)

    def _elsewhere(self, data: Any, marks: CrossingMarks) -> dict[int, Point]:
        """Crossings of the shown frame that the layer has at other places: {number: (x, y)}."""
        moved = np.abs(data - marks.points).max(axis=1) > 1e-9
        here = moved & self._in_frame(marks) & np.isfinite(data).all(axis=1)
        return {
            int(marks.crossing[i]): (float(data[i, 2]), float(data[i, 1]))
            for i in np.flatnonzero(here)
        }

    def _on_data(self, event: Any) -> None:
        if self._writing or event.action not in DONE or self._slot.layer is not self._layer:
            return
        try:
            self._read(event.action, event.data_indices)
        finally:
            self._restore()

    def _restore(self) -> None:
        """Draw again unless the layer shows what the editor made of the change."""
        marks, layer = self._marks, self._layer
        if marks is None or layer is None or not np.array_equal(layer.data, marks.points):
            self._draw(anew=True)

    def _read(self, action: ActionType, indices: Iterable[int]) -> None:
        marks, layer = self._marks, self._layer
        if marks is None or layer is None:
            return
        data, n = np.asarray(layer.data), len(marks.points)
        if action is ActionType.REMOVED and len(data) < n:
            self._remove([int(i) for i in indices])
        elif action is ActionType.ADDED and len(data) > n:
            new = data[n:]
            here = new[np.round(new[:, 0]) == self._frames.frame]
            self._editor.add(self._frames.frame, [(float(x), float(y)) for _, y, x in here])
        elif action is ActionType.CHANGED and len(data) == n:
            here = self._elsewhere(data, marks)
            if not here and (np.abs(data - marks.points) > 1e-9).any():
                self._model.notice("Only points of the shown frame can be moved.")
            self._editor.move(self._frames.frame, here)

    def _remove(self, rows: list[int]) -> None:
        marks = self._marks
        if marks is None:
            return
        chosen = np.zeros(len(marks.points), dtype=bool)
        chosen[[row for row in rows if 0 <= row < len(chosen)]] = True
        here = chosen & self._in_frame(marks)
        if here.any():
            self._editor.remove(self._frames.frame, marks.crossing[here].tolist())
        else:
            self._model.notice("Only points of the shown frame can be deleted.")

    def _in_frame(self, marks: CrossingMarks) -> Any:
        return marks.frame == self._frames.frame


def _same(a: tuple[object, ...], b: tuple[object, ...]) -> bool:
    return len(a) == len(b) and all(x is y for x, y in zip(a, b, strict=True))
