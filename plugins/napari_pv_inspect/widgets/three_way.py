"""A box for yes, no, and as it is found."""

from __future__ import annotations

from qtpy.QtCore import QSignalBlocker, Qt, Signal
from qtpy.QtWidgets import QComboBox, QWidget

__all__ = ["ThreeWay"]


class ThreeWay(QComboBox):
    """None, True or False.

    Parameters
    ----------
    automatic : str
        What None is called.
    yes, no : (str, str)
        What the others are called, and what they mean.
    """

    changed = Signal(object)

    def __init__(
        self,
        automatic: str,
        yes: tuple[str, str],
        no: tuple[str, str],
        parent: QWidget | None = None,
    ) -> None:
        super().__init__(parent)
        self._values = (None, True, False)
        self.addItems([automatic, yes[0], no[0]])
        for k, (_, meaning) in enumerate((yes, no), start=1):
            self.setItemData(k, meaning, Qt.ItemDataRole.ToolTipRole)
        # It may be narrower than its longest words.
        self.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.setMinimumContentsLength(6)
        self.currentIndexChanged.connect(self._on_index)

    def value(self) -> bool | None:
        """Return what is chosen."""
        return self._values[self.currentIndex()]

    def show_value(self, value: object) -> None:
        """Show a value without telling that it changed."""
        with QSignalBlocker(self):
            self.setCurrentIndex(next(k for k, v in enumerate(self._values) if v is value))

    def _on_index(self, _: int) -> None:
        self.changed.emit(self.value())
