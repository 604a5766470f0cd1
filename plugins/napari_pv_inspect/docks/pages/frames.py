"""The list of frames: how well each fits, and a tick that says whether it is used."""

from __future__ import annotations

import math

from qtpy.QtCore import (
    QAbstractTableModel,
    QModelIndex,
    QSortFilterProxyModel,
    Qt,
    QTimer,
    Signal,
)
from qtpy.QtGui import QColor
from qtpy.QtWidgets import (
    QAbstractItemView,
    QHeaderView,
    QLabel,
    QSizePolicy,
    QTableView,
    QVBoxLayout,
    QWidget,
)

from napari_pv_inspect.models.frame_table import FrameRow, frame_rows, ticked
from napari_pv_inspect.models.history import Action
from napari_pv_inspect.widgets.listen import listen
from napari_pv_inspect.widgets.model_index import ModelIndex
from napari_pv_inspect.workbench import Workbench

__all__ = ["FrameTable", "FramesBox"]

COLUMNS = {
    "Frame": "File of the frame. The tick says whether the next run uses it.",
    "Grid": "Distance of the measured crossing points from the fitted grid (RMS). Unit: LR px.",
    "Residual": "Frame against the finished module image. Unit: noise; 1 is ideal.",
    "Blur": "Length of the motion blur during the exposure. Unit: LR px.",
    "Status": "Used, or why not.",
}
NAME, GRID, RESIDUAL, BLUR, STATUS = range(len(COLUMNS))
TICK_TIP = (
    "Take the tick away to leave this frame out; set it at a rejected frame to use it nevertheless "
    "(that helps only where its grid was found)."
)
REJECTED, LEFT_OUT = QColor("#D55E00"), QColor("#808890")
TICKS = """
QTableView::indicator { width: 11px; height: 11px; border: 1px solid #A0A8B0; }
QTableView::indicator:checked { background: #56B4E9; }
"""
SORT_ROLE = Qt.ItemDataRole.UserRole


class FrameTable(QAbstractTableModel):
    """The rows of `frame_rows` for Qt."""

    tick_wanted = Signal(int, bool)

    def __init__(self) -> None:
        super().__init__()
        self.rows: tuple[FrameRow, ...] = ()

    def show_rows(self, rows: tuple[FrameRow, ...]) -> None:
        """Show other rows; selection and scroll position stay where the frames are the same."""
        if [row.name for row in rows] != [row.name for row in self.rows]:
            self.beginResetModel()
            self.rows = rows
            self.endResetModel()
        elif repr(rows) != repr(self.rows):  # NaN differs from itself
            self.rows = rows
            self.dataChanged.emit(self.index(0, 0), self.index(len(rows) - 1, STATUS))

    def rowCount(self, _: ModelIndex | None = None) -> int:  # noqa: N802 (Qt's name)
        """Count the frames."""
        return len(self.rows)

    def columnCount(self, _: ModelIndex | None = None) -> int:  # noqa: N802 (Qt's name)
        """Count the columns."""
        return len(COLUMNS)

    def headerData(  # noqa: N802 (Qt's name)
        self,
        section: int,
        orientation: Qt.Orientation,
        role: int = Qt.ItemDataRole.DisplayRole,
    ) -> object:
        """Return title or tooltip of a column."""
        if orientation is Qt.Orientation.Horizontal:
            title = list(COLUMNS)[section]
            if role == Qt.ItemDataRole.DisplayRole:
                return title
            if role == Qt.ItemDataRole.ToolTipRole:
                return COLUMNS[title]
        return None

    def flags(self, index: ModelIndex) -> Qt.ItemFlag:
        """Allow a tick beside the name."""
        flags = Qt.ItemFlag.ItemIsEnabled | Qt.ItemFlag.ItemIsSelectable
        return flags | Qt.ItemFlag.ItemIsUserCheckable if index.column() == NAME else flags

    def data(self, index: ModelIndex, role: int = Qt.ItemDataRole.DisplayRole) -> object:
        """Return what a place of the table shows."""
        if not index.isValid():
            return None
        row, column = self.rows[index.row()], index.column()
        if role == Qt.ItemDataRole.CheckStateRole and column == NAME:
            return Qt.CheckState.Checked if row.wanted else Qt.CheckState.Unchecked
        number = {GRID: row.grid_px, RESIDUAL: row.residual, BLUR: row.motion_px}.get(column)
        if role == Qt.ItemDataRole.DisplayRole:
            if column == GRID and shows_reason(row):
                return row.status
            if number is not None:
                return f"{number:.2f}" if math.isfinite(number) else ""
            if column == STATUS and shows_reason(row):
                return ""  # it stands in the place of the numbers
            return row.name if column == NAME else row.status
        if role == SORT_ROLE:
            if number is not None:
                return number if math.isfinite(number) else math.inf
            return index.row() if column == NAME else row.status
        if role == Qt.ItemDataRole.ToolTipRole:
            return f"{row.name}: {row.status or 'nothing known yet'}\n{TICK_TIP}"
        if role == Qt.ItemDataRole.ForegroundRole and not row.wanted:
            return REJECTED if row.used is False and column in (GRID, STATUS) else LEFT_OUT
        if role == Qt.ItemDataRole.TextAlignmentRole and column == GRID and shows_reason(row):
            return Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter
        if role == Qt.ItemDataRole.TextAlignmentRole and number is not None:
            return Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
        return None

    def setData(  # noqa: N802 (Qt's name)
        self, index: ModelIndex, value: object, role: int = Qt.ItemDataRole.EditRole
    ) -> bool:
        """Pass a tick on; the table changes with the settings."""
        if role != Qt.ItemDataRole.CheckStateRole or index.column() != NAME:
            return False
        self.tick_wanted.emit(index.row(), Qt.CheckState(value) == Qt.CheckState.Checked)
        return True


