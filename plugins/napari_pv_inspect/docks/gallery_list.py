"""The cells of a module as a Qt list, and how one of them is painted."""

from __future__ import annotations

import numpy as np
from qtpy.QtCore import QAbstractListModel, QModelIndex, QRect, QSize, Qt
from qtpy.QtGui import QColor, QImage, QPainter, QPen, QPixmap
from qtpy.QtWidgets import QStyle, QStyledItemDelegate, QStyleOptionViewItem

from napari_pv_inspect.review.data import ReviewChange
from napari_pv_inspect.review.model import ReviewModel
from napari_pv_inspect.review.thumbnails import Thumbnails
from napari_pv_inspect.widgets.model_index import ModelIndex
from pv_inspect.cracks import CellState
from pv_inspect.cracks.wording import tooltip
from pv_inspect.review import Cell, Verdict, VerdictKind

__all__ = ["BAR", "GAP", "CellList", "TileDelegate", "cell_text", "text_colour_on"]

BAR = 16
GAP = 6
CELL_ROLE = Qt.ItemDataRole.UserRole


class CellList(QAbstractListModel):
    """The listed cells: picture, name, verdict, features.

    Attributes
    ----------
    thumbnail : QSize
        Of a picture, logical pixels.
    """

    def __init__(self, review: ReviewModel) -> None:
        super().__init__()
        self._review = review
        self.thumbnail = QSize(92, 92)
        self._order: tuple[Cell, ...] = ()
        self._thumbnails: Thumbnails | None = None
        self._pictures: dict[Cell, QPixmap] = {}
        self._opacity = 0.75
        self._ratio = 1.0

    def show_subject(self, ratio: float) -> None:
        """Show the cells of another subject; ``ratio``: device pixels per pixel of the screen."""
        self._ratio = ratio
        self.resize(self.thumbnail.width())
        self.relist()

    def resize(self, width: int) -> None:
        """Paint pictures of another width."""
        subject = self._review.data.subject
        self._pictures.clear()
        self._thumbnails = None
        self.thumbnail = QSize(width, width)
        if subject is not None:
            rows, cols = np.max([subject.tiles.shape(*cell) for cell in subject.places], axis=0)
            self.thumbnail.setHeight(max(round(width * rows / cols), 1))
            longest = max(self.thumbnail.width(), self.thumbnail.height())
            self._thumbnails = Thumbnails(subject, round(longest * self._ratio))

    def relist(self) -> bool:
        """List the cells again; returns whether the list is another one."""
        order = self._review.listing.cells
        if order == self._order:
            self.repaint()
            return False
        self.beginResetModel()
        self._order = order
        self.endResetModel()
        return True

    def repaint(self) -> None:
        """Show other verdicts of the same cells."""
        if self._order:
            self.dataChanged.emit(self.index(0), self.index(len(self._order) - 1))

    def set_opacity(self, opacity: float) -> None:
        """Paint cracks more or less opaque, 0 to 1."""
        self._opacity = opacity
        self.paint_anew()

    def paint_anew(self) -> None:
        """Paint the pictures of all cells anew."""
        self._pictures.clear()
        self.repaint()

    def follow(self, change: ReviewChange) -> bool:
        """Show a change of the review; returns whether the list is another one."""
        if change.all_marks:
            self._pictures.clear()
        for cell in change.marks:
            self._pictures.pop(cell, None)
        if change.verdicts:
            return self.relist()
        self.repaint()
        return False

    def cell(self, index: ModelIndex) -> Cell:
        """Row and column of the cell at an index, from 0."""
        return self._order[index.row()]

    def index_of(self, cell: Cell | None) -> QModelIndex:
        """Index of a cell; an invalid one if it is not listed."""
        return self.index(self._order.index(cell)) if cell in self._order else QModelIndex()

    def rowCount(self, _: ModelIndex | None = None) -> int:  # noqa: N802 (Qt's name)
        """Count the cells."""
        return len(self._order)

    def data(self, index: ModelIndex, role: int = Qt.ItemDataRole.DisplayRole) -> object:
        """Return picture, name, place or tooltip of a cell."""
        if not index.isValid():
            return None
        cell = self._order[index.row()]
        if role == Qt.ItemDataRole.DisplayRole:
            return f"{cell[0] + 1} / {cell[1] + 1}"
        if role == Qt.ItemDataRole.DecorationRole:
            return self.picture(cell)
        if role == Qt.ItemDataRole.ToolTipRole:
            return cell_text(self._review, cell)
        if role == CELL_ROLE:
            return cell
        return None

    def picture(self, cell: Cell) -> QPixmap | None:
        """Thumbnail of a cell with its marks; None without a subject."""
        if self._thumbnails is None:
            return None
        if cell not in self._pictures:
            mask = self._review.cells.correction(cell)
            threshold = self._review.data.threshold
            painted = self._thumbnails.picture(cell, threshold, self._opacity, mask)
            self._pictures[cell] = _pixmap(painted, self._ratio)
        return self._pictures[cell]


