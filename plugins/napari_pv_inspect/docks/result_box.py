"""What came out, where to look, and *Save*."""

from __future__ import annotations

from qtpy.QtCore import Signal
from qtpy.QtWidgets import QGroupBox, QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from napari_pv_inspect.docks.listen import listen
from napari_pv_inspect.model import WorkbenchModel
from napari_pv_inspect.navigation import Navigator
from pv_inspect.pipeline import Inspection

__all__ = ["ResultBox", "summary_text"]


class ResultBox(QGroupBox):
    """Numbers of the shown inspection, views of it, and the way to disk."""

    save_wanted = Signal()

    def __init__(
        self, model: WorkbenchModel, navigator: Navigator, parent: QWidget | None = None
    ) -> None:
        super().__init__("Result", parent)
        self._model = model
        self.summary = QLabel()
        self.summary.setWordWrap(True)
        self.save = QPushButton("Save result...")
        self.save.setToolTip("Write module image, cells, crack map and report into a folder.")
        views = QHBoxLayout()
        views.addWidget(QLabel("Look at"))
        for text, tip, slot in (
            ("Frames", "Fill the canvas with the frames.", navigator.to_frames),
            ("Module", "Fill the canvas with the module image.", navigator.to_module),
            ("Both", "Frames and module image side by side.", navigator.to_all),
        ):
            button = QPushButton(text)
            button.setToolTip(tip)
            button.clicked.connect(slot)
            views.addWidget(button)
        layout = QVBoxLayout(self)
        layout.addWidget(self.summary)
        layout.addLayout(views)
        layout.addWidget(self.save)
        self.save.clicked.connect(self.save_wanted)
        listen(model.inspection_changed, self._on_change)
        listen(model.run_changed, self._on_change)
        self._on_change()

    def _on_change(self, _: object = None) -> None:
        inspection = self._model.inspection
        self.summary.setText(summary_text(inspection))
        self.save.setEnabled(inspection is not None and inspection.complete)


def summary_text(inspection: Inspection | None) -> str:
    """Return the numbers of an inspection in a few lines."""
    if inspection is None or inspection.calibration is None:
        return "Nothing yet."
    fit = inspection.registration or inspection.calibration
    lines = [
        f"{int(fit.used.sum())} of {len(fit.used)} frames used, kappa {fit.camera.kappa:+.4f}",
    ]
    if (made := inspection.reconstruction) is not None:
        height, width = made.image.shape
        lines.append(
            f"{width} x {height} px, {made.grid.magnification:.2f}x, lambda {made.prior_weight:.3g}"
        )
    if inspection.cracks is not None:
        cells = inspection.cracks.cells
        cracked = sum(cell.crack_instances > 0 for cell in cells)
        lines.append(f"crack-like marks in {cracked} of {len(cells)} cells")
    lines += inspection.warnings[:3]
    return "\n".join(lines)
