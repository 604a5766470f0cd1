"""The dock *Cells*: every cell as a thumbnail with its verdict; keys judge the selected one."""

from __future__ import annotations

from collections.abc import Iterable

from napari.components import ViewerModel
from qtpy.QtCore import QEvent, QModelIndex, QSignalBlocker, QSize, Qt, QTimer, Signal
from qtpy.QtGui import QFocusEvent, QKeyEvent, QPainter, QPaintEvent, QResizeEvent
from qtpy.QtWidgets import (
    QCheckBox,
    QComboBox,
    QLabel,
    QListView,
    QSlider,
    QVBoxLayout,
    QWidget,
)

from napari_pv_inspect.appearance import WARNING_COLOUR
from napari_pv_inspect.docks.gallery_list import GAP, CellList, TileDelegate, cell_text
from napari_pv_inspect.docks.large_cell import large_cell, open_cell
from napari_pv_inspect.docks.review_keys import bind_review_keys
from napari_pv_inspect.models.footer import capitalised
from napari_pv_inspect.models.workbench import WorkbenchModel
from napari_pv_inspect.review.data import ReviewChange
from napari_pv_inspect.review.listing import EVERY
from napari_pv_inspect.review.model import ReviewModel
from napari_pv_inspect.review.subject import Subject
from napari_pv_inspect.widgets.folding_bar import FoldingBar
from napari_pv_inspect.widgets.listen import listen
from napari_pv_inspect.widgets.shortcuts import Key
from napari_pv_inspect.widgets.style import ThemedStyle
from napari_pv_inspect.workbench import Workbench
from pv_inspect.cracks import CellState
from pv_inspect.review import Cell, Order, VerdictKind

__all__ = ["BY_CRACKS", "BY_POSITION", "CellsDock"]

PLACE = "Row / column of the cell, from the top left."
BY_POSITION, BY_CRACKS, BY_VERDICT = "by position", "by crack score", "by verdict"
DISPUTED = "raters differ"
ORDERS = {
    BY_POSITION: Order.POSITION,
    BY_CRACKS: Order.CRACK_SCORE,
    BY_VERDICT: Order.VERDICT,
}
FILTERS: dict[str, tuple[VerdictKind | None, ...]] = {
    "all": EVERY,
    "not judged": (None,),
    "judged": tuple(VerdictKind),
    **{kind.label: (kind,) for kind in VerdictKind},
    DISPUTED: EVERY,
}
STATES = dict(enumerate(CellState, len(FILTERS) + 1))
"""Place of the filters by what the detector says, after those by verdict and a line between."""


# Width of a thumbnail, px: it fits the columns of the module if they may be as small or large.
LEAST_PX, MOST_PX = 64, 180
# Height that the gallery begins with, part of the window.
SHARE = 0.33


