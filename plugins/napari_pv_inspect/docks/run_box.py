"""Magnification, prior, and the run itself."""

from __future__ import annotations

from qtpy.QtCore import QSignalBlocker, Signal
from qtpy.QtWidgets import (
    QCheckBox,
    QFormLayout,
    QGroupBox,
    QHBoxLayout,
    QLabel,
    QProgressBar,
    QPushButton,
    QWidget,
)

from napari_pv_inspect.docks.listen import listen
from napari_pv_inspect.docks.slider import SettingSlider
from napari_pv_inspect.model import RunState, WorkbenchModel
from pv_inspect.settings import Settings, Stage

__all__ = ["RunBox"]

LAMBDA_RANGE = (1e-4, 10.0)
WARNING_COLOUR = "#E69F00"


class RunBox(QGroupBox):
    """Settings of the reconstruction; *Run* and *Cancel* with progress."""

    run_wanted = Signal()
    cancel_wanted = Signal()

    def __init__(self, model: WorkbenchModel, parent: QWidget | None = None) -> None:
        super().__init__("Module image", parent)
        self._model = model
        self.magnification = SettingSlider("magnification", 1.0, 6.0, decimals=2)
        self.prior_weight = SettingSlider("prior_weight", *LAMBDA_RANGE, 4, logarithmic=True)
        self.automatic = QCheckBox("Lambda automatic")
        self.automatic.setToolTip(
            "Choose lambda so that the image predicts pixels best that it has not seen."
        )
        self.run = QPushButton("Run")
        self.run.setToolTip("Do all stages that are not up to date, in the background.")
        self.cancel = QPushButton("Cancel")
        self.cancel.setToolTip("Stop the run at its next step; the last whole result stays.")
        self.progress = QProgressBar()
        self.progress.setRange(0, 1000)
        self.progress.setTextVisible(True)
        self.message = QLabel()
        self.message.setWordWrap(True)
        buttons = QHBoxLayout()
        buttons.addWidget(self.run, 2)
        buttons.addWidget(self.cancel, 1)
        form = QFormLayout(self)
        form.addRow("Magnification", self.magnification)
        form.addRow("Lambda", self.prior_weight)
        form.addRow("", self.automatic)
        form.addRow(buttons)
        form.addRow(self.progress)
        form.addRow(self.message)
        self.magnification.changed.connect(self._on_magnification)
        self.prior_weight.changed.connect(self._on_prior_weight)
        self.automatic.toggled.connect(self._on_automatic)
        self.run.clicked.connect(self.run_wanted)
        self.cancel.clicked.connect(self.cancel_wanted)
        listen(model.settings_changed, self._on_settings)
        listen(model.sequence_changed, self._on_state)
        listen(model.run_changed, self._on_state)
        listen(model.inspection_changed, self._on_inspection)
        listen(model.progress_changed, self._on_progress)
        listen(model.noticed, self._on_notice)
        self._on_settings(model.settings)

    def _on_magnification(self, value: float) -> None:
        self._model.change_settings(magnification=value)

    def _on_prior_weight(self, value: float) -> None:
        self._model.change_settings(prior_weight=value)

    def _on_automatic(self, automatic: bool) -> None:
        weight = None if automatic else self.prior_weight.value
        self._model.change_settings(prior_weight=weight)

    def _on_settings(self, settings: Settings) -> None:
        self.magnification.show_value(settings.magnification)
        self._show_prior_weight()
        self._on_state()

    def _show_prior_weight(self) -> None:
        """Show lambda: the user's, else the one that was found automatically."""
        weight = self._model.settings.prior_weight
        with QSignalBlocker(self.automatic):
            self.automatic.setChecked(weight is None)
        inspection = self._model.inspection
        made = None if inspection is None else inspection.reconstruction
        if weight is None and made is not None:
            weight = made.prior_weight
        if weight is not None:
            self.prior_weight.show_value(weight)

    def _on_inspection(self, _: object = None) -> None:
        self._show_prior_weight()
        self._on_state()

    def _on_state(self, _: object = None) -> None:
        model = self._model
        self.message.setStyleSheet("")
        idle = model.run_state is RunState.IDLE
        known = model.settings.rows is not None and model.settings.cols is not None
        self.run.setEnabled(idle and model.sequence is not None and known)
        self.cancel.setEnabled(model.run_state is RunState.RUNNING)
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
        first = min(model.to_do, key=_position)
        return f"Next run starts at: {first.value}."

    def _on_progress(self, fraction: float, message: str) -> None:
        self.progress.setValue(round(1000 * fraction))
        if self._model.run_state is RunState.RUNNING:
            self.message.setText(message)

    def _on_notice(self, text: str, is_error: bool) -> None:
        self.message.setStyleSheet(f"color: {WARNING_COLOUR}" if is_error else "")
        self.message.setText(text)


def _position(stage: Stage) -> int:
    return stage.index
