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


class _Number(QDoubleSpinBox):
    """A number whose text is empty while nobody knows it; tells that it was confirmed by hand."""

    confirmed = Signal()

    def __init__(self) -> None:
        super().__init__()
        self._unknown = self._typed = False
        self.lineEdit().textEdited.connect(self._on_text)
        self.editingFinished.connect(self._on_finished)
        self.lineEdit().returnPressed.connect(self.confirmed)

    def set_unknown(self, unknown: bool) -> None:
        """Leave the text empty, or write the value again."""
        if unknown != self._unknown:
            self._unknown, self._typed = unknown, False
            with QSignalBlocker(self):
                self.setSuffix(" ")  # writes the text; so does nothing else that keeps the value
                self.setSuffix("")

    def textFromValue(self, value: float) -> str:  # noqa: N802 (Qt's name)
        """Return the text of a value, as Qt asks for it."""
        return "" if self._unknown and not self._typed else super().textFromValue(value)

    def stepBy(self, steps: int) -> None:  # noqa: N802 (Qt's name)
        """Step as Qt asks for it; from an empty text to where the slider stands and on."""
        self.set_unknown(False)
        super().stepBy(steps)

    def _on_text(self, text: str) -> None:
        self._typed = bool(text.strip())

    def _on_finished(self) -> None:
        if self._typed:
            self._typed = False
            self.confirmed.emit()


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
        self.number = _Number()
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
        self.slider.sliderReleased.connect(self._on_confirmed)
        self.number.valueChanged.connect(self._on_number)
        self.number.confirmed.connect(self._on_confirmed)

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

    def show_number(self, value: float | None) -> None:
        """Show a number and leave the mark as it is: what automatic stands for at present.

        None: nobody knows it yet. No number stands there and the slider in its middle.
        """
        unknown = value is None
        if value is None:
            value = self._value_at(STEPS // 2)
        with QSignalBlocker(self.number), QSignalBlocker(self.slider):
            self.number.setValue(value)
            self.slider.setValue(self._position(value))
        self.number.set_unknown(unknown)

    def _on_slider(self, position: int) -> None:
        value = self._value_at(position)
        with QSignalBlocker(self.number):
            self.number.setValue(value)
        self._give(float(self.number.value()))

    def _on_number(self, value: float) -> None:
        with QSignalBlocker(self.slider):
            self.slider.setValue(self._position(value))
        self._give(value)

    def _on_automatic(self, automatic: bool) -> None:
        if not automatic:
            self.number.set_unknown(False)
        self.changed.emit(self.value())

    def _on_confirmed(self) -> None:
        """Take the number that automatic stands for: it was confirmed by hand."""
        if self.value() is None and self.number.text():
            self._give(float(self.number.value()))

    def _give(self, value: float) -> None:
        """Tell a number that was set by hand."""
        self.number.set_unknown(False)
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
