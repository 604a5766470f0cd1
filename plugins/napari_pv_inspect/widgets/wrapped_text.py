"""A list of sentences, wrapped, with a scroll bar only where they would fill the dock."""

from __future__ import annotations

from qtpy.QtCore import QSize, Qt
from qtpy.QtGui import QResizeEvent
from qtpy.QtWidgets import QFrame, QLabel, QScrollArea, QSizePolicy, QWidget

__all__ = ["SentenceList"]


class SentenceList(QScrollArea):
    """Some plain sentences, one below the other; hidden while there are none.

    Parameters
    ----------
    colour : str
    most_lines : int
        What is longer scrolls.
    """

    def __init__(self, colour: str, most_lines: int = 12, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._most_lines = most_lines
        self.label = QLabel()
        self.label.setWordWrap(True)
        self.label.setTextFormat(Qt.TextFormat.PlainText)
        self.label.setAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignTop)
        self.label.setStyleSheet(f"color: {colour}")
        self.label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.setWidget(self.label)
        self.setWidgetResizable(True)
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Fixed)
        self.hide()

    def show_sentences(self, sentences: tuple[str, ...]) -> None:
        """Show other sentences."""
        self.label.setText("\n".join(sentences))
        self.setVisible(bool(sentences))
        self.updateGeometry()

    def sizeHint(self) -> QSize:  # noqa: N802 (Qt's name)
        """As high as the text, up to a limit."""
        return QSize(200, self._height())

    def minimumSizeHint(self) -> QSize:  # noqa: N802 (Qt's name)
        """All of it."""
        return QSize(40, self._height())

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802 (Qt's name)
        """Wrap anew."""
        super().resizeEvent(event)
        if event.oldSize().width() != event.size().width():
            self.updateGeometry()

    def _height(self) -> int:
        line = self.label.fontMetrics().lineSpacing()
        # The style of napari pads labels by some pixels that Qt does not count.
        needed = self.label.heightForWidth(max(self.width(), 40)) + line // 2
        most = self._most_lines * line
        bar = Qt.ScrollBarPolicy
        self.setVerticalScrollBarPolicy(
            bar.ScrollBarAlwaysOn if needed > most else bar.ScrollBarAlwaysOff
        )
        return min(needed, most)
