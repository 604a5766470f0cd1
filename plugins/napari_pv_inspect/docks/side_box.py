"""Chooses what one side of a comparison shows."""

from __future__ import annotations

from collections.abc import Callable

from qtpy.QtCore import QSignalBlocker, QSize, Qt
from qtpy.QtGui import QIcon
from qtpy.QtWidgets import QComboBox, QWidget

from napari_pv_inspect.live.cell import Source
from napari_pv_inspect.models.trials import Trial

__all__ = ["SideBox"]

ICON = 24


class SideBox(QComboBox):
    """A list of sources, and below them of all trials.

    Parameters
    ----------
    *sources : Source
        The first is chosen until somebody chooses, and when what was chosen is gone.
    """

    def __init__(self, *sources: Source, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._sources = len(sources)
        for source in sources:
            self.addItem(source.value, source)
        self.setIconSize(QSize(ICON, ICON))
        self.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.setMinimumContentsLength(8)
        # The live cell has to fit into 1280 px, with the controls and the gallery beside it.
        self.setMinimumWidth(84)

    @property
    def choice(self) -> Source | int:
        """A source, or the number of a trial."""
        choice: Source | int = self.currentData()
        return choice

    def choose(self, choice: Source | int) -> None:
        """Choose without telling; what is not in the list leaves the choice as it is."""
        row = next((k for k in range(self.count()) if self.itemData(k) == choice), -1)
        if row >= 0:
            with QSignalBlocker(self):
                self.setCurrentIndex(row)

    def refill(self, trials: tuple[Trial, ...], icon: Callable[[Trial], QIcon]) -> None:
        """List other trials; the choice stays if it is among them."""
        choice = self.choice
        with QSignalBlocker(self):
            while self.count() > self._sources:
                self.removeItem(self._sources)
            if trials:
                self.insertSeparator(self._sources)
            for trial in trials:
                self.addItem(icon(trial), trial.title, trial.number)
                self.setItemData(self.count() - 1, trial.text, Qt.ItemDataRole.ToolTipRole)
            self.setCurrentIndex(0)
        self.choose(choice)
