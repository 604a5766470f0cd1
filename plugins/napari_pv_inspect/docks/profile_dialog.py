"""The window that pools results of one camera into a camera profile."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from qtpy.QtCore import Qt
from qtpy.QtWidgets import (
    QAbstractItemView,
    QDialog,
    QFileDialog,
    QHBoxLayout,
    QLabel,
    QListWidget,
    QListWidgetItem,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from napari_pv_inspect.appearance import WARNING_COLOUR
from napari_pv_inspect.models.workbench import WorkbenchModel
from napari_pv_inspect.tasks.latest import LatestOnly
from napari_pv_inspect.widgets.style import set_primary
from napari_pv_inspect.widgets.wrapped_text import SentenceList
from pv_inspect.calibration.camera_profile import CameraProfile, write_profile
from pv_inspect.errors import InspectionError
from pv_inspect.results.camera_evidence import pooled_profile
from pv_inspect.results.folder import results_in

__all__ = ["PROFILE_FILES", "ProfileDialog"]

PROFILE_FILES = "Camera profile (*.toml);;All files (*)"
SIZE = (560, 460)
HINT = (
    "Results of one camera, in the order of the pictures (drag them): each counts by its own "
    "uncertainty. Those without a tick are left out."
)
NOTHING = (
    "Add results of this camera: a result folder, or a folder that holds several. A result that "
    "is open is in the list once it is saved."
)


class ProfileDialog(QDialog):
    """Lists results, shows what they say of the camera together, writes it and uses it.

    Parameters
    ----------
    model : WorkbenchModel
        Gets the notices.
    use : callable
        Gets the file of a profile that was written.
    """

    def __init__(
        self, model: WorkbenchModel, use: Callable[[Path], None], parent: QWidget | None = None
    ) -> None:
        super().__init__(parent)
        self._model, self._use = model, use
        self.profile: CameraProfile | None = None
        self.setWindowTitle("Camera profile from results")
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        hint = QLabel(HINT)
        hint.setWordWrap(True)
        self.results = QListWidget()
        self.results.setAccessibleName("Results")
        self.results.setDragDropMode(QAbstractItemView.DragDropMode.InternalMove)
        self.results.setSelectionMode(QAbstractItemView.SelectionMode.ExtendedSelection)
        self.results.setTextElideMode(Qt.TextElideMode.ElideMiddle)
        self.add_results, self.remove = QPushButton("Add..."), QPushButton("Remove")
        self.add_results.setToolTip("A result folder, or a folder that holds several of them.")
        self.remove.setToolTip("Take the selected results out of the list; nothing is deleted.")
        self.says = QLabel()
        self.says.setWordWrap(True)
        self.says.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.notes = SentenceList(WARNING_COLOUR, most_lines=8)
        self.save, self.leave = QPushButton("Save and use..."), QPushButton("Close")
        self.save.setToolTip("Write the profile; the next run takes it into account.")
        set_primary(self.save, True)
        edits, ends = QHBoxLayout(), QHBoxLayout()
        for row, buttons in ((edits, (self.add_results, self.remove)), (ends, (self.save,))):
            for button in buttons:
                row.addWidget(button)
            row.addStretch(1)
        ends.addWidget(self.leave)
        layout = QVBoxLayout(self)
        layout.addWidget(hint)
        layout.addWidget(self.results, 1)
        layout.addLayout(edits)
        layout.addWidget(self.says)
        layout.addWidget(self.notes)
        layout.addLayout(ends)
        for button in (self.add_results, self.remove, self.save, self.leave):
            button.setAutoDefault(False)
        self.resize(*SIZE)
        self._pooling = LatestOnly(
            self._show, self._on_failed, failure="The results were not pooled", delay_ms=50
        )
        self.add_results.clicked.connect(self._on_add)
        self.remove.clicked.connect(self._on_remove)
        self.save.clicked.connect(self._on_save)
        self.leave.clicked.connect(self.reject)
        self.results.itemChanged.connect(self._pool)
        self.results.model().rowsMoved.connect(self._pool)
        self._pool()

    @property
    def folders(self) -> list[Path]:
        """The results with a tick, in their order."""
        items = [self.results.item(k) for k in range(self.results.count())]
        ticked = Qt.CheckState.Checked
        return [
            item.data(Qt.ItemDataRole.UserRole) for item in items if item.checkState() == ticked
        ]

    def add(self, folder: Path) -> None:
        """Add a result, or all in a folder, that are not listed; what is wrong is a notice."""
        try:
            found = results_in(folder)
        except InspectionError as error:
            self._model.notice(str(error), is_error=True)
            return
        listed = [self.results.item(k) for k in range(self.results.count())]
        known = {item.data(Qt.ItemDataRole.UserRole).resolve() for item in listed}
        for result in found:
            if result.resolve() in known:
                continue
            item = QListWidgetItem(result.name)
            item.setToolTip(str(result))
            item.setData(Qt.ItemDataRole.UserRole, result)
            # Not droppable upon: a result that is dropped goes between two others.
            item.setFlags(item.flags() & ~Qt.ItemFlag.ItemIsDropEnabled)
            item.setCheckState(Qt.CheckState.Checked)
            self.results.addItem(item)
        self._pool()

    def write(self, path: Path) -> None:
        """Write the profile and use it; what is wrong becomes a notice."""
        if self.profile is None:
            return
        try:
            write_profile(path, self.profile)
        except InspectionError as error:
            self._model.notice(str(error), is_error=True)
            return
        self._use(path)
        self.accept()

    def done(self, result: int) -> None:
        """Close, and pool no more."""
        self._pooling.close()
        super().done(result)

    def _pool(self, *_: object) -> None:
        """Pool what is ticked, in the background."""
        self.profile = None
        self.save.setEnabled(False)
        self.notes.show_sentences(())
        folders = self.folders
        if not folders:
            self._pooling.cancel()
            self.says.setText(NOTHING)
            return
        self.says.setText("Pooling ...")
        self._pooling.ask(partial(pooled_profile, folders))

    def _show(self, profile: CameraProfile) -> None:
        self.profile = profile
        self.save.setEnabled(True)
        count = f"{profile.results} result{'s' if profile.results > 1 else ''}"
        self.says.setText("\n".join([f"Pooled from {count}:", *profile.described]))
        self.notes.show_sentences(tuple(f"{note}." for note in profile.notes))

    def _on_failed(self, error: InspectionError) -> None:
        self.says.setText("There is no profile of these results:")
        self.notes.show_sentences((str(error),))

    def _on_add(self) -> None:
        folder = QFileDialog.getExistingDirectory(self, "Result, or folder of results")
        if folder:
            self.add(Path(folder))

    def _on_remove(self) -> None:
        for item in self.results.selectedItems():
            self.results.takeItem(self.results.row(item))
        self._pool()

    def _on_save(self) -> None:
        name = QFileDialog.getSaveFileName(self, "Camera profile", "camera.toml", PROFILE_FILES)[0]
        if name:
            self.write(Path(name))
