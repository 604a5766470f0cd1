"""The curve that lambda is chosen from: what each weight leaves of held-out pixels."""

from __future__ import annotations

import math

from qtpy.QtCore import QPointF, QRectF, QSize, Qt, Signal
from qtpy.QtGui import QColor, QMouseEvent, QPainter, QPaintEvent, QPen
from qtpy.QtWidgets import QSizePolicy, QWidget

__all__ = ["LambdaPlot"]

Curve = tuple[tuple[float, float], ...]

CURVE = QColor("#56B4E9")
AUTOMATIC = QColor("#009E73")
PRESENT = QColor("#E69F00")
# With a doubt of one line above it, the page just fits into a window of 1280 x 800.
HEIGHT_PX = 100
MARGIN = (8.0, 20.0, 8.0, 18.0)
# Beyond the weights that were tried, as a factor.
BEYOND = 4.0


class LambdaPlot(QWidget):
    """Held-out residual over lambda, on a logarithmic axis; a click chooses a lambda."""

    chosen = Signal(float)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setFixedHeight(HEIGHT_PX)
        self.setToolTip(
            "Mean squared residual of held-out pixels, in units of the noise, over lambda: the "
            "lower, the better the image predicts what it has not seen. Green: the automatic "
            "choice; amber: lambda now. A click sets lambda."
        )
        self._curve: Curve = ()
        self._automatic: float | None = None
        self._present: float | None = None
        self.why = ""

    def show_curve(self, curve: Curve, automatic: float | None, why: str = "") -> None:
        """Show a curve, or why there is none.

        Parameters
        ----------
        curve : tuple of (lambda, residual)
        automatic : float, optional
            The choice.
        why : str
            One sentence if there is no curve.
        """
        self._curve, self._automatic = tuple(sorted(curve)), automatic
        self.why = "" if len(curve) > 1 else why
        self.setCursor(
            Qt.CursorShape.ArrowCursor if self.why else Qt.CursorShape.PointingHandCursor
        )
        self.update()

    def show_present(self, weight: float | None) -> None:
        """Mark lambda as it is now."""
        self._present = weight
        self.update()

    def sizeHint(self) -> QSize:  # noqa: N802 (Qt's name)
        """Wide and low."""
        return QSize(280, HEIGHT_PX)

    def x_of(self, weight: float) -> float:
        """Where a lambda lies, in pixels of the widget; at the rim if it is beyond."""
        low, high = self._range()
        share = math.log(max(weight, 1e-12) / low) / math.log(high / low)
        area = self._area()
        return float(area.left() + min(max(share, 0.0), 1.0) * area.width())

    def weight_at(self, x: float) -> float:
        """Return the lambda under a position, to three digits."""
        low, high = self._range()
        area = self._area()
        share = min(max((x - area.left()) / max(area.width(), 1.0), 0.0), 1.0)
        return float(f"{low * (high / low) ** share:.3g}")

    def mousePressEvent(self, event: QMouseEvent) -> None:  # noqa: N802 (Qt's name)
        """Choose the lambda under the mouse."""
        if len(self._curve) > 1 and event.button() == Qt.MouseButton.LeftButton:
            self.chosen.emit(self.weight_at(event.position().x()))

    def paintEvent(self, _: QPaintEvent) -> None:  # noqa: N802 (Qt's name)
        """Paint axis, curve and marks."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        ink = self.palette().color(self.foregroundRole())
        painter.setPen(ink)
        if len(self._curve) < 2:
            flags = int(Qt.AlignmentFlag.AlignCenter) | int(Qt.TextFlag.TextWordWrap)
            painter.drawText(self.rect(), flags, self.why)
            return
        area = self._area()
        self._paint_axis(painter, area)
        values = [value for _, value in self._curve]
        low, high = min(values), max(values)
        # The steep flank of too strong a prior must not flatten the minimum.
        high = min(high, low + 4.0 * max(values[0] - low, 0.02 * low))
        points = [
            QPointF(self.x_of(w), area.bottom() - (v - low) / max(high - low, 1e-9) * area.height())
            for w, v in self._curve
        ]
        dashed, solid = Qt.PenStyle.DashLine, Qt.PenStyle.SolidLine
        for weight, colour, name, style in (
            (self._automatic, AUTOMATIC, "auto", dashed),
            (self._present, PRESENT, "now", solid),
        ):
            if weight is not None:
                x = self.x_of(weight)
                painter.setPen(QPen(colour, 2, style))
                painter.drawLine(QPointF(x, area.top()), QPointF(x, area.bottom()))
                # The words stand on the outer sides of the two lines, unless there is no room.
                other = self._present if style is dashed else self._automatic
                left = x < area.right() - 40 if other is None else weight < other
                if weight == other:
                    left = style is dashed
                left = (left and x > area.left() + 40) or x > area.right() - 40
                room = QRectF(x - 63 if left else x + 3, 0.0, 60, area.top())
                side = Qt.AlignmentFlag.AlignRight if left else Qt.AlignmentFlag.AlignLeft
                painter.drawText(room, int(side | Qt.AlignmentFlag.AlignVCenter), name)
        painter.setClipRect(area.adjusted(-4, -4, 4, 4))
        painter.setPen(QPen(CURVE, 2))
        painter.drawPolyline(points)
        painter.setBrush(CURVE)
        for point in points:
            painter.drawEllipse(point, 2.5, 2.5)
        painter.end()

    def _paint_axis(self, painter: QPainter, area: QRectF) -> None:
        painter.drawLine(area.bottomLeft(), area.bottomRight())
        low, high = self._range()
        for power in range(math.ceil(math.log10(low)), math.floor(math.log10(high)) + 1):
            x = self.x_of(10.0**power)
            painter.drawLine(QPointF(x, area.bottom()), QPointF(x, area.bottom() + 3))
            room = QRectF(x - 30, area.bottom() + 2, 60, 16)
            painter.drawText(room, int(Qt.AlignmentFlag.AlignCenter), f"{10.0**power:g}")

    def _area(self) -> QRectF:
        left, top, right, bottom = MARGIN
        return QRectF(self.rect()).adjusted(left, top, -right, -bottom)

    def _range(self) -> tuple[float, float]:
        if len(self._curve) < 2:
            return 0.01, 10.0
        return self._curve[0][0] / BEYOND, self._curve[-1][0] * 1.5
