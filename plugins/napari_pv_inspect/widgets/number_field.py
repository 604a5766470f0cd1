"""A field for one number that may be left to the program."""

from __future__ import annotations

from qtpy.QtCore import QSignalBlocker, Signal
from qtpy.QtWidgets import QAbstractSpinBox, QDoubleSpinBox, QWidget

__all__ = ["NumberField"]

LARGEST = 1e9


class NumberField(QDoubleSpinBox):
    """A number between limits, or a word in its place where none is given.

    Parameters
    ----------
    limits : (least, most)
        None: there is no limit.
    decimals : int
        0: whole numbers.
    missing : str
        The word; it stands one step below the least number. "": a number must be given.
    """

    changed = Signal(object)

    def __init__(
        self,
        limits: tuple[float | None, float | None],
        decimals: int,
        missing: str = "",
        parent: QWidget | None = None,
    ) -> None:
        super().__init__(parent)
        step = 1.0 if decimals == 0 else 0.1
        least = -LARGEST if limits[0] is None else limits[0]
        self._least, self._word = least, missing
        self.setDecimals(decimals)
        self.setSingleStep(step)
        self.setRange(
            least - step if missing else least, LARGEST if limits[1] is None else limits[1]
        )
        self.setSpecialValueText(missing)
        self.setKeyboardTracking(False)
        # The arrow keys step it; buttons would take the room of the figures.
        self.setButtonSymbols(QAbstractSpinBox.ButtonSymbols.NoButtons)
        self.setMinimumWidth(52)
        self.valueChanged.connect(self._on_value)

    def given(self) -> float | int | None:
        """Return the number, None where the word stands."""
        value = self.value()
        if self._word and value < self._least:
            return None
        return value if self.decimals() else round(value)

    def show_given(self, value: float | None) -> None:
        """Show a number or the word without telling that it changed."""
        with QSignalBlocker(self):
            self.setValue(self.minimum() if value is None else value)

    def _on_value(self, _: float) -> None:
        self.changed.emit(self.given())
