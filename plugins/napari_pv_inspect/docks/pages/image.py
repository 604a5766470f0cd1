"""Settings of the module image: magnification, prior, blur; and presets of them."""

from __future__ import annotations

from qtpy.QtCore import QSignalBlocker, Qt, Signal
from qtpy.QtWidgets import (
    QCheckBox,
    QComboBox,
    QGroupBox,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from napari_pv_inspect.docks.preset_menu import PresetMenu
from napari_pv_inspect.live.cell import LiveCell
from napari_pv_inspect.live.cell_renderer import lambda_in_use
from napari_pv_inspect.models.workbench import WorkbenchModel
from napari_pv_inspect.widgets.lambda_plot import LambdaPlot
from napari_pv_inspect.widgets.listen import listen
from napari_pv_inspect.widgets.slider import SettingSlider, setting_tooltip
from pv_inspect.reconstruction.reconstruct import TYPICAL_SIGMA_LR_PX
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.settings import Settings

__all__ = ["ImageBox"]

NEEDS_A_RUN = "Run once: the curve comes with the module image."
PRIORS = {
    "sparse_curvature": (
        "Sharp edges",
        "Flattens noise and keeps cracks sharp; an edge once found is smoothed less "
        "(sparse curvature).",
    ),
    "btv": (
        "Sharp, plain",
        "The same without weights: fine lines lose more contrast (BTV).",
    ),
    "tikhonov": (
        "Smooth",
        "Squared differences: no surprises, but edges are rounded and noise stays (Tikhonov).",
    ),
}


class ImageBox(QGroupBox):
    """What the reconstruction is made with; the live cell follows."""

    live_wanted = Signal()

    def __init__(
        self, model: WorkbenchModel, live: LiveCell, parent: QWidget | None = None
    ) -> None:
        super().__init__("Module image", parent)
        self._model = model
        self._live = live
        self.magnification = SettingSlider("magnification", "Magnification", decimals=2)
        self.prior_weight = SettingSlider("prior_weight", "Lambda", 4, logarithmic=True)
        self.automatic = QCheckBox("automatic")
        self.automatic.setToolTip(
            "Choose lambda so that the image predicts pixels best that it has not seen."
        )
        self.psf_sigma = SettingSlider("psf_sigma_lr_px", "PSF sigma, LR px", 2, logarithmic=True)
        self.estimated = QCheckBox("estimated")
        self.estimated.setToolTip(
            "Estimate the blur of the lens from the frames. Unit of the slider: LR px."
        )
        self.prior = QComboBox()
        self.prior.setToolTip(setting_tooltip("prior"))
        self.prior.setSizeAdjustPolicy(
            QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon
        )
        self.prior.setMinimumContentsLength(12)
        for k, (name, (text, tip)) in enumerate(PRIORS.items()):
            self.prior.addItem(text, name)
            self.prior.setItemData(k, tip, Qt.ItemDataRole.ToolTipRole)
        self.motion = QCheckBox("Undo motion blur")
        self.motion.setToolTip(setting_tooltip("motion_blur"))
        self.plot = LambdaPlot()
        self.show_live = QPushButton("Live cell")
        self.show_live.setToolTip("Show the selected cell large while the sliders move.")
        self.presets = PresetMenu(model, live.tuning)
        self._arrange()
        self.magnification.changed.connect(self._on_magnification)
        self.prior_weight.changed.connect(self._on_prior_weight)
        self.automatic.toggled.connect(self._on_automatic)
        self.psf_sigma.changed.connect(self._on_psf_sigma)
        self.estimated.toggled.connect(self._on_estimated)
        self.prior.activated.connect(self._on_prior)
        self.motion.toggled.connect(self._on_motion)
        self.plot.chosen.connect(self._on_chosen)
        self.show_live.clicked.connect(self.live_wanted)
        listen(model.settings_changed, self._on_settings)
        listen(model.inspection_changed, self._on_inspection)
        listen(model.result_opened, self._on_inspection)
        self._on_inspection()

    def _arrange(self) -> None:
        self.prior_weight.add_to_header(self.automatic)
        self.psf_sigma.add_to_header(self.estimated)
        prior = QHBoxLayout()
        label = QLabel("Prior")
        label.setBuddy(self.prior)
        self.prior.setAccessibleName("Prior")
        prior.addWidget(label)
        prior.addWidget(self.prior, 1)
        layout = QVBoxLayout(self)
        layout.addWidget(self.show_live)
        for slider in (self.magnification, self.prior_weight, self.psf_sigma):
            layout.addWidget(slider)
        layout.addLayout(prior)
        layout.addWidget(self.motion)
        layout.addWidget(QLabel("Held-out residual over lambda"))
        layout.addWidget(self.plot)
        layout.addWidget(self.presets)

    def _on_magnification(self, value: float) -> None:
        self._model.change_settings(magnification=value)

    def _on_prior_weight(self, value: float) -> None:
        self._model.change_settings(prior_weight=value)

    def _on_automatic(self, automatic: bool) -> None:
        weight = None if automatic else self.prior_weight.value
        self._model.change_settings(prior_weight=weight)

    def _on_psf_sigma(self, value: float) -> None:
        self._model.change_settings(psf_sigma_lr_px=value)

    def _on_estimated(self, estimated: bool) -> None:
        sigma = None if estimated else self.psf_sigma.value
        self._model.change_settings(psf_sigma_lr_px=sigma)

    def _on_prior(self, index: int) -> None:
        self._model.change_settings(prior=self.prior.itemData(index))

    def _on_motion(self, undone: bool) -> None:
        self._model.change_settings(motion_blur="auto" if undone else "none")

    def _on_chosen(self, weight: float) -> None:
        low, high = Settings.slider_of("prior_weight")
        self._model.change_settings(prior_weight=min(max(weight, low), high))
        self._live.settle()

    def _on_settings(self, settings: Settings) -> None:
        self.magnification.show_value(settings.magnification)
        made = self._made
        sigma = settings.psf_sigma_lr_px
        weight = lambda_in_use(self._model.inspection, settings)
        for box, checked in (
            (self.automatic, settings.prior_weight is None),
            (self.estimated, sigma is None),
            (self.motion, settings.motion_blur == "auto"),
        ):
            with QSignalBlocker(box):
                box.setChecked(checked)
        if weight is not None:
            self.prior_weight.show_value(weight)
        if sigma is None:
            sigma = TYPICAL_SIGMA_LR_PX if made is None else made.psf_sigma_lr_px
        self.psf_sigma.show_value(sigma)
        with QSignalBlocker(self.prior):
            self.prior.setCurrentIndex(self.prior.findData(settings.prior))
        self.plot.show_present(weight)
        self._show_curve(settings)

    def _on_inspection(self, _: object = None) -> None:
        self._on_settings(self._model.settings)

    def _show_curve(self, settings: Settings) -> None:
        inspection, made = self._model.inspection, self._made
        if inspection is None or made is None:
            self.plot.show_curve((), None, self._model.frames_gone or NEEDS_A_RUN)
        elif inspection.settings.prior != settings.prior:
            self.plot.show_curve((), None, "Run again for the curve of this prior.")
        elif not made.lambda_curve:
            self.plot.show_curve((), None, "The last run was given lambda: there is no curve.")
        else:
            self.plot.show_curve(made.lambda_curve, made.prior_weight)

    @property
    def _made(self) -> Reconstruction | None:
        inspection = self._model.inspection
        return None if inspection is None else inspection.reconstruction