class CellsDock(QWidget):
    """Gallery of all cells of the module."""

    filled = Signal()

    def __init__(self, napari_viewer: ViewerModel) -> None:
        super().__init__()
        self._workbench = Workbench.of(napari_viewer)
        self._workbench.has_gallery = True
        self._style = ThemedStyle(self, self._workbench.viewer)
        self.cells = CellList(self._review)
        self.delegate = TileDelegate(self._review, self.cells)
        self._sizing = QTimer(self)
        self._sizing.setSingleShot(True)
        self._sizing.setInterval(60)
        self._sizing.timeout.connect(self.fit)
        self.view = _view(self.cells, self.delegate)
        self.order = _combo(
            ORDERS,
            "Order of the cells: as in the module, highest crack score or worst verdict first.",
        )
        self.filter = _combo(
            {**FILTERS, **{state.value: () for state in CellState}},
            "Show only cells with this verdict of yours, those about which raters differ, or those "
            "of which the detector says this.",
        )
        self.filter.insertSeparator(len(FILTERS))
        for k, state in STATES.items():
            self.filter.setItemData(k, state.meaning, Qt.ItemDataRole.ToolTipRole)
        self.opacity = _slider(75, "Opacity of the crack marks, percent; 0 hides them.")
        self.threshold = _slider(
            50, "Crack probability, percent, from which pixels are painted; measures nothing."
        )
        self.zoom = _slider(
            0, "Width of a thumbnail; at the left end a row is a row of the module."
        )
        self.zoom.setMaximum(MOST_PX)
        self.large = QCheckBox("Large")
        self.large.setChecked(True)
        self.large.setToolTip(
            "A click or an arrow key shows the cell large, in place of frames and module image; "
            "else the view moves there."
        )
        self.counts = QLabel()
        self.counts.setWordWrap(True)
        self.counts.setStyleSheet(f"color: {WARNING_COLOUR}")
        self.caption = QLabel(PLACE)
        self.caption.setWordWrap(True)
        self.bar = FoldingBar(
            (QLabel("Order"), self.order, QLabel("Show"), self.filter, self.large),
            (
                *(QLabel("Cracks"), self.opacity),
                *(QLabel("from"), self.threshold),
                *(QLabel("Size"), self.zoom),
            ),
        )
        layout = QVBoxLayout(self)
        layout.setContentsMargins(4, 4, 4, 4)
        layout.addWidget(self.bar)
        layout.addWidget(self.counts)
        layout.addWidget(self.view, 1)
        # Below, so that no tile moves under the mouse when it goes.
        layout.addWidget(self.caption)
        self.order.currentTextChanged.connect(self._on_order)
        self.filter.currentIndexChanged.connect(self._on_filter)
        self.opacity.valueChanged.connect(self._on_opacity)
        self.threshold.valueChanged.connect(self._on_threshold)
        self.view.selectionModel().currentChanged.connect(self._on_current)
        self.zoom.valueChanged.connect(self._sizing.start)
        self.view.clicked.connect(self._on_click)
        self.view.moved_by_key.connect(self._on_key_move)
        self.view.resized.connect(self._sizing.start)
        self.view.doubleClicked.connect(self.open_cell)
        bind_review_keys(self._workbench, self, "Gallery")
        if self._workbench.shortcuts is not None:
            key = Key("Return", "Open the selected cell large", "Gallery")
            self._workbench.shortcuts.add(key, self.open_cell, within=self)
            key = Key("Esc", "Back to the module", "Gallery")
            self._workbench.shortcuts.add(key, self._to_module, within=self)
        if (place := large_cell(self._workbench)) is not None:
            place.toggled.connect(self._on_large)
        listen(self._review.data.subject_changed, self._on_subject)
        listen(self._review.listing.changed, self._on_listing)
        listen(self._review.data.changed, self._on_review)
        listen(self._review.data.threshold_changed, self._on_threshold_changed)
        listen(self._model.cell_selected, self._on_selected)
        self._on_subject(self._review.data.subject)

    @property
    def _model(self) -> WorkbenchModel:
        return self._workbench.model

    @property
    def _review(self) -> ReviewModel:
        return self._workbench.review.state

    def open_cell(self, _: object = None) -> None:
        """Show the selected cell large, without the gallery."""
        if self._model.selected_cell is None:
            self._workbench.review.step(0)
        open_cell(self._workbench)

    def sizeHint(self) -> QSize:  # noqa: N802 (Qt's name)
        """Two rows on a small screen; most of it belongs to the pictures above."""
        return QSize(600, round(SHARE * self.window().height()))

    def event(self, event: QEvent) -> bool:
        """Paint thumbnails anew on a screen of another density."""
        if event.type() == QEvent.Type.DevicePixelRatioChange:
            self.cells.show_subject(self.devicePixelRatioF())
        return super().event(event)

    def _on_subject(self, subject: Subject | None) -> None:
        self.cells.show_subject(self.devicePixelRatioF())
        self.view.message = self._review.data.why_empty if subject is None else ""
        self.view.viewport().update()
        self.fit()
        # The height of the tiles may be another one.
        self.view.setGridSize(self.delegate.tile())
        self._on_threshold_changed(self._review.data.threshold)
        self._count()
        self._mark(self._model.selected_cell)
        if subject is not None:
            self.filled.emit()

    def _on_listing(self) -> None:
        self._show_list(self.cells.relist())

    def _on_review(self, change: ReviewChange) -> None:
        self._show_list(self.cells.follow(change))

    def _show_list(self, is_another: bool) -> None:
        if is_another:
            self._mark(self._model.selected_cell)
        else:
            self._caption()

    def _on_order(self, text: str) -> None:
        self._review.listing.set_order(ORDERS[text])

    def _on_filter(self, k: int) -> None:
        if k in STATES:
            self._review.listing.set_filter(EVERY, states=(STATES[k],))
        elif (text := self.filter.itemText(k)) in FILTERS:
            self._review.listing.set_filter(FILTERS[text], text == DISPUTED)

    def _count(self) -> None:
        """Say how many cells are of each state."""
        counts = self._review.cells.counts
        for k, state in STATES.items():
            number = "" if counts is None else f" ({counts[state]})"
            self.filter.setItemText(k, f"{state.value}{number}")
        self.counts.setText("" if counts is None else capitalised(counts.text))
        self.counts.setVisible(counts is not None and counts.unjudged_text != "")

    def _on_opacity(self, percent: int) -> None:
        self.cells.set_opacity(percent / 100)

    def _on_threshold(self, percent: int) -> None:
        self._review.data.set_threshold(percent / 100)

    def _on_threshold_changed(self, threshold: float) -> None:
        with QSignalBlocker(self.threshold):
            self.threshold.setValue(round(100 * threshold))
        self.cells.paint_anew()

    def _on_current(self, index: QModelIndex, _: object = None) -> None:
        if index.isValid():
            self._model.select_cell(self.cells.cell(index))

    def _on_click(self, index: QModelIndex) -> None:
        # The camera comes back also to the cell that is selected already.
        self._on_current(index)
        self._workbench.navigator.to_cell(*self.cells.cell(index))
        self._on_key_move()

    def _on_key_move(self) -> None:
        if self.large.isChecked():
            open_cell(self._workbench, alone=False)

    def _on_large(self, is_open: bool) -> None:
        # The facts stand under the large cell then.
        self.caption.setVisible(not is_open)

    def _to_module(self) -> None:
        if (place := large_cell(self._workbench)) is not None:
            place.back()
        self.view.setFocus()

    def fit(self) -> None:
        """Give thumbnails the size that the slider says, or one that fits the module."""
        subject, width = self._review.data.subject, self.zoom.value()
        if subject is None:
            return
        if width < LEAST_PX // 2:
            room = self.view.viewport().width() - 2
            width = min(max(room // subject.tiles.grid.layout.cols - GAP, LEAST_PX), MOST_PX)
        if width != self.cells.thumbnail.width():
            self.cells.resize(width)
            self.view.setGridSize(self.delegate.tile())
            self._mark(self._model.selected_cell)

    def _on_selected(self, cell: Cell | None) -> None:
        self._mark(cell)
        if cell is not None:
            self._workbench.navigator.to_cell(*cell)

    def _mark(self, cell: Cell | None) -> None:
        """Mark the selected cell; the camera stays where the user looks."""
        index = self.cells.index_of(cell)
        self.view.elsewhere = cell is not None and not index.isValid()
        if index != self.view.currentIndex():
            with QSignalBlocker(self.view.selectionModel()):
                self.view.setCurrentIndex(index)
            self.view.viewport().update()
        if index.isValid():
            self.view.scrollTo(index)
        self._caption()

    def _caption(self) -> None:
        cell = self._model.selected_cell
        if cell is None or self._review.data.subject is None:
            self.caption.setText(PLACE)
            return
        self.caption.setText("  |  ".join(cell_text(self._review, cell).splitlines()))


class _Gallery(QListView):
    """A list that selects nothing by getting the focus while the selected cell is not listed.

    Qt takes the first one: the next verdict would be about that.

    Attributes
    ----------
    message : str
        Painted when there are no cells.
    """

    elsewhere = False
    message = ""
    moved_by_key = Signal()
    resized = Signal()

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802 (Qt's name)
        """Tell when a key has gone to another cell."""
        before = self.currentIndex()
        super().keyPressEvent(event)
        if self.currentIndex() != before:
            self.moved_by_key.emit()

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802 (Qt's name)
        """Tell it."""
        super().resizeEvent(event)
        self.resized.emit()

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802 (Qt's name)
        """Paint the cells, or why there are none."""
        super().paintEvent(event)
        if not self.message:
            return
        painter = QPainter(self.viewport())
        painter.setPen(self.palette().color(self.foregroundRole()))
        flags = int(Qt.AlignmentFlag.AlignCenter) | int(Qt.TextFlag.TextWordWrap)
        painter.drawText(self.viewport().rect().adjusted(12, 12, -12, -12), flags, self.message)
        painter.end()

    def focusInEvent(self, event: QFocusEvent) -> None:  # noqa: N802 (Qt's name)
        """Show that keys go here."""
        if not self.elsewhere:
            super().focusInEvent(event)
            return
        with QSignalBlocker(self.selectionModel()):
            super().focusInEvent(event)
            self.setCurrentIndex(QModelIndex())


def _view(cells: CellList, delegate: TileDelegate) -> _Gallery:
    view = _Gallery()
    view.setModel(cells)
    view.setItemDelegate(delegate)
    view.setViewMode(QListView.ViewMode.IconMode)
    view.setResizeMode(QListView.ResizeMode.Adjust)
    view.setMovement(QListView.Movement.Static)
    view.setUniformItemSizes(True)
    view.setGridSize(delegate.tile())
    # A scroll bar that comes and goes would change the size of the thumbnails.
    view.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOn)
    view.setToolTip(
        "A click or the arrow keys show a cell large, a letter judges it; Enter or a double click "
        "folds the gallery as well."
    )
    return view


def _combo(entries: Iterable[str], tip: str) -> QComboBox:
    combo = QComboBox()
    combo.addItems([*entries])
    combo.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToContents)
    combo.setToolTip(tip)
    return combo


def _slider(percent: int, tip: str) -> QSlider:
    slider = QSlider(Qt.Orientation.Horizontal)
    slider.setRange(0, 100)
    slider.setValue(percent)
    slider.setFixedWidth(90)
    slider.setToolTip(tip)
    return slider
