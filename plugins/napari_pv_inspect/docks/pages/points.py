"""Tools for the crossing points: what the looks mean, drag, add, delete, and how it stands."""

from __future__ import annotations

from qtpy.QtWidgets import (
    QGroupBox,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from napari_pv_inspect import appearance as look
from napari_pv_inspect.models.workbench import RunState
from napari_pv_inspect.widgets.listen import listen
from napari_pv_inspect.widgets.shortcuts import Key
from napari_pv_inspect.workbench import Workbench

__all__ = ["PointsBox"]

GROUP = "Crossing points"
LEGEND = "&nbsp; ".join(
    f'<span style="color:{colour}"><b>{sign}</b></span> {name}'
    for sign, name, colour in (
        ("\u25cb", "measured", look.MEASURED_COLOUR),
        ("\u2715", "predicted", look.PREDICTED_COLOUR),
        ("\u25c7", "edited", look.EDITED_COLOUR),
    )
)


class PointsBox(QGroupBox):
    """Legend and tools of the points layer."""

    def __init__(self, workbench: Workbench, parent: QWidget | None = None) -> None:
        super().__init__("Crossing points", parent)
        self._workbench = workbench
        self.legend = QLabel(LEGEND)
        self.legend.setToolTip(
            "Measured: from visible gaps, used by the fit. Predicted: where the fit expects the "
            "crossing, not used. Edited: set by you, used by the fit however far off it is."
        )
        self.select = self._tool("Select / drag", "Click or draw a box, then drag", "F6")
        self.add = self._tool("Add", "Click where a crossing lies; the nearest one is set", "F7")
        self.delete = QPushButton("Delete")
        self.delete.setToolTip(
            "Delete the selected points of this frame: the fit predicts them (F8)."
        )
        row = QHBoxLayout()
        for button in (self.select, self.add, self.delete):
            row.addWidget(button)
        self.state = QLabel()
        self.state.setWordWrap(True)
        layout = QVBoxLayout(self)
        layout.addWidget(self.legend)
        layout.addLayout(row)
        layout.addWidget(self.state)
        self.select.clicked.connect(self._on_select)
        self.add.clicked.connect(self._on_add)
        self.delete.clicked.connect(self._on_delete)
        if workbench.shortcuts is not None:
            for key, text, button in (
                ("F6", "Select and drag points, or move the view again", self.select),
                ("F7", "Add points, or move the view again", self.add),
                ("F8", "Delete the selected points", self.delete),
            ):
                workbench.shortcuts.add(Key(key, text, GROUP), button.click)
        listen(workbench.points.mode_changed, self._on_mode)
        listen(workbench.editor.changed, self._on_state)
        listen(workbench.model.changed, self._on_state)
        listen(workbench.live.residual_changed, self._on_state)
        self._on_state()

    def _tool(self, text: str, tip: str, key: str) -> QPushButton:
        button = QPushButton(text)
        button.setCheckable(True)
        button.setToolTip(f"{tip} ({key}). Again: move the view.")
        return button

    def _on_select(self, on: bool) -> None:
        self._workbench.points.use("select" if on else "pan_zoom")

    def _on_add(self, on: bool) -> None:
        self._workbench.points.use("add" if on else "pan_zoom")

    def _on_delete(self) -> None:
        self._workbench.points.delete_selected()

    def _on_mode(self, mode: str) -> None:
        self.select.setChecked(mode == "select")
        self.add.setChecked(mode == "add")

    def _on_state(self, _: object = None) -> None:
        workbench = self._workbench
        crossings, frame = workbench.editor.crossings, workbench.frames.frame
        idle = workbench.model.run_state is RunState.IDLE
        ready = crossings is not None and idle
        for button in (self.select, self.add, self.delete):
            button.setEnabled(ready)
        if crossings is None or frame >= len(crossings.frames):
            self.state.setText("No crossing points yet: detect the grid.")
            return
        points = crossings.frames[frame]
        text = f"{int(points.measured.sum())} of {len(points.measured)} measured"
        edited = workbench.editor.edits.count(frame)
        text += f", {edited} edited" if edited else ""
        fit, dragged = workbench.editor.calibration, workbench.live.dragged_rms_px
        if dragged is not None:
            text += f"; {dragged:.2f} px from the grid here"
        elif fit is not None and fit.used[frame]:
            text += f"; {fit.rms_px[frame]:.2f} px from the grid"
        elif fit is not None:
            text += f"; rejected: {fit.why[frame].rstrip('.')}"
        self.state.setText(f"{text}.")
