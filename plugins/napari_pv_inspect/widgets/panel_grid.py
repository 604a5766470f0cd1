"""One picture large, the others small beside it."""

from __future__ import annotations

from collections.abc import Sequence

from qtpy.QtCore import QRect, QSize, Signal
from qtpy.QtGui import QResizeEvent
from qtpy.QtWidgets import QWidget

from napari_pv_inspect.widgets.image_panels import TITLE, Panel

__all__ = ["PanelGrid", "areas"]

GAP = 3
# Least part of the room that the column of small pictures takes.
LEAST_SHARE = 0.18


def areas(width: int, height: int, aspect: float, n_small: int) -> tuple[QRect, list[QRect]]:
    """Divide a room among one large picture and some small ones.

    Parameters
    ----------
    width, height : int
        Of the room, px.
    aspect : float
        Width of a picture over its height.
    n_small : int

    Returns
    -------
    (QRect, list of QRect)
        Of the large one, and of the small ones: right of it, or below it in a high room.
    """
    if width < height:
        large, small = areas(height, width, 1 / aspect, n_small)
        return _turned(large), [_turned(area) for area in small]
    spare = width - GAP - round((height - TITLE) * aspect)
    side = max(spare, round(LEAST_SHARE * width))

    def room(columns: int) -> tuple[int, int]:
        """Width and height of a small one."""
        rows = -(-n_small // columns)
        return (side - (columns - 1) * GAP) // columns, (height - (rows - 1) * GAP) // rows

    def size(columns: int) -> float:
        across, down = room(columns)
        return min(across, (down - TITLE) * aspect)

    columns = max(range(1, n_small + 1), key=size)
    across, down = room(columns)
    # No wider than its picture: what is left goes to the large one.
    across = min(across, max(round((down - TITLE) * aspect), 1))
    left = width - columns * across - (columns - 1) * GAP
    small = [
        QRect(left + (k % columns) * (across + GAP), (k // columns) * (down + GAP), across, down)
        for k in range(n_small)
    ]
    return QRect(0, 0, left - GAP, height), small


class PanelGrid(QWidget):
    """Lays out panels; a click on a small one makes it the large one.

    Parameters
    ----------
    panels : sequence of Panel
        The first one begins large.
    """

    changed = Signal()

    def __init__(self, panels: Sequence[Panel]) -> None:
        super().__init__()
        self._panels = tuple(panels)
        self._aspect = 1.0
        self.large = self._panels[0]
        for k, panel in enumerate(self._panels):
            panel.setParent(self)
            panel.number = k + 1
            panel.clicked.connect(self._on_click)

    def sizeHint(self) -> QSize:  # noqa: N802 (Qt's name)
        """Room in which a cell can be judged."""
        return QSize(760, 520)

    def minimumSizeHint(self) -> QSize:  # noqa: N802 (Qt's name)
        """Room in which it can be seen at all."""
        return QSize(300, 160)

    def enlarge(self, number: int) -> None:
        """Show a panel large, counted from 1."""
        self.large = self._panels[number - 1]
        self._arrange()
        self.changed.emit()

    def show_aspect(self, aspect: float) -> None:
        """Make room for pictures of this width over height."""
        if aspect != self._aspect:
            self._aspect = aspect
            self._arrange()

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802 (Qt's name)
        """Lay out again."""
        super().resizeEvent(event)
        self._arrange()

    def _on_click(self, panel: Panel) -> None:
        if panel is not self.large:
            self.enlarge(panel.number)

    def _arrange(self) -> None:
        small = [panel for panel in self._panels if panel is not self.large]
        room, rooms = areas(self.width(), self.height(), self._aspect, len(small))
        self.large.setGeometry(room)
        for panel, area in zip(small, rooms, strict=True):
            panel.setGeometry(area)


def _turned(area: QRect) -> QRect:
    return QRect(area.y(), area.x(), area.height(), area.width())
