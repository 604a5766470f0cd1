"""Pictures of one cell beside each other: they zoom and move together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from psygnal import Signal
from qtpy.QtCore import QPointF, QRectF, Qt
from qtpy.QtCore import Signal as QtSignal
from qtpy.QtGui import (
    QColor,
    QImage,
    QMouseEvent,
    QPainter,
    QPaintEvent,
    QPen,
    QPolygonF,
    QTransform,
    QWheelEvent,
)
from qtpy.QtWidgets import QApplication, QWidget

from napari_pv_inspect.appearance import CORRECTED_RGB, CRACK_RGB

__all__ = ["Outlines", "PaintPanel", "Panel", "SharedView"]

Pixels = NDArray[np.uint8]
Outlines = list[NDArray[np.float64]]
ZOOM_STEP = 1.2
MAX_ZOOM = 40.0
TITLE = 18
# From this size on, screen pixels per pixel of the picture, its pixels are shown as they are.
PIXELS_FROM = 6.0


@dataclass
class SharedView:
    """Part of the pictures that all panels show.

    Attributes
    ----------
    x, y : float
        What is in the middle, in parts of the picture.
    zoom : float
        1: the whole picture fits.
    """

    x: float = 0.5
    y: float = 0.5
    zoom: float = 1.0

    changed = Signal()

    def reset(self) -> None:
        """Show the whole picture."""
        self.set(0.5, 0.5, 1.0)

    def set(self, x: float, y: float, zoom: float) -> None:
        """Show another part; the middle stays inside of the picture."""
        self.x, self.y = min(max(x, 0.0), 1.0), min(max(y, 0.0), 1.0)
        self.zoom = min(max(zoom, 1.0), MAX_ZOOM)
        self.changed.emit()


class Panel(QWidget):
    """One picture; the wheel zooms at the pointer, dragging moves.

    Parameters
    ----------
    title, tip : str
    view : SharedView

    Attributes
    ----------
    number : int
        Key that shows it large.
    smooth : bool
        Whether pixels of the picture run into each other where it is enlarged.
    """

    clicked = QtSignal(object)

    def __init__(self, title: str, tip: str, view: SharedView, smooth: bool = True) -> None:
        super().__init__()
        self.title = title
        self.view = view
        self.number = 0
        self.smooth = smooth
        self.sentence = ""
        self.image: QImage | None = None
        self._outlines: list[QPolygonF] = []
        self._faint: list[QPolygonF] = []
        self._rgb = CRACK_RGB
        self._outline_opacity = 1.0
        self._dragged_from: QPointF | None = None
        self._pressed_at = QPointF()
        self._is_click = False
        self.setToolTip(tip)
        self.setMouseTracking(True)
        view.changed.connect(self.repaint_soon)

    def repaint_soon(self) -> None:
        """Schedule a repaint."""
        self.update()

    def show_picture(self, picture: Pixels | None, sentence: str = "") -> None:
        """Show an image (h, w) or (h, w, 3), or a sentence if there is none."""
        self.image = None if picture is None else _image(picture)
        self.sentence = sentence
        self.update()

    def show_outlines(
        self,
        lines: Outlines,
        opacity: float,
        replaced: Outlines | None = None,
    ) -> None:
        """Draw outlines of marks over the picture.

        Parameters
        ----------
        lines : list of (n, 2) float64
            (x, y) in pixels of the picture.
        opacity : float
        replaced : list of (n, 2) float64, optional
            What the detector found where a person has corrected it: dashed, the others in the
            colour of edited things.
        """
        self._outlines, self._faint = _polygons(lines), _polygons(replaced or [])
        self._rgb = CRACK_RGB if replaced is None else CORRECTED_RGB
        self._outline_opacity = opacity
        self.update()

    def to_picture(self) -> QTransform:
        """Widget to picture coordinates."""
        return self.transform().inverted()[0]

    def paintEvent(self, _: QPaintEvent) -> None:  # noqa: N802 (Qt's name)
        """Paint picture, outlines and title."""
        painter = QPainter(self)
        painter.fillRect(self.rect(), QColor("#101214"))
        if self.image is not None:
            painter.setClipRect(self.picture_area())
            painter.setTransform(self.transform())
            scale = self.transform().m11() * self.devicePixelRatioF()
            smooth = scale < 1 or (self.smooth and scale < PIXELS_FROM)
            painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform, smooth)
            painter.drawImage(QPointF(0, 0), self.image)
            self._paint_over(painter)
            painter.resetTransform()
            painter.setClipping(False)
        painter.setPen(QColor("#d0d4d8"))
        flags = Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter
        line = QRectF(4, 0, self.width() - 8, TITLE)
        title = f"{self.number}  {self.title}" if self.number else self.title
        elide = painter.fontMetrics().elidedText
        title = elide(title, Qt.TextElideMode.ElideMiddle, round(line.width()))
        painter.drawText(line, flags, title)
        if self.sentence:
            box = self.picture_area().adjusted(8, 0, -8, 0)
            flags = Qt.AlignmentFlag.AlignCenter | Qt.TextFlag.TextWordWrap
            painter.drawText(box, flags, self.sentence)
        painter.end()

    def wheelEvent(self, event: QWheelEvent) -> None:  # noqa: N802 (Qt's name)
        """Zoom; what is under the pointer stays there."""
        if self.image is None:
            return
        view, place = self.view, event.position()
        before = self.to_picture().map(place)
        zoom = view.zoom * ZOOM_STEP ** (event.angleDelta().y() / 120)
        zoom = min(max(zoom, 1.0), MAX_ZOOM)
        width, height = self.image.width(), self.image.height()
        kept = view.zoom / zoom
        x, y = view.x * width, view.y * height
        x, y = before.x() + (x - before.x()) * kept, before.y() + (y - before.y()) * kept
        view.set(x / width, y / height, zoom)
        event.accept()

    def mousePressEvent(self, event: QMouseEvent) -> None:  # noqa: N802 (Qt's name)
        """Begin to move the pictures, or to click."""
        self._dragged_from = self._pressed_at = event.position()
        self._is_click = True

    def mouseMoveEvent(self, event: QMouseEvent) -> None:  # noqa: N802 (Qt's name)
        """Move the pictures."""
        if self._dragged_from is None or self.image is None:
            return
        if self._is_click:
            way = event.position() - self._pressed_at
            if way.manhattanLength() < QApplication.startDragDistance():
                return
            self._is_click = False
        to = self.to_picture()
        way = to.map(event.position()) - to.map(self._dragged_from)
        self._dragged_from = event.position()
        width, height = self.image.width(), self.image.height()
        view = self.view
        view.set(view.x - way.x() / width, view.y - way.y() / height, view.zoom)

    def mouseReleaseEvent(self, _: QMouseEvent) -> None:  # noqa: N802 (Qt's name)
        """End a drag, or emit a click."""
        clicked = self._dragged_from is not None and self._is_click
        self._dragged_from = None
        self._is_click = False
        if clicked:
            self.clicked.emit(self)

    def mouseDoubleClickEvent(self, _: QMouseEvent) -> None:  # noqa: N802 (Qt's name)
        """Show the whole cell again."""
        self.view.reset()

    def _paint_over(self, painter: QPainter) -> None:
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setOpacity(self._outline_opacity)
        solid = Qt.PenStyle.SolidLine
        for outlines, colour, width, style in (
            (self._faint, QColor.fromRgbF(*CRACK_RGB), 1.0, Qt.PenStyle.DashLine),
            # Dark backgrounds too let the line be seen.
            (self._outlines, QColor(255, 255, 255, 110), 3.5, solid),
            (self._outlines, QColor.fromRgbF(*self._rgb), 1.5, solid),
        ):
            pen = QPen(colour, width, style)
            pen.setCosmetic(True)
            painter.setPen(pen)
            for outline in outlines:
                painter.drawPolygon(outline)
        painter.setOpacity(1.0)

    def picture_area(self) -> QRectF:
        """Where the picture is painted, in the coordinates of the widget."""
        return QRectF(0, TITLE, self.width(), self.height() - TITLE)

    def transform(self) -> QTransform:
        """Picture to widget coordinates."""
        if self.image is None:
            return QTransform()
        area, view = self.picture_area(), self.view
        width, height = self.image.width(), self.image.height()
        scale = view.zoom * min(area.width() / width, area.height() / height)
        transform = QTransform.fromTranslate(area.center().x(), area.center().y())
        transform.scale(scale, scale)
        return transform.translate(-view.x * width, -view.y * height)


class PaintPanel(Panel):
    """A picture whose marks can be painted and erased.

    The left button paints, or erases if ``erasing``; the right one erases. Without ``editable`` it
    moves the picture like any other panel; the middle button always does.
    """

    stroke_begun = QtSignal()
    stroked = QtSignal(object, object, float, bool)
    stroke_ended = QtSignal()

    def __init__(self, title: str, tip: str, view: SharedView) -> None:
        super().__init__(title, tip, view)
        self.editable = self.erasing = False
        self.brush_px = 5.0
        self._last: QPointF | None = None
        self._erases = False
        self._pointer: QPointF | None = None

    def mousePressEvent(self, event: QMouseEvent) -> None:  # noqa: N802 (Qt's name)
        """Begin a stroke."""
        button = event.button()
        if not self.editable or self.image is None or button == Qt.MouseButton.MiddleButton:
            super().mousePressEvent(event)
            return
        if self._last is None:
            self._erases = self.erasing or button == Qt.MouseButton.RightButton
            self.stroke_begun.emit()
            self._last = self.to_picture().map(event.position())
            self._stroke(self._last)

    def mouseMoveEvent(self, event: QMouseEvent) -> None:  # noqa: N802 (Qt's name)
        """Go on with a stroke."""
        self._pointer = event.position()
        if self._last is not None:
            self._stroke(self.to_picture().map(event.position()))
        else:
            super().mouseMoveEvent(event)
        if self.editable:
            self.update()

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:  # noqa: N802 (Qt's name)
        """End a stroke."""
        super().mouseReleaseEvent(event)
        if self._last is not None:
            self._last = None
            self.stroke_ended.emit()

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:  # noqa: N802 (Qt's name)
        """Two quick dots while painting, else the whole cell."""
        if self.editable:
            self.mousePressEvent(event)
        else:
            super().mouseDoubleClickEvent(event)

    def leaveEvent(self, _: object) -> None:  # noqa: N802 (Qt's name)
        """Hide the brush."""
        self._pointer = None
        self.update()

    def _stroke(self, to: QPointF) -> None:
        start, self._last = self._last, to
        assert start is not None
        ends = (start.x(), start.y()), (to.x(), to.y())
        self.stroked.emit(*ends, self.brush_px, self._erases)

    def _paint_over(self, painter: QPainter) -> None:
        super()._paint_over(painter)
        if self.editable and self._pointer is not None:
            pen = QPen(QColor("#ffffff"), 1.0)
            pen.setCosmetic(True)
            painter.setPen(pen)
            radius = self.brush_px / 2
            painter.drawEllipse(self.to_picture().map(self._pointer), radius, radius)


def _polygons(lines: Outlines) -> list[QPolygonF]:
    return [QPolygonF([QPointF(x, y) for x, y in line]) for line in lines]


def _image(picture: Pixels) -> QImage:
    picture = np.ascontiguousarray(picture)
    height, width = picture.shape[:2]
    if picture.ndim == 2:
        kind, stride = QImage.Format.Format_Grayscale8, width
    else:
        kind, stride = QImage.Format.Format_RGB888, 3 * width
    return QImage(picture.data, width, height, stride, kind).copy()
