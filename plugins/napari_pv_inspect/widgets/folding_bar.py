"""A row of controls that becomes two rows where there is no room for one."""

from __future__ import annotations

from qtpy.QtCore import QSize
from qtpy.QtGui import QResizeEvent
from qtpy.QtWidgets import QHBoxLayout, QVBoxLayout, QWidget

__all__ = ["FoldingBar"]


class FoldingBar(QWidget):
    """Two groups of controls, beside each other or one below the other.

    Parameters
    ----------
    first, second : tuple of QWidget
    """

    def __init__(self, first: tuple[QWidget, ...], second: tuple[QWidget, ...]) -> None:
        super().__init__()
        self._groups = _group(first), _group(second)
        self._upper, self._lower = QHBoxLayout(), QHBoxLayout()
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(4)
        layout.addLayout(self._upper)
        layout.addLayout(self._lower)
        self._upper.addWidget(self._groups[0])
        self._upper.addStretch(1)
        self._lower.addWidget(self._groups[1])
        self._lower.addStretch(1)
        self.is_folded = True

    def minimumSizeHint(self) -> QSize:  # noqa: N802 (Qt's name)
        """Room for the wider group."""
        width = max(group.minimumSizeHint().width() for group in self._groups)
        return QSize(width, super().minimumSizeHint().height())

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802 (Qt's name)
        """Fold or unfold."""
        super().resizeEvent(event)
        wanted = sum(group.sizeHint().width() for group in self._groups) + self._upper.spacing()
        folded = self.width() < wanted
        if folded is not self.is_folded:
            self.is_folded = folded
            second = self._groups[1]
            here, there = (self._upper, self._lower) if folded else (self._lower, self._upper)
            here.removeWidget(second)
            there.insertWidget(there.count() - 1, second)


def _group(widgets: tuple[QWidget, ...]) -> QWidget:
    group = QWidget()
    row = QHBoxLayout(group)
    row.setContentsMargins(0, 0, 0, 0)
    for widget in widgets:
        row.addWidget(widget)
    return group
