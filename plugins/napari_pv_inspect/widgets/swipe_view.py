"""One cell large, two pictures of it one over the other, a divider between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from qtpy.QtCore import QPointF, QRectF, QSize, Qt, QTimer, Signal
from qtpy.QtGui import (
    QColor,
    QFocusEvent,
    QImage,
    QKeyEvent,
    QMouseEvent,
    QPainter,
    QPaintEvent,
    QPen,
)
from qtpy.QtWidgets import QSizePolicy, QWidget

__all__ = ["SwipeView", "grey_image"]

# The pictures change places twice a second and back.
FLICKER_MS = 250
STEP = 0.05
BACKGROUND = QColor("#101010")
LINE = QColor("#56B4E9")

Image = NDArray[np.float32]


def grey_image(image: Image, limits: tuple[float, float]) -> QImage:
    """Turn intensities (height, width) into a grey picture between two limits."""
    low, high = limits
    scaled = (np.asarray(image, np.float32) - low) * (255.0 / max(high - low, 1e-12))
    grey = np.ascontiguousarray(np.clip(scaled, 0.0, 255.0).astype(np.uint8))
    height, width = grey.shape
    # Qt does not copy the buffer by itself.
    return QImage(grey.data, width, height, width, QImage.Format.Format_Grayscale8).copy()


class SwipeView(QWidget):
    """Shows *before* left of a divider and *after* right of it, in one contrast.

    The divider follows the mouse; the arrow keys move it too. While the space bar is held, or
    every other moment while it flickers, only *before* is seen.
    """

    painted = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.setMinimumSize(160, 160)
        self.setCursor(Qt.CursorShape.SplitHCursor)
        self.setToolTip(
            "Drag the divider, or click and move it with the arrow keys, Home and End. Hold the "
            "space bar to see only what it is compared with."
        )
        self.setAccessibleName("Two pictures of the cell with a divider")
        self.pictures: list[tuple[QImage | None, str]] = [(None, ""), (None, "")]
        self._scaled: dict[int, tuple[QSize, QImage]] = {}
        self._held = self._blink = False
        self.message = ""
        self.divider = 0.5
        self._flicker = QTimer(self)
        self._flicker.setInterval(FLICKER_MS)
        self._flicker.timeout.connect(self.alternate)

    def show_before(self, image: QImage | None, text: str) -> None:
        """Set what is compared with; None for nothing."""
        self._put(0, image, text)

    def show_after(self, image: QImage | None, text: str) -> None:
        """Set what is looked at."""
        self._put(1, image, text)

    def show_message(self, text: str) -> None:
        """Say a sentence in place of a picture."""
        self.message = text
        self.update()

    def set_flicker(self, on: bool) -> None:
        """Show the two pictures alternately."""
        self._blink = False
        if on:
            self._flicker.start()
        else:
            self._flicker.stop()
        self.update()

    @property
    def only_before(self) -> bool:
        """Whether *before* is seen alone just now."""
        return (self._held or self._blink) and self.pictures[0][0] is not None

    def sizeHint(self) -> QSize:  # noqa: N802 (Qt's name)
        """As large as is usual for one cell."""
        return QSize(360, 360)

    def target(self) -> QRectF:
        """Where the pictures are painted, in the coordinates of the widget."""
        image = self.pictures[1][0] or self.pictures[0][0]
        if image is None:
            return QRectF(self.rect())
        scale = min(self.width() / image.width(), self.height() / image.height())
        width, height = image.width() * scale, image.height() * scale
        return QRectF((self.width() - width) / 2, (self.height() - height) / 2, width, height)

    def paintEvent(self, _: QPaintEvent) -> None:  # noqa: N802 (Qt's name)
        """Paint both pictures, the divider and what they are."""
        painter = QPainter(self)
        painter.fillRect(self.rect(), BACKGROUND)
        place = self.target()
        (before, before_text), (after, after_text) = self.pictures
        if after is not None and not self.only_before:
            painter.drawImage(place.topLeft(), self._fitted(1, after, place))
        split = place.left() + self.divider * place.width()
        swiped = before is not None and not self._flicker.isActive() and not self._held
        if before is not None and (swiped or self.only_before):
            right = place.right() if self.only_before else split
            painter.save()
            painter.setClipRect(QRectF(place.left(), place.top(), right - place.left(), 1e5))
            painter.drawImage(place.topLeft(), self._fitted(0, before, place))
            painter.restore()
        if swiped and not self.only_before:
            painter.setPen(QPen(LINE, 2))
            painter.drawLine(QPointF(split, place.top()), QPointF(split, place.bottom()))
            painter.setBrush(LINE)
            if self.hasFocus():
                # The arrow keys take hold of it.
                painter.setPen(QPen(QColor("white"), 2))
            painter.drawEllipse(QPointF(split, place.center().y()), 7, 7)
        if before is not None and (swiped or self.only_before):
            self._label(painter, before_text, Qt.AlignmentFlag.AlignLeft)
        if after is not None and not self.only_before:
            self._label(painter, after_text, Qt.AlignmentFlag.AlignRight)
        if self.message:
            self._label(painter, self.message, Qt.AlignmentFlag.AlignCenter)
        painter.end()
        self.painted.emit()

    def mousePressEvent(self, event: QMouseEvent) -> None:  # noqa: N802 (Qt's name)
        """Bring the divider to the mouse."""
        self._divide(event)

    def mouseMoveEvent(self, event: QMouseEvent) -> None:  # noqa: N802 (Qt's name)
        """Let the divider follow the mouse."""
        if event.buttons() & Qt.MouseButton.LeftButton:
            self._divide(event)

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802 (Qt's name)
        """Arrow keys move the divider; the space bar shows *before*."""
        steps: dict[int, int] = {Qt.Key.Key_Left: -1, Qt.Key.Key_Right: 1}
        if event.key() in steps:
            self.step(steps[event.key()])
        elif event.key() == Qt.Key.Key_Space:
            self._hold(True)
        else:
            super().keyPressEvent(event)

    def keyReleaseEvent(self, event: QKeyEvent) -> None:  # noqa: N802 (Qt's name)
        """Show both pictures again when the space bar is released."""
        if event.key() == Qt.Key.Key_Space and not event.isAutoRepeat():
            self._hold(False)
        else:
            super().keyReleaseEvent(event)

    def focusOutEvent(self, event: QFocusEvent) -> None:  # noqa: N802 (Qt's name)
        """Show both pictures again: the release of the space bar may go to another widget."""
        self._hold(False)
        super().focusOutEvent(event)

    def step(self, steps: int) -> None:
        """Move the divider by some steps to the right."""
        self.move_divider(self.divider + STEP * steps)

    def move_divider(self, share: float) -> None:
        """Put the divider at a share of the width, 0 to 1."""
        self.divider = min(max(share, 0.0), 1.0)
        self.update()

    def _divide(self, event: QMouseEvent) -> None:
        place = self.target()
        self.move_divider((event.position().x() - place.left()) / max(place.width(), 1.0))

    def _hold(self, held: bool) -> None:
        self._held = held
        self.update()

    def alternate(self) -> None:
        """Show the other picture alone, or both again."""
        self._blink = not self._blink
        self.update()

    def _put(self, which: int, image: QImage | None, text: str) -> None:
        self.pictures[which] = (image, text)
        self._scaled.pop(which, None)
        self.update()

    def _fitted(self, which: int, image: QImage, place: QRectF) -> QImage:
        """Scale a picture to the pixels of the screen, once per size."""
        ratio = self.devicePixelRatioF()
        size = QSize(round(place.width() * ratio), round(place.height() * ratio))
        known = self._scaled.get(which)
        if known is None or known[0] != size:
            scaled = image.scaled(
                size,
                Qt.AspectRatioMode.IgnoreAspectRatio,
                Qt.TransformationMode.SmoothTransformation,
            )
            scaled.setDevicePixelRatio(ratio)
            known = self._scaled[which] = (size, scaled)
        return known[1]

    def _label(self, painter: QPainter, text: str, side: Qt.AlignmentFlag) -> None:
        if not text:
            return
        room = QRectF(self.rect()).adjusted(4, 4, -4, -4)
        if side != Qt.AlignmentFlag.AlignCenter:
            room.setWidth(room.width() / 2 - 4)
            if side == Qt.AlignmentFlag.AlignRight:
                room.moveRight(self.width() - 4)
            side |= Qt.AlignmentFlag.AlignTop
        flags = int(side) | int(Qt.TextFlag.TextWordWrap)
        box = painter.boundingRect(room, flags, text)
        painter.fillRect(box.adjusted(-3, -1, 3, 1), QColor(0, 0, 0, 170))
        painter.setPen(QColor("white"))
        painter.drawText(room, flags, text)
