"""Which module it is: rows, columns, aspect, and the search for its grid."""

from __future__ import annotations

from qtpy.QtCore import QSignalBlocker, Signal
from qtpy.QtWidgets import (
    QAbstractSpinBox,
    QDoubleSpinBox,
    QGridLayout,
    QGroupBox,
    QLabel,
    QPushButton,
    QSpinBox,
    QWidget,
)

from napari_pv_inspect.models.workbench import RunState, WorkbenchModel
from napari_pv_inspect.widgets.listen import listen
from napari_pv_inspect.widgets.slider import setting_tooltip
from pv_inspect.settings import Settings

__all__ = ["ModuleBox"]

UNKNOWN = "?"


class ModuleBox(QGroupBox):
    """Rows, columns and cell aspect; *Detect* finds the grid."""

    detect_wanted = Signal()

    def __init__(self, model: WorkbenchModel, parent: QWidget | None = None) -> None:
        super().__init__("Module", parent)
        self._model = model
        self.rows = self._count("rows")
        self.cols = self._count("cols")
        self.aspect = QDoubleSpinBox()
        self.aspect.setRange(0.0, 10.0)
        self.aspect.setDecimals(3)
        self.aspect.setSingleStep(0.1)
        self.aspect.setSpecialValueText("auto")
        self.aspect.setKeyboardTracking(False)
        self.aspect.setToolTip(setting_tooltip("cell_aspect"))
        self.confirm = QLabel("Guessed from the frames: please confirm.")
        self.confirm.setWordWrap(True)
        self.detect = QPushButton("Detect grid")
        self.detect.setToolTip(
            "Find the crossing points in all frames and fit camera and grid; nothing else is run."
        )
        grid = QGridLayout(self)
        for column, (title, field) in enumerate(
            (("Rows", self.rows), ("Columns", self.cols), ("Aspect", self.aspect))
        ):
            # The arrow keys step it; buttons would take the room of the figures.
            field.setButtonSymbols(QAbstractSpinBox.ButtonSymbols.NoButtons)
            field.setMinimumWidth(52)
            field.setAccessibleName(title)
            label = QLabel(title)
            label.setBuddy(field)
            label.setToolTip(field.toolTip())
            grid.addWidget(label, 0, column)
            grid.addWidget(field, 1, column)
        grid.addWidget(self.detect, 1, 3)
        grid.addWidget(self.confirm, 2, 0, 1, 4)
        self.rows.valueChanged.connect(self._on_rows)
        self.cols.valueChanged.connect(self._on_cols)
        self.aspect.valueChanged.connect(self._on_aspect)
        self.detect.clicked.connect(self.detect_wanted)
        listen(model.settings_changed, self._on_settings)
        listen(model.sequence_changed, self._on_state)
        listen(model.run_changed, self._on_state)
        self._on_settings(model.settings)

    def _count(self, name: str) -> QSpinBox:
        box = QSpinBox()
        box.setRange(0, 200)
        box.setSpecialValueText(UNKNOWN)
        box.setKeyboardTracking(False)
        box.setToolTip(setting_tooltip(name))
        return box

    def _on_rows(self, value: int) -> None:
        self._model.change_settings(rows=value or None)

    def _on_cols(self, value: int) -> None:
        self._model.change_settings(cols=value or None)

    def _on_aspect(self, value: float) -> None:
        self._model.change_settings(cell_aspect=value if value >= 0.1 else None)

    def _on_settings(self, settings: Settings) -> None:
        with QSignalBlocker(self.rows), QSignalBlocker(self.cols), QSignalBlocker(self.aspect):
            self.rows.setValue(settings.rows or 0)
            self.cols.setValue(settings.cols or 0)
            self.aspect.setValue(settings.cell_aspect or 0.0)
        self.confirm.setVisible(self._model.layout_is_guessed)
        self._on_state()

    def _on_state(self, _: object = None) -> None:
        ready = self._model.sequence is not None and self._model.run_state is RunState.IDLE
        known = self._model.settings.rows is not None and self._model.settings.cols is not None
        self.detect.setEnabled(ready and known)
