"""Settings of the module image: magnification and prior."""

from __future__ import annotations

from qtpy.QtCore import QSignalBlocker
from qtpy.QtWidgets import QCheckBox, QFormLayout, QGroupBox, QWidget

from napari_pv_inspect.docks.listen import listen
from napari_pv_inspect.docks.slider import SettingSlider
from napari_pv_inspect.model import WorkbenchModel
from pv_inspect.settings import Settings

__all__ = ["ImageBox"]

LAMBDA_RANGE = (1e-4, 10.0)


class ImageBox(QGroupBox):
    """Sliders for what the reconstruction is made with."""

    def __init__(self, model: WorkbenchModel, parent: QWidget | None = None) -> None:
        super().__init__("Module image", parent)
        self._model = model
        self.magnification = SettingSlider("magnification", 1.0, 6.0, decimals=2)
        self.prior_weight = SettingSlider("prior_weight", *LAMBDA_RANGE, 4, logarithmic=True)
        self.automatic = QCheckBox("Lambda automatic")
        self.automatic.setToolTip(
            "Choose lambda so that the image predicts pixels best that it has not seen."
        )
        form = QFormLayout(self)
        form.addRow("Magnification", self.magnification)
        form.addRow("Lambda", self.prior_weight)
        form.addRow("", self.automatic)
        self.magnification.changed.connect(self._on_magnification)
        self.prior_weight.changed.connect(self._on_prior_weight)
        self.automatic.toggled.connect(self._on_automatic)
        listen(model.settings_changed, self._on_settings)
        listen(model.inspection_changed, self._on_inspection)
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

    def _on_inspection(self, _: object = None) -> None:
        self._show_prior_weight()

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
