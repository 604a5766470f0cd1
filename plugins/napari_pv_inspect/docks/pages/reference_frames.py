"""How frames are read: dark frame and flat frame of the camera, and which series of a file."""

from __future__ import annotations

from pathlib import Path

from qtpy.QtWidgets import (
    QFileDialog,
    QFormLayout,
    QGroupBox,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QPushButton,
    QSizePolicy,
    QWidget,
)

from napari_pv_inspect.models.workbench import WorkbenchModel
from napari_pv_inspect.widgets.listen import listen
from napari_pv_inspect.widgets.slider import setting_tooltip
from pv_inspect.image_files.endings import PATTERNS
from pv_inspect.settings import Settings

__all__ = ["ReferenceBox"]

NONE = "none"
IMAGES = f"Images ({PATTERNS})"


class ReferenceBox(QGroupBox):
    """Chooses dark and flat frame, the sequence is then read again; and the series to open."""

    def __init__(self, model: WorkbenchModel, parent: QWidget | None = None) -> None:
        super().__init__("Camera", parent)
        self._model = model
        self.names: dict[str, QLabel] = {}
        self.clear: dict[str, QPushButton] = {}
        form = QFormLayout(self)
        for setting, title in (("dark_frame", "Dark frame"), ("flat_frame", "Flat frame")):
            form.addRow(title, self._row(setting))
        self.series = QLineEdit()
        self.series.setPlaceholderText("the only one")
        self.series.setToolTip(f"{setting_tooltip('series')} Counts for what is opened next.")
        self.series.editingFinished.connect(self._on_series)
        form.addRow("Series", self.series)
        listen(model.settings_changed, self._on_settings)
        self._on_settings(model.settings)

    def _row(self, setting: str) -> QHBoxLayout:
        name = self.names[setting] = QLabel(NONE)
        name.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        choose, clear = QPushButton("..."), QPushButton("x")
        choose.setToolTip(f"Choose: {setting_tooltip(setting)} The frames are then read again.")
        clear.setToolTip("Use none; the frames are then read again.")
        choose.setObjectName(setting)
        clear.setObjectName(setting)
        for button in (choose, clear):
            button.setFixedWidth(30)
        choose.clicked.connect(self._on_choose)
        clear.clicked.connect(self._on_clear)
        self.clear[setting] = clear
        row = QHBoxLayout()
        row.addWidget(name, 1)
        row.addWidget(choose)
        row.addWidget(clear)
        return row

    def _on_choose(self) -> None:
        setting = self.sender().objectName()
        path = QFileDialog.getOpenFileName(self, setting.replace("_", " "), "", IMAGES)[0]
        if path:
            self._model.change_settings(**{setting: Path(path)})

    def _on_series(self) -> None:
        series = self.series.text().strip() or None
        if series != self._model.settings.series:
            self._model.change_settings(series=series)

    def _on_clear(self) -> None:
        self._model.change_settings(**{self.sender().objectName(): None})

    def _on_settings(self, settings: Settings) -> None:
        self.series.setText(settings.series or "")
        for setting, label in self.names.items():
            path = getattr(settings, setting)
            label.setText(NONE if path is None else path.name)
            label.setToolTip(NONE if path is None else str(path))
            self.clear[setting].setEnabled(path is not None)