class TileDelegate(QStyledItemDelegate):
    """Paints picture, place, verdict of the rater and marks of the other raters."""

    def __init__(self, review: ReviewModel, cells: CellList) -> None:
        super().__init__()
        self._review, self._cells = review, cells

    def tile(self) -> QSize:
        """Size of a tile with its bar and the gap to the next one."""
        return self._cells.thumbnail + QSize(GAP, BAR + GAP)

    def sizeHint(self, _: QStyleOptionViewItem, __: ModelIndex) -> QSize:  # noqa: N802
        """Size of a tile with its bar."""
        return self.tile()

    def paint(self, painter: QPainter, option: QStyleOptionViewItem, index: ModelIndex) -> None:
        """Paint a tile."""
        cell = index.data(CELL_ROLE)
        picture = index.data(Qt.ItemDataRole.DecorationRole)
        if cell is None or picture is None:
            return
        painter.save()
        area = option.rect.adjusted(GAP // 2, GAP // 2, -(GAP // 2), -(GAP // 2))
        size = picture.deviceIndependentSize().toSize()
        room = self._cells.thumbnail
        left = area.left() + (room.width() - size.width()) // 2
        painter.drawPixmap(left, area.top(), picture)
        bar = QRect(area.left(), area.top() + room.height(), room.width(), BAR)
        self._paint_bar(painter, bar, cell, option)
        for k, verdict in enumerate(self._review.cells.others(cell)[:5]):
            _paint_other(painter, area.right() - 13 - 14 * k, area.top() + 2, verdict)
        state = self._review.cells.state_of(cell)
        if state in _BADGES:
            _paint_badge(painter, area.left() + 2, area.top() + 2, _BADGES[state])
        if self._review.cells.is_disputed(cell):
            _paint_disputed(painter, QRect(area.left(), area.top(), room.width(), room.height()))
        if option.state & QStyle.StateFlag.State_Selected:
            painter.setPen(QPen(option.palette.text().color(), 2))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRect(area.adjusted(-1, -1, 1, 1))
        painter.restore()

    def _paint_bar(
        self, painter: QPainter, bar: QRect, cell: Cell, option: QStyleOptionViewItem
    ) -> None:
        verdict = self._review.cells.verdict(cell)
        name = f"{cell[0] + 1} / {cell[1] + 1}"
        font = painter.font()
        font.setPixelSize(11)
        painter.setFont(font)
        if verdict is None:
            painter.setPen(option.palette.text().color())
            painter.drawText(bar, Qt.AlignmentFlag.AlignCenter, name)
            return
        colour = QColor(verdict.kind.colour)
        pending = self._review.cells.is_pending(cell)
        painter.fillRect(bar, colour)
        if pending:  # hatched until it is stored
            painter.fillRect(bar, Qt.BrushStyle.BDiagPattern)
        painter.setPen(text_colour_on(colour))
        text = f"{name}  {_SHORT.get(verdict.kind, verdict.kind.label)}"
        painter.drawText(bar, Qt.AlignmentFlag.AlignCenter, text)


# What a tile says of cells that are neither suspected nor clean, and on which colour.
_BADGES = {CellState.UNDECIDABLE: ("?", "#E69F00"), CellState.DARK: ("dark", "#B0B8C0")}
_SHORT = {VerdictKind.INACTIVE: "inactive", VerdictKind.FINGER: "finger"}


def cell_text(review: ReviewModel, cell: Cell) -> str:
    """Everything about a cell: features, verdicts, notes."""
    features = review.cells.features(cell)
    place = f"Row {cell[0] + 1}, column {cell[1] + 1}"
    lines = [place if features is None else tooltip(features)]
    if review.cells.correction(cell) is not None:
        lines.append("marks: corrected")
    mine = review.cells.verdict(cell)
    for verdict in [*([mine] if mine else []), *review.cells.others(cell)]:
        note = f" ({verdict.note})" if verdict.note else ""
        state = ", not stored yet" if verdict is mine and review.cells.is_pending(cell) else ""
        lines.append(f"{verdict.rater}: {verdict.kind.label}{note}{state}")
    if review.cells.is_disputed(cell):
        lines.append("the raters differ")
    return "\n".join(lines)


def text_colour_on(colour: QColor) -> QColor:
    """Black or white, whichever is read better on a colour."""
    light = 0.299 * colour.red() + 0.587 * colour.green() + 0.114 * colour.blue()
    return QColor("black" if light > 110 else "white")


def _paint_badge(painter: QPainter, x: int, y: int, badge: tuple[str, str]) -> None:
    """A word in the upper left corner, in a box that is seen on bright and on dark cells."""
    text, colour = badge
    font = painter.font()
    font.setPixelSize(11)
    font.setBold(True)
    painter.setFont(font)
    box = QRect(x, y, painter.fontMetrics().horizontalAdvance(text) + 8, 15)
    painter.fillRect(box, QColor(colour))
    painter.setPen(QColor("black"))
    painter.drawRect(box)
    painter.drawText(box, Qt.AlignmentFlag.AlignCenter, text)
    font.setBold(False)
    painter.setFont(font)


def _paint_other(painter: QPainter, x: int, y: int, verdict: Verdict) -> None:
    box = QRect(x, y, 12, 12)
    colour = QColor(verdict.kind.colour)
    painter.fillRect(box, colour)
    painter.setPen(QColor("black"))
    painter.drawRect(box)
    font = painter.font()
    font.setPixelSize(9)
    painter.setFont(font)
    painter.setPen(text_colour_on(colour))
    painter.drawText(box, Qt.AlignmentFlag.AlignCenter, verdict.kind.key.upper())


def _paint_disputed(painter: QPainter, area: QRect) -> None:
    """A dashed frame, seen on bright and on dark cells: the raters differ."""
    painter.setBrush(Qt.BrushStyle.NoBrush)
    for colour, style in (("black", Qt.PenStyle.SolidLine), ("white", Qt.PenStyle.DashLine)):
        painter.setPen(QPen(QColor(colour), 3, style))
        painter.drawRect(area.adjusted(2, 2, -2, -2))


def _pixmap(picture: np.ndarray, ratio: float) -> QPixmap:
    picture = np.ascontiguousarray(picture)
    height, width = picture.shape[:2]
    image = QImage(picture.data, width, height, 3 * width, QImage.Format.Format_RGB888)
    pixmap = QPixmap.fromImage(image.copy())
    pixmap.setDevicePixelRatio(ratio)
    return pixmap
