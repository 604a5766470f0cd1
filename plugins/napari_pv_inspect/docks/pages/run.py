"""The run: start, cancel, how far it is."""

from __future__ import annotations

from time import monotonic

from qtpy.QtCore import Qt, Signal
from qtpy.QtWidgets import QHBoxLayout, QLabel, QProgressBar, QPushButton, QVBoxLayout, QWidget

from napari_pv_inspect.appearance import WARNING_COLOUR
from napari_pv_inspect.models.remaining_time import remaining_text
from napari_pv_inspect.models.workbench import RunState, WorkbenchModel
from napari_pv_inspect.models.workflow import StepAction, next_step
from napari_pv_inspect.widgets.listen import listen
from napari_pv_inspect.widgets.style import set_primary
from pv_inspect.settings import Stage

__all__ = ["RunBox"]

RUN_ALL = "Run all"
ALL_TIP = "Do everything from the grid to the crack map, in the background."
RUN_TIP = (
    "While a run goes on: with changed settings the new run ends it and takes its place; after "
    "Detect it follows."
)
IN_DOUBT = "In doubt: do not rely on this result; the reason stands below."
BEFORE = (StepAction.CONFIRM, StepAction.DETECT)
"""Steps at which a run of all stages is offered as well."""


class RunBox(QWidget):
    """How far the run is, and *Cancel*; *Run* is placed by whoever makes the box.

    *Run* is called what the next run does when that is the next step, and then stands out.
    """

    run_wanted = Signal()
    cancel_wanted = Signal()

    def __init__(self, model: WorkbenchModel, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._model = model
        self.run = QPushButton(RUN_ALL)
        self._begun_s: float | None = None
        self.cancel = QPushButton("Cancel")
        self.cancel.setToolTip("Stop the run at its next step; a whole result from before stays.")
        self.progress = QProgressBar()
        self.progress.setRange(0, 1000)
        self.progress.setTextVisible(True)
        self.progress.setToolTip("How much of the run is done, all stages together. Unit: %.")
        self.message = QLabel()
        self.message.setWordWrap(True)
        # One line more or less must not move the page below.
        self.message.setMinimumHeight(2 * self.fontMetrics().lineSpacing() + 4)
        self.message.setAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignTop)
        bar = QHBoxLayout()
        bar.addWidget(self.progress, 1)
        bar.addWidget(self.cancel)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(3)
        layout.addLayout(bar)
        layout.addWidget(self.message)
        self.run.clicked.connect(self.run_wanted)
        self.cancel.clicked.connect(self.cancel_wanted)
        listen(model.changed, self._on_state)
        listen(model.progress_changed, self._on_progress)
        listen(model.noticed, self._on_notice)
        self._on_state()

    def _on_state(self) -> None:
        model = self._model
        self._colour("")
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
        self._name_run()
        for widget in (self.progress, self.cancel):
            widget.setVisible(not idle)
        if model.run_state is RunState.STOPPING:
            self.message.setText("Stopping at the next step ...")
        elif idle:
            self.progress.setValue(1000 if model.inspection is not None and not model.to_do else 0)
            self.message.setText(self._advice())
            self._colour(WARNING_COLOUR if model.doubts or model.why_hidden else "")

    def _name_run(self) -> None:
        step, idle = next_step(self._model), self._model.run_state is RunState.IDLE
        comes_next = step.action is StepAction.RUN
        self.run.setText(step.text if comes_next else RUN_ALL)
        self.run.setToolTip(f"{step.tip} {RUN_TIP}" if comes_next else f"{ALL_TIP} {RUN_TIP}")
        self.run.setVisible(comes_next or (idle and self.run.isEnabled() and step.action in BEFORE))
        set_primary(self.run, comes_next)

    def _advice(self) -> str:
        model = self._model
        if model.why_hidden:
            return model.why_hidden
        if model.sequence is None:
            if model.result is not None:
                return IN_DOUBT if model.doubts else model.frames_gone
            return "Open a folder of frames, a file that holds several, or the sample."
        if model.settings.rows is None or model.settings.cols is None:
            return "How many rows and columns of cells does the module have?"
        if not model.to_do:
            return IN_DOUBT if model.doubts else "Up to date."
        first = min(model.to_do - {Stage.LOAD})
        return f"Next run starts at: {first.value}."

    def _on_progress(self, fraction: float, message: str) -> None:
        self.progress.setValue(round(1000 * fraction))
        if self._model.run_state is RunState.RUNNING and self._begun_s is not None:
            left = remaining_text(fraction, monotonic() - self._begun_s)
            self.message.setText(f"{message}, {left}" if left else message)

    def _colour(self, colour: str) -> None:
        self.message.setStyleSheet(f"color: {colour}" if colour else "")

    def _on_notice(self, text: str, is_error: bool) -> None:
        self._colour(WARNING_COLOUR if is_error else "")
        self.message.setText(text)
