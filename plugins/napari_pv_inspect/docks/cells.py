"""The dock *Cells*: every cell as a thumbnail; a click shows it large in the module image."""

from __future__ import annotations

import numpy as np
from napari.components import ViewerModel
from qtpy.QtCore import QAbstractListModel, QModelIndex, QSize, Qt, Signal
from qtpy.QtGui import QIcon, QImage, QPixmap
from qtpy.QtWidgets import (
    QCheckBox,
    QComboBox,
    QHBoxLayout,
    QLabel,
    QListView,
    QSizePolicy,
    QVBoxLayout,
    QWidget,
)

from napari_pv_inspect.docks.listen import listen
from napari_pv_inspect.model import WorkbenchModel
from napari_pv_inspect.sources import result_cells
from napari_pv_inspect.thumbnails import cell_pictures
from napari_pv_inspect.workbench import Workbench
from pv_inspect.cells import CellTiles
from pv_inspect.cracks import CellFeatures, CrackMap
from pv_inspect.pipeline import Inspection
from pv_inspect.results import Result

__all__ = ["CellList", "CellsDock"]

THUMBNAIL = 92
MARK_OPACITY = 0.75
BY_POSITION, BY_CRACKS = "by position", "by crack score"


class CellList(QAbstractListModel):
    """The cells of an inspection as a Qt list: picture, name, features."""

    def __init__(self) -> None:
        super().__init__()
        self._icons: dict[tuple[int, int], QIcon] = {}
        self._features: dict[tuple[int, int], CellFeatures] = {}
        self._order: list[tuple[int, int]] = []

    def show(
        self, tiles: CellTiles | None, cracks: CrackMap | None, marked: bool, order: str
    ) -> None:
        """Fill the list from cell tiles and a crack map."""
        self.beginResetModel()
        self._icons, self._features = {}, {}
        if tiles is not None:
            opacity = MARK_OPACITY if marked else 0.0
            pictures = cell_pictures(tiles, cracks, opacity)
            self._icons = {
                (r, c): _icon(pictures[r, c]) for r, c in np.ndindex(*pictures.shape[:2])
            }
            if cracks is not None:
                self._features = {(f.row, f.col): f for f in cracks.cells}
        self._order = sorted(self._icons)
        if order == BY_CRACKS:
            self._order.sort(key=self._score, reverse=True)
        self.endResetModel()

    def cell(self, index: QModelIndex) -> tuple[int, int]:
        """Row and column of the cell at an index, from 0."""
        return self._order[index.row()]

    def rowCount(self, _: QModelIndex | None = None) -> int:  # noqa: N802 (Qt's name)
        """Count the cells."""
        return len(self._order)

    def data(self, index: QModelIndex, role: int = Qt.ItemDataRole.DisplayRole) -> object:
        """Return picture, name or tooltip of a cell."""
        if not index.isValid():
            return None
        place = self._order[index.row()]
        if role == Qt.ItemDataRole.DisplayRole:
            return f"{place[0] + 1} / {place[1] + 1}"
        if role == Qt.ItemDataRole.DecorationRole:
            return self._icons[place]
        if role == Qt.ItemDataRole.ToolTipRole:
            return _tooltip(place, self._features.get(place))
        return None

    def _score(self, place: tuple[int, int]) -> float:
        features = self._features.get(place)
        return 0.0 if features is None else features.crack_score


