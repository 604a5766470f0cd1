"""Which module it is: rows, columns, aspect, and the search for its grid."""

from __future__ import annotations

from qtpy.QtCore import Signal
from qtpy.QtWidgets import QGroupBox, QLabel, QPushButton, QVBoxLayout, QWidget

from napari_pv_inspect.forms.form import SettingsForm
from napari_pv_inspect.models.workbench import RunState, WorkbenchModel
from napari_pv_inspect.widgets.listen import listen
from pv_inspect.detection.layout_guess import LayoutGuess
from pv_inspect.settings import Group, Settings

__all__ = ["ModuleBox"]


class ModuleBox(QGroupBox):
    """Rows, columns and cell aspect; *Detect* finds the grid."""

    detect_wanted = Signal()

    def __init__(self, model: WorkbenchModel, parent: QWidget | None = None) -> None:
        super().__init__(Group.MODULE, parent)
        self._model = model
        self.form = SettingsForm(model, Group.MODULE)
        self.confirm = QLabel()
        self.confirm.setWordWrap(True)
        self.detect = QPushButton("Detect grid")
        self.detect.setToolTip(
            "Find the crossing points in all frames and fit camera and grid; nothing else is run."
        )
        self.form.beside_numbers(self.detect)
        layout = QVBoxLayout(self)
        layout.addWidget(self.form)
        layout.addWidget(self.confirm)
        self.detect.clicked.connect(self.detect_wanted)
        listen(model.settings_changed, self._on_settings)
        listen(model.sequence_changed, self._on_state)
        listen(model.run_changed, self._on_state)
        self._on_settings(model.settings)

    def _on_settings(self, _: Settings) -> None:
        guess = self._model.guess if self._model.layout_is_guessed else None
        self.confirm.setText("" if guess is None else _to_confirm(guess))
        self.confirm.setVisible(guess is not None)
        self._on_state()

    def _on_state(self, _: object = None) -> None:
        ready = self._model.sequence is not None and self._model.run_state is RunState.IDLE
        known = self._model.settings.rows is not None and self._model.settings.cols is not None
        self.detect.setEnabled(ready and known)


def _to_confirm(guess: LayoutGuess) -> str:
    other = guess.runner_up
    if other is None:
        return "Guessed from the frames: please confirm."
    return (
        f"Guessed from the frames, which fit {other.rows} x {other.cols} cells of aspect "
        f"{other.cell_aspect:g} nearly as well: please confirm."
    )
