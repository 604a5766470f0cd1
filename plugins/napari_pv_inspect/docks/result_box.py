"""What came out, where to look, and *Save*."""

from __future__ import annotations

from qtpy.QtCore import Signal
from qtpy.QtWidgets import QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from napari_pv_inspect.docks.elided import ElidedLabel
from napari_pv_inspect.docks.listen import listen
from napari_pv_inspect.docks.run_box import WARNING_COLOUR
from napari_pv_inspect.model import WorkbenchModel
from napari_pv_inspect.navigation import Navigator
from pv_inspect.pipeline import Inspection

__all__ = ["ResultBox", "summary_text"]


class ResultBox(QWidget):
    """Numbers of the shown inspection, views of it, and the way to disk."""

    save_wanted = Signal()

    def __init__(
        self, model: WorkbenchModel, navigator: Navigator, parent: QWidget | None = None
    ) -> None:
        super().__init__(parent)
        self._model = model
        self.summary = QLabel()
        self.summary.setWordWrap(True)
        self.warning = ElidedLabel()
        self.warning.setStyleSheet(f"color: {WARNING_COLOUR}")
        self.save = QPushButton("Save result...")
        self.save.setToolTip("Write module image, cells, crack map and report into a folder.")
        row = QHBoxLayout()
        row.setSpacing(3)
        for text, tip, slot in (
            ("Frames", "Fill the canvas with the frames.", navigator.to_frames),
            ("Module", "Fill the canvas with the module image.", navigator.to_module),
            (
                "Both",
                "Frames and module image side by side; deleted layers come back.",
                navigator.to_all,
            ),
        ):
            button = QPushButton(text)
            button.setToolTip(tip)
            button.clicked.connect(slot)
            row.addWidget(button)
        row.addSpacing(9)
        row.addWidget(self.save, 1)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(3)
        layout.addWidget(self.summary)
        layout.addWidget(self.warning)
        layout.addLayout(row)
        self.save.clicked.connect(self.save_wanted)
        listen(model.inspection_changed, self._on_change)
        listen(model.run_changed, self._on_change)
        self._on_change()

    def _on_change(self, _: object = None) -> None:
        inspection = self._model.inspection
        self.summary.setText(summary_text(inspection))
        self.summary.setToolTip(details_text(inspection))
        warnings = () if inspection is None else inspection.warnings
        more = f" (+ {len(warnings) - 1})" if len(warnings) > 1 else ""
        self.warning.setText(warnings[0] + more if warnings else "")
        self.warning.setToolTip("\n".join(warnings))
        self.warning.setVisible(bool(warnings))
        self.save.setEnabled(inspection is not None and inspection.complete)


def summary_text(inspection: Inspection | None) -> str:
    """Return the numbers of an inspection in two lines."""
    if inspection is None or inspection.calibration is None:
        return "No result yet."
    fit = inspection.registration or inspection.calibration
    text = f"{int(fit.used.sum())} of {len(fit.used)} frames, kappa {fit.camera.kappa:+.4f}"
    if (made := inspection.reconstruction) is not None:
        text += f", {made.grid.magnification:.2f}x"
    if inspection.cracks is not None:
        cells = inspection.cracks.cells
        cracked = sum(cell.crack_instances > 0 for cell in cells)
        text += f"\nCrack-like marks in {cracked} of {len(cells)} cells"
    return text


def details_text(inspection: Inspection | None) -> str:
    """Return what there is no room for, with units."""
    made = None if inspection is None else inspection.reconstruction
    if made is None:
        return "Frames that are used, and the distortion of the lens."
    height, width = made.image.shape
    return (
        f"Module image {width} x {height} px, {made.grid.magnification:.2f} px per LR px, "
        f"lambda {made.prior_weight:.3g}, PSF sigma {made.psf_sigma_lr_px:.2f} LR px."
    )