class CellsDock(QWidget):
    """Gallery of all cells of the module."""

    filled = Signal()

    def __init__(self, napari_viewer: ViewerModel) -> None:
        super().__init__()
        self._bench = Workbench.of(napari_viewer)
        self._bench.has_gallery = True
        self._shown: tuple[object, ...] = ()
        self.cells = CellList()
        self.view = QListView()
        self.view.setModel(self.cells)
        self.view.setViewMode(QListView.ViewMode.IconMode)
        self.view.setResizeMode(QListView.ResizeMode.Adjust)
        self.view.setMovement(QListView.Movement.Static)
        self.view.setUniformItemSizes(True)
        self.view.setIconSize(QSize(THUMBNAIL, THUMBNAIL))
        self.view.setGridSize(QSize(THUMBNAIL + 10, THUMBNAIL + 24))
        self.view.setToolTip("A click, or the arrow keys, show a cell large.")
        self.order = QComboBox()
        self.order.addItems([BY_POSITION, BY_CRACKS])
        self.order.setToolTip("Order of the cells: as in the module, or suspicious ones first.")
        self.marked = QCheckBox("mark cracks")
        self.marked.setChecked(True)
        self.marked.setToolTip("Paint what passes the crack threshold in orange.")
        self.caption = QLabel("Row / column of the cell, from the top left.")
        # A long caption is cut off, it does not widen the dock.
        self.caption.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        bar = QHBoxLayout()
        bar.addWidget(QLabel("Order"))
        bar.addWidget(self.order)
        bar.addWidget(self.marked)
        bar.addWidget(self.caption, 1)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(4, 4, 4, 4)
        layout.addLayout(bar)
        layout.addWidget(self.view, 1)
        self.order.currentTextChanged.connect(self._refill)
        self.marked.toggled.connect(self._refill)
        self.view.selectionModel().currentChanged.connect(self._on_cell)
        self.view.clicked.connect(self._on_cell)
        listen(self._model.inspection_changed, self._on_inspection)
        listen(self._model.result_opened, self._on_result)
        self._on_inspection(self._model.shown)

    @property
    def _model(self) -> WorkbenchModel:
        return self._bench.model

    def _on_inspection(self, inspection: Inspection | None) -> None:
        parts = () if inspection is None else (inspection.tiles, inspection.cracks)
        if parts and (parts[0] is None or _same(parts, self._shown)):
            # While a run works on new cells the old ones stay.
            return
        self._shown = parts
        self._refill()
        if parts:
            self.filled.emit()

    def _on_result(self, _: Result) -> None:
        self._refill()
        self.filled.emit()

    def _refill(self, _: object = None) -> None:
        shown, result = self._model.shown, self._model.result
        tiles, cracks = (None, None) if shown is None else (shown.tiles, shown.cracks)
        if tiles is None and result is not None:
            tiles, cracks = result_cells(result)
        self.cells.show(tiles, cracks, self.marked.isChecked(), self.order.currentText())

    def _on_cell(self, index: QModelIndex, _: object = None) -> None:
        if not index.isValid():
            return
        place = self.cells.cell(index)
        self._model.select_cell(place)
        self._bench.navigator.to_cell(*place)
        self.caption.setText(self.cells.data(index, Qt.ItemDataRole.ToolTipRole))


def _same(a: tuple[object, ...], b: tuple[object, ...]) -> bool:
    return len(a) == len(b) and all(x is y for x, y in zip(a, b, strict=True))


def _icon(picture: np.ndarray) -> QIcon:
    picture = np.ascontiguousarray(picture)
    height, width = picture.shape[:2]
    image = QImage(picture.data, width, height, 3 * width, QImage.Format.Format_RGB888)
    scaled = image.scaled(
        THUMBNAIL,
        THUMBNAIL,
        Qt.AspectRatioMode.KeepAspectRatio,
        Qt.TransformationMode.SmoothTransformation,
    )
    return QIcon(QPixmap.fromImage(scaled))


def _tooltip(place: tuple[int, int], features: CellFeatures | None) -> str:
    text = f"Row {place[0] + 1}, column {place[1] + 1}"
    if features is None:
        return text
    return (
        f"{text}: crack length {features.crack_length_cells:.2f} cell widths in "
        f"{features.crack_instances} pieces, dark area {features.dark_area_share:.0%}, "
        f"mean intensity {features.mean_intensity:.3f} of full scale"
    )
