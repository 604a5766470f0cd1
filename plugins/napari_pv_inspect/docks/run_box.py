"""The run: start, cancel, how far it is."""

from __future__ import annotations

from time import monotonic

from qtpy.QtCore import Signal
from qtpy.QtWidgets import QHBoxLayout, QLabel, QProgressBar, QPushButton, QVBoxLayout, QWidget

from napari_pv_inspect.docks.listen import listen
from napari_pv_inspect.model import RunState, WorkbenchModel
from napari_pv_inspect.remaining import remaining_text
from pv_inspect.settings import Stage

__all__ = ["RunBox"]

WARNING_COLOUR = "#E69F00"


class RunBox(QWidget):
    """*Run* and *Cancel* with progress, and what the next run will do."""

    run_wanted = Signal()
    cancel_wanted = Signal()

    def __init__(self, model: WorkbenchModel, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._model = model
        self.run = QPushButton("Run")
        self.run.setToolTip(
            "Do all stages that are not up to date, in the background. While a run goes on: with "
            "changed settings the new run ends it and takes its place; after Detect it follows."
        )
        self._begun_s: float | None = None
        self.cancel = QPushButton("Cancel")
        self.cancel.setToolTip("Stop the run at its next step; a whole result from before stays.")
        self.progress = QProgressBar()
        self.progress.setRange(0, 1000)
        self.progress.setTextVisible(True)
        self.message = QLabel()
        self.message.setWordWrap(True)
        buttons = QHBoxLayout()
        buttons.addWidget(self.run, 2)
        buttons.addWidget(self.cancel, 1)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addLayout(buttons)
        layout.addWidget(self.progress)
        layout.addWidget(self.message)
        self.run.clicked.connect(self.run_wanted)
        self.cancel.clicked.connect(self.cancel_wanted)
        listen(model.settings_changed, self._on_state)
        listen(model.sequence_changed, self._on_state)
        listen(model.run_changed, self._on_state)
        listen(model.inspection_changed, self._on_state)
        listen(model.progress_changed, self._on_progress)
        listen(model.noticed, self._on_notice)
        self._on_state()

    def _on_state(self, _: object = None) -> None:
        model = self._model
        self.message.setStyleSheet("")
        idle = model.run_state is RunState.IDLE
        known = model.settings.rows is not None and model.settings.cols is not None
        running = model.run_state is RunState.RUNNING
        another = not running or model.run_is_outdated or model.run_until is not None
        self.run.setEnabled(another and model.sequence is not None and known)
        if idle:
            self._begun_s = None
        elif self._begun_s is None:
            self._begun_s = monotonic()
        self.cancel.setEnabled(running)
        if model.run_state is RunState.STOPPING:
            self.message.setText("Stopping at the next step ...")
        elif idle:
            self.progress.setValue(1000 if model.inspection is not None and not model.to_do else 0)
            self.message.setText(self._advice())

    def _advice(self) -> str:
        model = self._model
        if model.sequence is None:
            return "Open a folder of frames, a TIFF stack, or the sample."
        if model.settings.rows is None or model.settings.cols is None:
            return "How many rows and columns of cells does the module have?"
        if not model.to_do:
            return "Up to date."
        first = min(model.to_do - {Stage.LOAD}, key=_position)
        return f"Next run starts at: {first.value}."

    def _on_progress(self, fraction: float, message: str) -> None:
        self.progress.setValue(round(1000 * fraction))
        if self._model.run_state is RunState.RUNNING and self._begun_s is not None:
            left = remaining_text(fraction, monotonic() - self._begun_s)
            self.message.setText(f"{message}, {left}" if left else message)

    def _on_notice(self, text: str, is_error: bool) -> None:
        self.message.setStyleSheet(f"color: {WARNING_COLOUR}" if is_error else "")
        self.message.setText(text)


def _position(stage: Stage) -> int:
    return stage.index
