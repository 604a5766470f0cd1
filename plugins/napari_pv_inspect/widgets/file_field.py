"""A field for one file: its name, a button to choose it and one to forget it."""

from __future__ import annotations

from pathlib import Path

from qtpy.QtCore import Signal
from qtpy.QtWidgets import QFileDialog, QHBoxLayout, QPushButton, QSizePolicy, QWidget

from napari_pv_inspect.widgets.elided import ElidedLabel

__all__ = ["FileField"]


class FileField(QWidget):
    """Chooses a file; a word stands where there is none.

    Parameters
    ----------
    title : str
        Of the dialog.
    files : str
        Which files the dialog offers.
    missing : str
        The word.
    tip, tip_of_none : str
        What the file is, and what it means to have none.
    """

    changed = Signal(object)

    def __init__(
        self,
        title: str,
        files: str,
        missing: str,
        tip: str,
        tip_of_none: str,
        parent: QWidget | None = None,
    ) -> None:
        super().__init__(parent)
        self._title, self._files, self._missing = title, files, missing
        self._path: Path | None = None
        self.name = ElidedLabel(missing)
        self.name.setMinimumWidth(40)
        self.choose, self.clear = QPushButton("..."), QPushButton("x")
        self.choose.setToolTip(f"Choose: {tip}")
        self.choose.setAccessibleName(f"{title}: choose")
        self.clear.setToolTip(tip_of_none)
        self.clear.setAccessibleName(f"{title}: none")
        layout = QHBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(4)
        layout.addWidget(self.name, 1)
        for button in (self.choose, self.clear):
            button.setFixedWidth(28)
            layout.addWidget(button)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.choose.clicked.connect(self._on_choose)
        self.clear.clicked.connect(self._on_clear)
        self.show_value(None)

    def value(self) -> Path | None:
        """Return the file, None if there is none."""
        return self._path

    def show_value(self, path: Path | None) -> None:
        """Show a file without telling that it changed."""
        self._path = path
        self.name.setText(self._missing if path is None else path.name)
        self.name.setToolTip(self._missing if path is None else str(path))
        self.clear.setEnabled(path is not None)

    def _on_choose(self) -> None:
        path = QFileDialog.getOpenFileName(self, self._title, "", self._files)[0]
        if path:
            self.show_value(Path(path))
            self.changed.emit(self._path)

    def _on_clear(self) -> None:
        self.show_value(None)
        self.changed.emit(None)
