"""A check box for a choice of two."""

from __future__ import annotations

from qtpy.QtCore import QSignalBlocker, Signal
from qtpy.QtWidgets import QCheckBox, QWidget

__all__ = ["ChoiceMark"]


class ChoiceMark(QCheckBox):
    """One value if it is checked, another if it is not.

    Parameters
    ----------
    text : str
    checked, unchecked : object
        The values.
    """

    changed = Signal(object)

    def __init__(
        self, text: str, checked: object, unchecked: object, parent: QWidget | None = None
    ) -> None:
        super().__init__(text, parent)
        self._checked, self._unchecked = checked, unchecked
        self.toggled.connect(self._on_toggled)

    def value(self) -> object:
        """Return the value that is chosen."""
        return self._checked if self.isChecked() else self._unchecked

    def show_value(self, value: object) -> None:
        """Show a value without telling that it changed."""
        with QSignalBlocker(self):
            self.setChecked(value == self._checked)

    def _on_toggled(self, _: bool) -> None:
        self.changed.emit(self.value())
