"""Settings of the module image: magnification, prior, blur; and presets of them."""

from __future__ import annotations

from qtpy.QtCore import Signal
from qtpy.QtWidgets import QGroupBox, QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from napari_pv_inspect.docks.preset_menu import PresetMenu
from napari_pv_inspect.forms.form import SettingsForm
from napari_pv_inspect.live.cell import LiveCell
from napari_pv_inspect.models.workbench import WorkbenchModel
from napari_pv_inspect.widgets.lambda_plot import LambdaPlot
from napari_pv_inspect.widgets.listen import listen
from pv_inspect.reconstruction.in_use import values_in_use
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.settings import Group, Settings

__all__ = ["ImageBox"]

NEEDS_A_RUN = "Run once: the curve comes with the module image."


class ImageBox(QGroupBox):
    """What the reconstruction is made with; the live cell follows."""

    live_wanted = Signal()

    def __init__(
        self, model: WorkbenchModel, live: LiveCell, parent: QWidget | None = None
    ) -> None:
        super().__init__(Group.IMAGE, parent)
        self._model = model
        self._live = live
        self.show_live = QPushButton("Live cell")
        self.show_live.setToolTip("Show the selected cell large while the sliders move.")
        self.presets = PresetMenu(model, live.tuning)
        self.form = SettingsForm(model, Group.IMAGE, self._stand_ins)
        self.plot = LambdaPlot()
        layout = QVBoxLayout(self)
        buttons = QHBoxLayout()
        buttons.addWidget(self.show_live, 1)
        buttons.addWidget(self.presets, 1)
        layout.addLayout(buttons)
        layout.addWidget(self.form)
        layout.addWidget(QLabel("Held-out residual over lambda"))
        layout.addWidget(self.plot)
        self.plot.chosen.connect(self._on_chosen)
        self.show_live.clicked.connect(self.live_wanted)
        listen(model.settings_changed, self._on_settings)
        listen(model.inspection_changed, self._on_inspection)
        listen(model.result_opened, self._on_inspection)
        self._on_inspection()

    def _stand_ins(self) -> dict[str, float | None]:
        """Return what counts until the next run for what is found automatically."""
        used = values_in_use(self._model.settings, made=self._made)
        return {"prior_weight": used.prior_weight, "psf_sigma_lr_px": used.psf_sigma_lr_px}

    def _on_chosen(self, weight: float) -> None:
        low, high = Settings.slider_of("prior_weight")
        self._model.change_settings(prior_weight=min(max(weight, low), high))
        self._live.commit()

    def _on_settings(self, settings: Settings) -> None:
        self.plot.show_present(values_in_use(settings, made=self._made).prior_weight)
        self._show_curve(settings)

    def _on_inspection(self, _: object = None) -> None:
        self.form.refresh()
        self._on_settings(self._model.settings)

    def _show_curve(self, settings: Settings) -> None:
        inspection, made = self._model.inspection, self._made
        if inspection is None or made is None:
            self.plot.show_curve((), None, self._model.frames_gone or NEEDS_A_RUN)
        elif inspection.settings.prior != settings.prior:
            self.plot.show_curve((), None, "Run again for the curve of this prior.")
        elif not made.lambda_curve and inspection.settings.prior_weight is None:
            self.plot.show_curve((), None, "The frames of the last run don't determine lambda.")
        elif not made.lambda_curve:
            self.plot.show_curve((), None, "The last run was given lambda: there is no curve.")
        else:
            self.plot.show_curve(made.lambda_curve, made.prior_weight)

    @property
    def _made(self) -> Reconstruction | None:
        inspection = self._model.inspection
        return None if inspection is None else inspection.reconstruction
