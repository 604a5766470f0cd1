"""The residual over kappa as a small drawing: the optimum and the slider's place in it."""

from __future__ import annotations

import numpy as np
from qtpy.QtCore import QPointF, QSize, Qt
from qtpy.QtGui import QColor, QPainter, QPaintEvent, QPalette, QPen, QPolygonF
from qtpy.QtWidgets import QSizePolicy, QWidget

from napari_pv_inspect import appearance as look
from napari_pv_inspect.live.kappa_curve import Curve

__all__ = ["CurveView"]

LEFT, RIGHT, TOP, BOTTOM = 46, 8, 8, 18


class CurveView(QWidget):
    """Draws a `Curve`; a line with a triangle marks the fit, a dashed line the slider."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._curve: Curve | None = None
        self._kappa: float | None = None
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setToolTip(
            "RMS distance of the crossing points from the grid [LR px] over kappa. The triangle "
            "marks the fit, the dashed line the slider. A flat curve: these frames hardly tell "
            "kappa."
        )

    def sizeHint(self) -> QSize:  # noqa: N802 (Qt's name)
        """Small: it stands below the slider."""
        return QSize(220, 68)

    @property
    def kappa(self) -> float | None:
        """Where the slider stands."""
        return self._kappa

    @property
    def curve(self) -> Curve | None:
        """What is drawn."""
        return self._curve

    def show_curve(self, curve: Curve | None) -> None:
        """Draw another curve, or none."""
        self._curve = curve
        self.update()

    def mark(self, kappa: float | None) -> None:
        """Mark the place of the slider."""
        if kappa != self._kappa:
            self._kappa = kappa
            self.update()

    def paintEvent(self, _: QPaintEvent) -> None:  # noqa: N802 (Qt's name)
        """Axes, curve, marks."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        text = self.palette().color(QPalette.ColorRole.WindowText)
        faint = QColor(text)
        faint.setAlphaF(0.35)
        font = painter.font()
        font.setPointSizeF(max(6.5, 0.8 * font.pointSizeF()))
        painter.setFont(font)
        curve = self._curve
        if curve is None or not np.isfinite(curve.rms_px).any():
            painter.setPen(faint)
            painter.drawText(
                self.rect(), Qt.AlignmentFlag.AlignCenter, "distance over kappa: after the fit"
            )
            return
        width, height = self.width() - LEFT - RIGHT, self.height() - TOP - BOTTOM
        low, high = float(curve.kappas[0]), float(curve.kappas[-1])
        # Noise of a flat curve must not fill the height.
        top = 1.1 * max(float(np.nanmax(curve.rms_px)), 0.1)

        def place(kappa: float, rms: float) -> QPointF:
            x = (min(max(kappa, low), high) - low) / (high - low)
            return QPointF(LEFT + x * width, TOP + (1.0 - rms / top) * height)

        painter.setPen(faint)
        painter.drawLine(place(low, 0.0), place(high, 0.0))
        painter.drawLine(place(low, 0.0), place(low, top))
        painter.setPen(text)
        right = Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
        painter.drawText(0, TOP - 6, LEFT - 4, 12, right, f"{top:.1f} px")
        painter.drawText(0, TOP + height - 11, LEFT - 4, 12, right, "0")
        for kappa in (low, 0.0, high):
            x = int(place(kappa, 0.0).x())
            centre = Qt.AlignmentFlag.AlignHCenter | Qt.AlignmentFlag.AlignTop
            painter.drawText(
                min(x - 20, self.width() - 40), TOP + height + 2, 40, 14, centre, f"{kappa:g}"
            )
        known = np.isfinite(curve.rms_px)
        line = [place(k, r) for k, r in zip(curve.kappas[known], curve.rms_px[known], strict=True)]
        painter.setPen(QPen(QColor(look.GRID_COLOUR), 1.8))
        painter.drawPolyline(QPolygonF(line))
        best = place(curve.best, curve.at(curve.best))
        painter.setBrush(QColor(look.MEASURED_COLOUR))
        painter.setPen(Qt.PenStyle.NoPen)
        painter.drawPolygon(
            QPolygonF([best, best + QPointF(-4.5, -8.0), best + QPointF(4.5, -8.0)])
        )
        if self._kappa is not None:
            painter.setPen(QPen(QColor(look.PREDICTED_COLOUR), 1.4, Qt.PenStyle.DashLine))
            painter.drawLine(place(self._kappa, 0.0), place(self._kappa, top))
