"""A slider with its title and number above it, for one setting; linear or logarithmic."""

from __future__ import annotations

import math

from qtpy.QtCore import QSignalBlocker, Qt, Signal
from qtpy.QtWidgets import (
    QAbstractSpinBox,
    QDoubleSpinBox,
    QHBoxLayout,
    QLabel,
    QSlider,
    QVBoxLayout,
    QWidget,
)

from pv_inspect.settings import Settings

__all__ = ["SettingSlider", "setting_tooltip"]

STEPS = 400
NUMBER_WIDTH = 76


def setting_tooltip(name: str) -> str:
    """What a setting means and its unit, as Settings declares them."""
    description = Settings.model_fields[name].description or name
    return f"{description} Unit: {Settings.unit_of(name)}."


class SettingSlider(QWidget):
    """Shows and changes one number.

    Parameters
    ----------
    name : str
        Field of Settings; gives the tooltip, the range of the slider and the limits of the number.
    title : str
        Stands above the slider.
    decimals : int
    logarithmic : bool
        Equal ways of the slider are equal ratios; needs ``low`` > 0.
    """

    changed = Signal(float)

    def __init__(
        self,
        name: str,
        title: str,
        decimals: int,
        logarithmic: bool = False,
        parent: QWidget | None = None,
    ) -> None:
        super().__init__(parent)
        low, high = self._low, self._high = Settings.slider_of(name)
        self._log = logarithmic
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setRange(0, STEPS)
        self.number = QDoubleSpinBox()
        self.number.setDecimals(decimals)
        least, most = Settings.limits_of(name)
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
        self.setObjectName(name)
        self.setToolTip(setting_tooltip(name))
        self.slider.setAccessibleName(title)
        self.number.setAccessibleName(title)
        self._head = QHBoxLayout()
        self._head.setSpacing(8)
        self._head.addWidget(QLabel(title))
        self._head.addStretch(1)
        self._head.addWidget(self.number)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(1)
        layout.addLayout(self._head)
        layout.addWidget(self.slider)
        self.slider.valueChanged.connect(self._on_slider)
        self.number.valueChanged.connect(self._on_number)

    def add_to_header(self, widget: QWidget) -> None:
        """Place a widget beside the number; the tab key comes to it first."""
        self._head.insertWidget(self._head.count() - 1, widget)
        QWidget.setTabOrder(self.number, widget)
        QWidget.setTabOrder(widget, self.number)

    @property
    def value(self) -> float:
        """The number that is shown."""
        return float(self.number.value())

    def show_value(self, value: float) -> None:
        """Show a number without telling that it changed."""
        with QSignalBlocker(self.number), QSignalBlocker(self.slider):
            self.number.setValue(value)
            self.slider.setValue(self._position(value))

    def _on_slider(self, position: int) -> None:
        value = self._value_at(position)
        with QSignalBlocker(self.number):
            self.number.setValue(value)
        self.changed.emit(self.value)

    def _on_number(self, value: float) -> None:
        with QSignalBlocker(self.slider):
            self.slider.setValue(self._position(value))
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
