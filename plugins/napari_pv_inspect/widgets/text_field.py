"""A field for a text, or for numbers written side by side, that may be left empty."""

from __future__ import annotations

from qtpy.QtCore import Signal
from qtpy.QtWidgets import QLineEdit, QWidget

__all__ = ["NumbersField", "TextField"]


class TextField(QLineEdit):
    """A text; a word in grey stands where none is given.

    Parameters
    ----------
    missing : str
        The word.
    """

    changed = Signal(object)

    def __init__(self, missing: str, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setPlaceholderText(missing)
        self.editingFinished.connect(self._on_edited)

    def value(self) -> object:
        """Return the text, None if it is empty."""
        return self.text().strip() or None

    def show_value(self, value: object) -> None:
        """Show a text without telling that it changed."""
        self.setText("" if value is None else str(value))

    def _on_edited(self) -> None:
        if self.isModified():
            self.setModified(False)
            self.changed.emit(self.value())


class NumbersField(TextField):
    """Numbers with commas between them; what is none is passed on as it was typed."""

    def value(self) -> object:
        """Return the numbers, None if there are none, the words if they are no numbers."""
        words = self.text().replace(",", " ").split()
        try:
            return tuple(float(word) for word in words) or None
        except ValueError:
            return tuple(words)

    def show_value(self, value: object) -> None:
        """Show numbers without telling that they changed."""
        numbers = value if isinstance(value, tuple) else ()
        self.setText(", ".join(f"{number:g}" for number in numbers))
