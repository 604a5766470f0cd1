"""Controls over the pictures of a cell: contrast, marks, brush."""

from __future__ import annotations

from qtpy.QtCore import QSignalBlocker, Qt, Signal
from qtpy.QtWidgets import QCheckBox, QLabel, QPushButton, QSlider, QSpinBox, QVBoxLayout, QWidget
from superqt import QRangeSlider

from napari_pv_inspect.widgets.folding_bar import FoldingBar

__all__ = ["CellBar"]

STEPS = 1000


class CellBar(QWidget):
    """Says how the cell is shown and what the mouse does."""

    changed = Signal()
    reset_wanted = Signal()

    def __init__(self) -> None:
        super().__init__()
        self.back = QPushButton("Back to module")
        self.back.setToolTip("Show frames and module image again (Esc).")
        self.gallery = QPushButton("Gallery")
        self.gallery.setToolTip(
            "Show or fold the gallery below (G): without it the cell is larger."
        )
        self.contrast_slider = QRangeSlider(Qt.Orientation.Horizontal)
        self.contrast_slider.setRange(0, STEPS)
        self.contrast_slider.setValue((0, STEPS))
        _may_shrink(self.contrast_slider, 60, 160)
        self.contrast_slider.setToolTip(
            "Black and white of module image, frame and bicubic, parts of the brightest pixel."
        )
        self.opacity_slider = QSlider(Qt.Orientation.Horizontal)
        self.opacity_slider.setRange(0, 100)
        self.opacity_slider.setValue(90)
        _may_shrink(self.opacity_slider, 40, 80)
        self.opacity_slider.setToolTip("Opacity of the outlines of the marks, percent; 0: none.")
        self.drawing = QCheckBox("Brush")
        self.drawing.setToolTip(
            "Correct the marks on the module image (D): left button paints, right button erases."
        )
        self.eraser = QCheckBox("Eraser")
        self.eraser.setToolTip("The left button erases as well (E).")
        self.brush = QSpinBox()
        self.brush.setRange(1, 60)
        self.brush.setValue(5)
        self.brush.setSuffix(" px")
        self.brush.setToolTip("Width of brush and eraser, pixels of the module image (+ and -).")
        self.reset = QPushButton("Reset")
        self.reset.setToolTip("Go back to the marks that the detector found.")
        for button in (self.back, self.gallery):  # a dock has its own ways
            button.hide()
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        shown = (QLabel("Contrast"), self.contrast_slider, QLabel("Marks"), self.opacity_slider)
        layout.addWidget(
            FoldingBar(
                (self.back, self.gallery, *shown),
                (self.drawing, self.eraser, self.brush, self.reset),
            )
        )
        for signal in (
            self.contrast_slider.valueChanged,
            self.opacity_slider.valueChanged,
            self.drawing.toggled,
            self.eraser.toggled,
            self.brush.valueChanged,
        ):
            signal.connect(self._on_change)
        self.reset.clicked.connect(self.reset_wanted)

    @property
    def contrast(self) -> tuple[float, float]:
        """Black and white, parts of the brightest pixel."""
        limits: tuple[int, ...] = self.contrast_slider.value()
        return limits[0] / STEPS, limits[1] / STEPS

    @property
    def opacity(self) -> float:
        """Opacity of the outlines, 0 to 1."""
        return self.opacity_slider.value() / 100

    @property
    def draws(self) -> bool:
        """Whether the mouse corrects the marks."""
        return self.drawing.isChecked()

    @property
    def erases(self) -> bool:
        """Whether the left button erases."""
        return self.eraser.isChecked()

    @property
    def brush_px(self) -> int:
        """Width of the brush, HR pixels."""
        return self.brush.value()

    def show_contrast(self, low: float, high: float) -> None:
        """Show limits without telling that they changed."""
        with QSignalBlocker(self.contrast_slider):
            self.contrast_slider.setValue((round(low * STEPS), round(high * STEPS)))

    def toggle_drawing(self) -> None:
        """Begin or end to correct."""
        self.drawing.toggle()

    def toggle_eraser(self) -> None:
        """Take the eraser or the brush."""
        self.eraser.toggle()

    def grow(self, by: int) -> None:
        """Take a wider or narrower brush."""
        self.brush.setValue(self.brush.value() + by)

    def _on_change(self, _: object = None) -> None:
        self.changed.emit()


def _may_shrink(slider: QSlider | QRangeSlider, least: int, most: int) -> None:
    # Beside the live cell there is little room.
    slider.setMinimumWidth(least)
    slider.setMaximumWidth(most)
