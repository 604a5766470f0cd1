"""The row of steps at the top with the state of each, and the button of the next step."""

from __future__ import annotations

from qtpy.QtCore import QEvent, QPointF, QRectF, QSize, Qt, Signal
from qtpy.QtGui import QColor, QHelpEvent, QMouseEvent, QPainter, QPaintEvent, QPen, QPolygonF
from qtpy.QtWidgets import (
    QHBoxLayout,
    QPushButton,
    QSizePolicy,
    QToolTip,
    QVBoxLayout,
    QWidget,
)

from napari_pv_inspect.models.workbench import RunState, WorkbenchModel
from napari_pv_inspect.models.workflow import Status, StepAction, StepView, next_step, steps_of
from napari_pv_inspect.widgets.listen import listen
from napari_pv_inspect.widgets.style import set_primary

__all__ = ["StepLine", "StepsBox"]

COLOURS = {
    Status.DONE: "#009E73",
    Status.WORKING: "#56B4E9",
    Status.NEXT: "#56B4E9",
    Status.STALE: "#E69F00",
    Status.FAILED: "#D55E00",
    Status.DOUBTED: "#D55E00",
    Status.WAITING: "#808890",
}
RADIUS = 7.0
HEIGHT = 46


class StepLine(QWidget):
    """Draws the steps as circles on a line; their names stand above and below alternately."""

    step_clicked = Signal(str)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.steps: tuple[StepView, ...] = ()
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setToolTip("The steps from the frames to the verdicts; a click shows their controls.")

    def show_steps(self, steps: tuple[StepView, ...]) -> None:
        """Draw other steps."""
        if steps != self.steps:
            self.steps = steps
            self.setAccessibleName(", ".join(f"{s.name} {s.status.value}" for s in steps))
            self.update()

    def sizeHint(self) -> QSize:  # noqa: N802 (Qt's name)
        """Return a size that fits the narrowest dock."""
        return QSize(300, HEIGHT)

    def centre(self, k: int) -> QPointF:
        """Return the centre of one circle."""
        pitch = self.width() / max(len(self.steps), 1)
        return QPointF((k + 0.5) * pitch, HEIGHT / 2)

    def event(self, event: QEvent) -> bool:
        """Show the sentence of the step under the pointer."""
        if event.type() == QEvent.Type.ToolTip and isinstance(event, QHelpEvent) and self.steps:
            QToolTip.showText(event.globalPos(), self.steps[self._at(event.pos().x())].tip, self)
            return True
        return bool(super().event(event))

    def mousePressEvent(self, event: QMouseEvent) -> None:  # noqa: N802 (Qt's name)
        """Emit which step was clicked."""
        if self.steps:
            self.step_clicked.emit(self.steps[self._at(event.position().x())].name)

    def paintEvent(self, _: QPaintEvent) -> None:  # noqa: N802 (Qt's name)
        """Draw the line, the circles and the names."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        font = painter.font()
        font.setPointSizeF(max(6.5, font.pointSizeF() - 1.5))
        painter.setFont(font)
        if len(self.steps) > 1:
            painter.setPen(QPen(QColor(COLOURS[Status.WAITING]), 1.5))
            painter.drawLine(self.centre(0), self.centre(len(self.steps) - 1))
        pitch = self.width() / max(len(self.steps), 1)
        for k, step in enumerate(self.steps):
            self._draw_circle(painter, self.centre(k), step.status)
            plain = self.palette().text().color()
            painter.setPen(QColor(COLOURS[step.status]) if _calls(step.status) else plain)
            top = HEIGHT - 14 if k % 2 else 0
            left = min(max(self.centre(k).x() - pitch, 0.0), self.width() - 2 * pitch)
            side = Qt.AlignmentFlag.AlignHCenter
            if k == 0:
                side = Qt.AlignmentFlag.AlignLeft
            elif k == len(self.steps) - 1:
                side = Qt.AlignmentFlag.AlignRight
            painter.drawText(QRectF(left, top, 2 * pitch, 14), side, step.name)
        painter.end()

    def _draw_circle(self, painter: QPainter, middle: QPointF, status: Status) -> None:
        colour = QColor(COLOURS[status])
        hollow = status in (Status.NEXT, Status.WAITING)
        painter.setPen(QPen(colour, 2.0))
        painter.setBrush(self.palette().window().color() if hollow else colour)
        painter.drawEllipse(middle, RADIUS, RADIUS)
        # The sign tells apart what the colour may not.
        ink = colour if hollow else QColor("#101418")
        painter.setPen(QPen(ink, 2.0))
        for line in _SIGNS[status]:
            painter.drawPolyline(QPolygonF([middle + QPointF(x, y) for x, y in line]))

    def _at(self, x: float) -> int:
        pitch = self.width() / len(self.steps)
        return min(max(int(x / pitch), 0), len(self.steps) - 1)


_SIGNS: dict[Status, tuple[tuple[tuple[float, float], ...], ...]] = {
    Status.DONE: (((-3.5, 0.0), (-1.0, 3.0), (3.5, -3.0)),),
    Status.WORKING: (((-2.0, -3.5), (3.5, 0.0), (-2.0, 3.5), (-2.0, -3.5)),),
    Status.NEXT: (((-3.0, 0.0), (3.0, 0.0)), ((0.5, -2.5), (3.0, 0.0), (0.5, 2.5))),
    Status.STALE: (((0.0, -4.0), (0.0, 1.0)), ((0.0, 3.3), (0.0, 3.8))),
    Status.FAILED: (((-3.0, -3.0), (3.0, 3.0)), ((-3.0, 3.0), (3.0, -3.0))),
    # A question mark.
    Status.DOUBTED: (
        ((-2.5, -2.0), (-1.5, -4.0), (1.5, -4.0), (2.5, -2.0), (0.0, 0.3), (0.0, 1.3)),
        ((0.0, 3.6), (0.0, 4.1)),
    ),
    Status.WAITING: (),
}


def _calls(status: Status) -> bool:
    return status in (Status.NEXT, Status.WORKING, Status.STALE, Status.FAILED, Status.DOUBTED)


class StepsBox(QWidget):
    """The row of steps and the button of the next step.

    Where the next step is a run, or the end of one, the buttons of the run stand in its place:
    there is one button for one thing.

    Parameters
    ----------
    model : WorkbenchModel
    run : QPushButton
        Starts a run; stands beside the next step.
    """

    wanted = Signal(object)
    step_clicked = Signal(str)

    def __init__(
        self, model: WorkbenchModel, run: QPushButton, parent: QWidget | None = None
    ) -> None:
        super().__init__(parent)
        self._model = model
        self.line = StepLine()
        self.next = QPushButton()
        set_primary(self.next, True)
        buttons = QHBoxLayout()
        buttons.addWidget(self.next, 1)
        buttons.addWidget(run)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(3)
        layout.addWidget(self.line)
        layout.addLayout(buttons)
        self.next.clicked.connect(self._on_next)
        self.line.step_clicked.connect(self.step_clicked)
        listen(model.changed, self._on_change)
        self._on_change()

    def _on_change(self) -> None:
        self.line.show_steps(steps_of(self._model))
        step = next_step(self._model)
        self.next.setText(step.text)
        self.next.setToolTip(step.tip)
        self.next.setEnabled(step.action is not StepAction.WAIT)
        idle = self._model.run_state is RunState.IDLE
        self.next.setVisible(idle and step.action is not StepAction.RUN)

    def _on_next(self) -> None:
        self.wanted.emit(next_step(self._model).action)
