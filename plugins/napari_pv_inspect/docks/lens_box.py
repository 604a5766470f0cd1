"""Distortion of the lens: fitted, or set by hand while the grid bends."""

from __future__ import annotations

from qtpy.QtWidgets import QGroupBox, QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from napari_pv_inspect.docks.listen import listen
from napari_pv_inspect.docks.slider import SettingSlider
from napari_pv_inspect.live import LiveKappa
from napari_pv_inspect.model import WorkbenchModel
from pv_inspect.pipeline import Inspection
from pv_inspect.settings import Settings

__all__ = ["LensBox"]

KAPPA_RANGE = 0.6


class LensBox(QGroupBox):
    """Slider for kappa, the residual of the shown frame, and *Fit*, which brings the fit back."""

    def __init__(
        self, model: WorkbenchModel, live: LiveKappa, parent: QWidget | None = None
    ) -> None:
        super().__init__("Lens", parent)
        self._model = model
        self._live = live
        self.kappa = SettingSlider("kappa", -KAPPA_RANGE, KAPPA_RANGE, decimals=4)
        self.fit = QPushButton("Fit")
        self.fit.setToolTip("Let the fit choose kappa, and show the fitted grid again.")
        self.residual = QLabel("kappa is fitted with the grid.")
        self.residual.setWordWrap(True)
        row = QHBoxLayout()
        row.addWidget(QLabel("Kappa"))
        row.addWidget(self.kappa, 1)
        row.addWidget(self.fit)
        layout = QVBoxLayout(self)
        layout.addLayout(row)
        layout.addWidget(self.residual)
        self.kappa.changed.connect(self._on_slider)
        self.fit.clicked.connect(self._on_fit)
        listen(model.settings_changed, self._on_settings)
        listen(model.inspection_changed, self._on_inspection)
        listen(live.residual_changed, self._on_residual)
        self._on_settings(model.settings)

    def _on_slider(self, value: float) -> None:
        self._model.change_settings(kappa=value)

    def _on_fit(self) -> None:
        self._model.change_settings(kappa=None)

    def _on_settings(self, settings: Settings) -> None:
        fitted = self._live.fitted_kappa
        self.kappa.show_value(settings.kappa if settings.kappa is not None else fitted or 0.0)
        self.fit.setEnabled(settings.kappa is not None)

    def _on_inspection(self, inspection: Inspection | None) -> None:
        if inspection is None:
            self.residual.setText("kappa is fitted with the grid.")
        self._on_settings(self._model.settings)

    def _on_residual(self, text: str) -> None:
        self.residual.setText(text)
