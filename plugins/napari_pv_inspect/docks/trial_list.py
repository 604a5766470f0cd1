"""The trials of the tuning as thumbnails: return to one, name it, compare two."""

from __future__ import annotations

from qtpy.QtCore import QAbstractListModel, QModelIndex, QSize, Qt, Signal
from qtpy.QtGui import QFont, QGuiApplication, QIcon, QPixmap
from qtpy.QtWidgets import (
    QAbstractItemView,
    QHBoxLayout,
    QLabel,
    QListView,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from napari_pv_inspect.appearance import contrast_limits
from napari_pv_inspect.models.trials import Trial, Tuning
from napari_pv_inspect.widgets.listen import listen
from napari_pv_inspect.widgets.model_index import ModelIndex
from napari_pv_inspect.widgets.swipe_view import grey_image

__all__ = ["TrialList", "TrialModel"]

THUMBNAIL = 72


class TrialModel(QAbstractListModel):
    """The trials as a Qt list; the text is edited in place."""

    def __init__(self, tuning: Tuning) -> None:
        super().__init__()
        self._tuning = tuning
        self._trials: tuple[Trial, ...] = ()
        self._icons: dict[int, QIcon] = {}
        self.refill()

    def refill(self) -> None:
        """Take over what the tuning knows; what is selected stays selected."""
        new, old = self._tuning.trials, self._trials
        if [t.number for t in new[: len(old)]] == [t.number for t in old]:
            if len(new) > len(old):
                self.beginInsertRows(QModelIndex(), len(old), len(new) - 1)
                self._trials = new
                self.endInsertRows()
            self._trials = new
            if new:
                self.dataChanged.emit(self.index(0), self.index(len(new) - 1))
        else:
            self.beginResetModel()
            self._trials = new
            self.endResetModel()
        known = {trial.number for trial in new}
        self._icons = {number: icon for number, icon in self._icons.items() if number in known}

    def trial(self, index: ModelIndex) -> Trial:
        """Return the trial at an index."""
        return self._trials[index.row()]

    def rowCount(self, _: ModelIndex | None = None) -> int:  # noqa: N802 (Qt's name)
        """Count the trials."""
        return len(self._trials)

    def flags(self, index: ModelIndex) -> Qt.ItemFlag:
        """Every trial can be named."""
        return super().flags(index) | Qt.ItemFlag.ItemIsEditable

    def data(self, index: ModelIndex, role: int = Qt.ItemDataRole.DisplayRole) -> object:
        """Return title, thumbnail, tooltip; the current one is bold."""
        if not index.isValid():
            return None
        trial = self.trial(index)
        if role in (Qt.ItemDataRole.DisplayRole, Qt.ItemDataRole.EditRole):
            return trial.title
        if role == Qt.ItemDataRole.DecorationRole:
            return self.icon(trial)
        if role == Qt.ItemDataRole.FontRole and trial is self._tuning.current:
            font = QFont()
            font.setBold(True)
            return font
        if role == Qt.ItemDataRole.ToolTipRole:
            row, col = trial.picture.cell
            return f"{trial.text}: {trial.picture.caption}; row {row + 1}, column {col + 1}"
        return None

    def setData(  # noqa: N802 (Qt's name)
        self, index: ModelIndex, value: object, role: int = Qt.ItemDataRole.EditRole
    ) -> bool:
        """Name a trial."""
        if role != Qt.ItemDataRole.EditRole or not index.isValid():
            return False
        trial = self.trial(index)
        if str(value) != trial.title:
            self._tuning.rename(trial, str(value))
        return True

    def icon(self, trial: Trial) -> QIcon:
        """Return the thumbnail of a trial."""
        if trial.number not in self._icons:
            image = grey_image(trial.picture.image, contrast_limits(trial.picture.image))
            app = QGuiApplication.instance()
            ratio = app.devicePixelRatio() if isinstance(app, QGuiApplication) else 1.0
            scaled = image.scaled(
                round(THUMBNAIL * ratio),
                round(THUMBNAIL * ratio),
                Qt.AspectRatioMode.KeepAspectRatio,
                Qt.TransformationMode.SmoothTransformation,
            )
            scaled.setDevicePixelRatio(ratio)
            self._icons[trial.number] = QIcon(QPixmap.fromImage(scaled))
        return self._icons[trial.number]


class TrialList(QWidget):
    """List of the trials with what can be done with them."""

    chosen = Signal()

    def __init__(self, tuning: Tuning, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._tuning = tuning
        self.trials = TrialModel(tuning)
        self.view = QListView()
        self.view.setModel(self.trials)
        self.view.setViewMode(QListView.ViewMode.IconMode)
        self.view.setResizeMode(QListView.ResizeMode.Adjust)
        self.view.setMovement(QListView.Movement.Static)
        self.view.setWordWrap(True)
        self.view.setIconSize(QSize(THUMBNAIL, THUMBNAIL))
        self.view.setGridSize(QSize(THUMBNAIL + 34, THUMBNAIL + 40))
        self.view.setMinimumHeight(THUMBNAIL + 46)
        self.view.setSelectionMode(QAbstractItemView.SelectionMode.ExtendedSelection)
        self.view.setEditTriggers(QAbstractItemView.EditTrigger.EditKeyPressed)
        self.view.setToolTip(
            "One picture per setting that was tried, kept with the result. Double-click: return to "
            "it. One selected: compared with the live cell; two (Ctrl + click): with each other."
        )
        self.back = QPushButton("Return")
        self.back.setToolTip("Set the controls as they were then (Ctrl+Z takes it back).")
        self.name = QPushButton("Name")
        self.name.setToolTip("Give the selected trial a name (F2).")
        bar = QHBoxLayout()
        bar.addWidget(QLabel("Tried so far"), 1)
        bar.addWidget(self.back)
        bar.addWidget(self.name)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addLayout(bar)
        layout.addWidget(self.view, 1)
        self.view.doubleClicked.connect(self._on_return)
        self.back.clicked.connect(self._on_return)
        self.name.clicked.connect(self._on_name)
        self.view.selectionModel().selectionChanged.connect(self._on_selection)
        listen(tuning.changed, self._on_trials)
        self._enable()

    @property
    def selected(self) -> tuple[Trial, ...]:
        """The selected trials, at most two of them: the one tried first comes first."""
        rows = sorted(self.view.selectedIndexes(), key=QModelIndex.row)
        return tuple(self.trials.trial(index) for index in rows[:2])

    def _on_trials(self) -> None:
        self.trials.refill()
        self._enable()
        self.view.scrollToBottom()

    def _on_selection(self, *_: object) -> None:
        self._enable()
        self.chosen.emit()

    def _enable(self) -> None:
        count = len(self.view.selectedIndexes())
        self.back.setEnabled(count == 1)
        self.name.setEnabled(count == 1)

    def _on_return(self, _: object = None) -> None:
        if self.selected:
            self._tuning.restore(self.selected[0])

    def _on_name(self) -> None:
        if indexes := self.view.selectedIndexes():
            self.view.edit(indexes[0])
