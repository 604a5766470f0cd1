"""A slider with its title and number above it; linear or logarithmic, with an automatic mark."""

from __future__ import annotations

import math

from qtpy.QtCore import QSignalBlocker, Qt, Signal
from qtpy.QtWidgets import (
    QAbstractSpinBox,
    QCheckBox,
    QDoubleSpinBox,
    QHBoxLayout,
    QLabel,
    QSlider,
    QVBoxLayout,
    QWidget,
)

__all__ = ["NumberSlider"]

STEPS = 400
NUMBER_WIDTH = 76


class NumberSlider(QWidget):
    """Shows and changes one number, which may be found automatically.

    Parameters
    ----------
    title : str
        Stands above the slider.
    span : (low, high)
        Of the slider.
    limits : (least, most)
        Of the number; None: that of the slider.
    decimals : int
    logarithmic : bool
        Equal ways of the slider are equal ratios; needs ``low`` > 0.
    automatic : str
        Text of the mark that says that the number is found automatically; "": there is none.

    Attributes
    ----------
    automatic : QCheckBox or None
    """

    changed = Signal(object)

    def __init__(
        self,
        title: str,
        span: tuple[float, float],
        limits: tuple[float | None, float | None],
        decimals: int,
        logarithmic: bool = False,
        automatic: str = "",
        parent: QWidget | None = None,
    ) -> None:
        super().__init__(parent)
        low, high = self._low, self._high = span
        self._log = logarithmic
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setRange(0, STEPS)
        self.number = QDoubleSpinBox()
        self.number.setDecimals(decimals)
        least, most = limits
        self.number.setRange(low if least is None else least, high if most is None else most)
        self.number.setKeyboardTracking(False)
        if logarithmic:
            self.number.setStepType(QDoubleSpinBox.StepType.AdaptiveDecimalStepType)
        else:
            self.number.setSingleStep(max((high - low) / 100, 10.0**-decimals))
        # The arrow keys step it; buttons would take the room of the slider.
        self.number.setButtonSymbols(QAbstractSpinBox.ButtonSymbols.NoButtons)
        self.number.setAlignment(Qt.AlignmentFlag.AlignRight)
        self.number.setFixedWidth(NUMBER_WIDTH)
        self.slider.setAccessibleName(title)
        self.number.setAccessibleName(title)
        self.automatic = QCheckBox(automatic) if automatic else None
        head = QHBoxLayout()
        head.setSpacing(6)
        head.addWidget(QLabel(title))
        head.addStretch(1)
        if self.automatic is not None:
            self.automatic.setAccessibleName(f"{title}: {automatic}")
            head.addWidget(self.automatic)
            self.automatic.toggled.connect(self._on_automatic)
        head.addWidget(self.number)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(1)
        layout.addLayout(head)
        layout.addWidget(self.slider)
        if self.automatic is not None:
            QWidget.setTabOrder(self.automatic, self.number)
        QWidget.setTabOrder(self.number, self.slider)
        self.slider.valueChanged.connect(self._on_slider)
        self.number.valueChanged.connect(self._on_number)

    def value(self) -> float | None:
        """Return the number, None if it is found automatically."""
        if self.automatic is not None and self.automatic.isChecked():
            return None
        return float(self.number.value())

    def show_value(self, value: float | None) -> None:
        """Show a value without telling that it changed."""
        if self.automatic is not None:
            with QSignalBlocker(self.automatic):
                self.automatic.setChecked(value is None)
        if value is not None:
            self.show_number(value)

    def show_number(self, value: float) -> None:
        """Show a number and leave the mark as it is: what automatic stands for at present."""
        with QSignalBlocker(self.number), QSignalBlocker(self.slider):
            self.number.setValue(value)
            self.slider.setValue(self._position(value))

    def _on_slider(self, position: int) -> None:
        value = self._value_at(position)
        with QSignalBlocker(self.number):
            self.number.setValue(value)
        self._give(float(self.number.value()))

    def _on_number(self, value: float) -> None:
        with QSignalBlocker(self.slider):
            self.slider.setValue(self._position(value))
        self._give(value)

    def _on_automatic(self, _: bool) -> None:
        self.changed.emit(self.value())

    def _give(self, value: float) -> None:
        """Tell a number that was set by hand."""
        if self.automatic is not None:
            with QSignalBlocker(self.automatic):
                self.automatic.setChecked(False)
        self.changed.emit(value)

    def _value_at(self, position: int) -> float:
        share = position / STEPS
        if self._log:
            return float(self._low * (self._high / self._low) ** share)
        return self._low + (self._high - self._low) * share

    def _position(self, value: float) -> int:
        value = min(max(value, self._low), self._high)
        if self._log:
            share = math.log(value / self._low) / math.log(self._high / self._low)
        else:
            share = (value - self._low) / (self._high - self._low)
        return round(share * STEPS)
