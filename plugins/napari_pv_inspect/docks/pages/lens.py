"""The lens: distortion fitted, set with a slider or out of a file; profiles of the camera."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from qtpy.QtCore import Qt
from qtpy.QtWidgets import (
    QFileDialog,
    QGroupBox,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from napari_pv_inspect.docks.profile_dialog import ProfileDialog
from napari_pv_inspect.forms.form import SettingsForm
from napari_pv_inspect.live.grid import LiveKappa
from napari_pv_inspect.live.kappa_curve import Curve, KappaCurve
from napari_pv_inspect.models.workbench import WorkbenchModel
from napari_pv_inspect.widgets.kappa_plot import CurveView
from napari_pv_inspect.widgets.listen import listen
from pv_inspect.calibration.camera_file import read_camera, write_camera
from pv_inspect.calibration.camera_profile import read_profile
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.settings import Group, Settings

__all__ = ["LensBox"]

CAMERA_FILES = "Camera (*.yaml *.yml *.json *.xml);;All files (*)"


class LensBox(QGroupBox):
    """Slider for kappa with the residual and its curve, camera files and profiles.

    Parameters
    ----------
    model : WorkbenchModel
    live : LiveKappa
    curve : KappaCurve
    saved_result : callable
        Returns the result folder of what is open; None if it is not saved.
    """

    def __init__(
        self,
        model: WorkbenchModel,
        live: LiveKappa,
        curve: KappaCurve,
        saved_result: Callable[[], Path | None],
        parent: QWidget | None = None,
    ) -> None:
        super().__init__(Group.LENS, parent)
        self._model = model
        self._live = live
        self._saved_result = saved_result
        self.maker: ProfileDialog | None = None
        self.form = SettingsForm(
            model,
            Group.LENS,
            self._stand_ins,
            {"calibration_file": self._on_camera, "camera_profile": self._on_profile},
        )
        self.residual = QLabel("kappa is fitted with the grid.")
        self.residual.setWordWrap(True)
        # The curve below must not jump while a line more comes and goes.
        self.residual.setMinimumHeight(2 * self.fontMetrics().lineSpacing() + 4)
        self.residual.setAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignTop)
        self.curve = CurveView()
        self.save = QPushButton("Save camera...")
        self.save.setToolTip("Write the fitted K [LR px] and kappa as OpenCV reads them.")
        self.make_profile = QPushButton("Make profile...")
        self.make_profile.setToolTip(
            "Pool what results of this camera say of lens, blur and vignetting, and use it."
        )
        buttons = QHBoxLayout()
        buttons.addWidget(self.save)
        buttons.addWidget(self.make_profile)
        layout = QVBoxLayout(self)
        self.form.place_below("kappa", self.residual, self.curve)
        layout.addWidget(self.form)
        layout.addLayout(buttons)
        self.save.clicked.connect(self._on_save)
        self.make_profile.clicked.connect(self.show_maker)
        listen(model.settings_changed, self._on_settings)
        listen(model.inspection_changed, self._on_inspection)
        listen(live.residual_changed, self._on_residual)
        listen(curve.changed, self._on_curve)
        self._on_curve(curve.curve)
        self._on_inspection(model.inspection)

    def load_camera(self, path: Path) -> None:
        """Use the camera of a file from the next run on; what is wrong becomes a notice."""
        try:
            if self._model.sequence is not None:
                read_camera(path, self._model.sequence.shape)
            elif not path.is_file():
                raise InspectionError(f"There is no file {path}: choose a camera file.")
        except InspectionError as error:
            self._model.notice(str(error), is_error=True)
        else:
            # A kappa set by hand would win over that of the file.
            self._model.change_settings(calibration_file=path, kappa=None, focal_length_px=None)

    def save_camera(self, path: Path) -> None:
        """Write the camera of the geometry that is shown; what is wrong becomes a notice."""
        inspection = self._model.inspection
        if inspection is None:
            return
        geometry = inspection.registration or inspection.calibration
        if geometry is None:
            return
        try:
            write_camera(path, geometry.camera, inspection.frames.shape)
        except InspectionError as error:
            self._model.notice(str(error), is_error=True)
        else:
            self._model.notice(f"Camera saved to {path}.")

    def load_profile(self, path: Path) -> None:
        """Use a camera profile from the next run on; what is wrong becomes a notice."""
        sequence = self._model.sequence
        try:
            read_profile(path, None if sequence is None else sequence.shape)
        except InspectionError as error:
            self._model.notice(str(error), is_error=True)
        else:
            self._model.change_settings(camera_profile=path)

    def show_maker(self) -> None:
        """Show the window that makes a profile, with the result that is open."""
        if self.maker is None:
            self.maker = ProfileDialog(self._model, self.load_profile, self)
            self.maker.finished.connect(self._on_maker_closed)
            open_now = self._saved_result()
            if open_now is not None:
                self.maker.add(open_now)
            self.maker.show()
        self.maker.raise_()

    def close_maker(self) -> None:
        """Close that window."""
        if self.maker is not None:
            self.maker.reject()

    def _on_maker_closed(self, _: int) -> None:
        self.maker = None

    def _on_profile(self, path: Path | None) -> None:
        if path is None:
            self._model.change_settings(camera_profile=None)
        else:
            self.load_profile(path)

    def _on_save(self) -> None:
        name = QFileDialog.getSaveFileName(self, "Camera file", "camera.yaml", CAMERA_FILES)[0]
        if name:
            self.save_camera(Path(name))

    def _on_camera(self, path: Path | None) -> None:
        if path is None:
            self._model.change_settings(calibration_file=None)
        else:
            self.load_camera(path)

    def _stand_ins(self) -> dict[str, float | None]:
        return {"kappa": self._live.fitted_kappa}

    def _on_settings(self, settings: Settings) -> None:
        self.curve.mark(settings.kappa if settings.kappa is not None else self._live.fitted_kappa)

    def _on_inspection(self, inspection: Inspection | None) -> None:
        if inspection is None:
            self.residual.setText("kappa is fitted with the grid.")
        self.save.setEnabled(inspection is not None and inspection.calibration is not None)
        self.form.refresh()
        self._on_settings(self._model.settings)

    def _on_residual(self, text: str) -> None:
        self.residual.setText(text)

    def _on_curve(self, curve: Curve | None) -> None:
        self.curve.show_curve(curve)