def shows_reason(row: FrameRow) -> bool:
    """Whether the status of a frame takes the place of its numbers, wrapped over several lines."""
    return row.used is False


class FramesBox(QWidget):
    """The table of all frames; its row and the time slider go together."""

    def __init__(self, workbench: Workbench, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._workbench = workbench
        self.table = FrameTable()
        self.sorted = QSortFilterProxyModel()
        self.sorted.setSourceModel(self.table)
        self.sorted.setSortRole(SORT_ROLE)
        self.view = QTableView()
        self.view.setModel(self.sorted)
        self.view.setSortingEnabled(True)
        self.view.sortByColumn(NAME, Qt.SortOrder.AscendingOrder)
        self.view.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.view.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        self.view.verticalHeader().hide()
        self.view.verticalHeader().setDefaultSectionSize(20)
        self.view.setMinimumHeight(150)
        self.view.setWordWrap(True)
        # The tab key goes on to the next control, not from place to place.
        self.view.setTabKeyNavigation(False)
        self.view.setAccessibleName("Frames")
        # Names of frames differ at their ends.
        self.view.setTextElideMode(Qt.TextElideMode.ElideMiddle)
        self.view.setToolTip("A click or the arrow keys go to a frame, the space bar ticks it.")
        header = self.view.horizontalHeader()
        header.setSectionResizeMode(QHeaderView.ResizeMode.Interactive)
        header.setStretchLastSection(True)
        header.setMinimumSectionSize(30)
        header.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        self.view.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.view.setStyleSheet(TICKS)
        self.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Expanding)
        for column, width in ((NAME, 112), (GRID, 36), (RESIDUAL, 62), (BLUR, 36)):
            self.view.setColumnWidth(column, width)
        self._wrapping = QTimer(self)
        self._wrapping.setSingleShot(True)
        self._wrapping.setInterval(0)
        self._wrapping.timeout.connect(self._wrap)
        self.summary = QLabel()
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.summary)
        layout.addWidget(self.view, 1)
        self.table.tick_wanted.connect(self._on_tick)
        self.view.selectionModel().currentRowChanged.connect(self._on_row)
        header.sectionResized.connect(self._wrap_soon)
        self.sorted.layoutChanged.connect(self._wrap_soon)
        model = workbench.model
        listen(model.changed, self._refill)
        listen(workbench.frames.frame_shown, self._on_frame)
        self._refill()

    def _refill(self) -> None:
        model = self._workbench.model
        rows = frame_rows(model.sequence, model.shown, model.settings)
        self.table.show_rows(rows)
        used = [row.used for row in rows]
        if None in used or not rows:
            self.summary.setText(f"{len(rows)} frames" if rows else "No frames.")
        else:
            self.summary.setText(f"{sum(map(bool, used))} of {len(rows)} frames used")
        self._wrap()
        self._on_frame(self._workbench.frames.frame)

    def _wrap_soon(self, *_: object) -> None:
        self._wrapping.start()

    def _wrap(self) -> None:
        """Give the reason of each frame that is not used all the room that it needs."""
        self.view.clearSpans()
        usual = self.view.verticalHeader().defaultSectionSize()
        for k in range(self.sorted.rowCount()):
            row = self.table.rows[self.sorted.mapToSource(self.sorted.index(k, NAME)).row()]
            if shows_reason(row):
                self.view.setSpan(k, GRID, 1, len(COLUMNS) - GRID)
                self.view.resizeRowToContents(k)
            elif self.view.rowHeight(k) != usual:
                self.view.setRowHeight(k, usual)

    def _on_tick(self, frame: int, wanted: bool) -> None:
        model, row = self._workbench.model, self.table.rows[frame]
        before = model.settings
        after = ticked(before, row, wanted)

        def put(skip: tuple[str, ...], keep: tuple[str, ...]) -> None:
            model.change_settings(skip_frames=skip, keep_frames=keep)

        self._workbench.history.perform(
            Action(
                f"{'Use' if wanted else 'Leave out'} {row.name}",
                lambda: put(after.skip_frames, after.keep_frames),
                lambda: put(before.skip_frames, before.keep_frames),
            )
        )

    def _on_row(self, index: QModelIndex, _: QModelIndex) -> None:
        if index.isValid():
            self._workbench.frames.show(self.sorted.mapToSource(index).row())

    def _on_frame(self, frame: int) -> None:
        index = self.sorted.mapFromSource(self.table.index(frame, NAME))
        if index.isValid() and index.row() != self.view.currentIndex().row():
            self.view.setCurrentIndex(index)
