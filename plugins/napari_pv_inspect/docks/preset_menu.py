"""The button *Presets*: settings of the page by name."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from qtpy.QtWidgets import (
    QFileDialog,
    QInputDialog,
    QMenu,
    QMessageBox,
    QPushButton,
    QSizePolicy,
    QWidget,
)

from napari_pv_inspect.models.presets import PRESET_FIELDS, PresetStore, read_preset, write_preset
from napari_pv_inspect.models.trials import Tuning
from napari_pv_inspect.models.workbench import WorkbenchModel
from pv_inspect.errors import InspectionError
from pv_inspect.settings import Settings

__all__ = ["PresetMenu"]

AUTOMATIC = "Automatic"
FILES = "Settings (*.toml)"


class PresetMenu(QPushButton):
    """Applies, saves and deletes presets; whatever is wrong with one becomes a notice.

    Parameters
    ----------
    model : WorkbenchModel
    tuning : Tuning
        To apply a preset is one edit.
    """

    def __init__(
        self, model: WorkbenchModel, tuning: Tuning, parent: QWidget | None = None
    ) -> None:
        super().__init__("Presets", parent)
        self.model = model
        self.tuning = tuning
        self.store = PresetStore()
        self.setToolTip(
            "Settings of this page by name, for all modules: apply one, save those shown now, or "
            "go back to what is found automatically. The module's own settings stay."
        )
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        menu = QMenu(self)
        menu.setToolTipsVisible(True)
        menu.aboutToShow.connect(self.refill)
        self._delete = QMenu("Delete", menu)  # `clear` would leave one behind each time
        self.setMenu(menu)

    def refill(self) -> None:
        """List what there is; a mark stands at what the controls show."""
        menu = self.menu()
        menu.clear()
        self._add(menu, AUTOMATIC, "Everything as it comes: lambda and blur found from the frames.")
        names = self.store.names()
        if names:
            menu.addSeparator()
        for name in names:
            self._add(menu, name, "Take these settings over (Ctrl+Z takes it back).")
        menu.addSeparator()
        save = menu.addAction("Save as...", self.ask_to_keep)
        save.setToolTip("Keep the settings of this page under a name.")
        menu.addMenu(self._delete)
        self._delete.clear()
        self._delete.setEnabled(bool(names))
        for name in names:
            self._delete.addAction(_shown(name), partial(self.ask_to_remove, name))
        menu.addSeparator()
        load = menu.addAction("Load from file...", self._on_load)
        load.setToolTip("Take the settings of this page from a file.")
        export = menu.addAction("Save to file...", self._on_export)
        export.setToolTip("Write the settings of this page into a file, for other people.")

    def apply(self, name: str) -> None:
        """Take a preset over as one edit."""
        try:
            preset = Settings() if name == AUTOMATIC else self.store.read(name)
        except InspectionError as error:
            self.model.notice(str(error), is_error=True)
        else:
            self.tuning.apply(preset, PRESET_FIELDS, f"Preset {name}")
            self.model.notice(f"Preset {name} applied.")

    def keep(self, name: str) -> None:
        """Save the settings under a name."""
        try:
            if name.strip().casefold() == AUTOMATIC.casefold():
                raise InspectionError(f"{AUTOMATIC} is there already: choose another name.")
            name = self.store.save(name, self.model.settings)
        except InspectionError as error:
            self.model.notice(str(error), is_error=True)
        else:
            self.model.notice(f"Preset {name} saved.")

    def remove(self, name: str) -> None:
        """Delete a preset."""
        try:
            self.store.delete(name)
        except InspectionError as error:
            self.model.notice(str(error), is_error=True)
        else:
            self.model.notice(f"Preset {name} deleted.")

    def load(self, path: Path) -> None:
        """Take the settings in a file over as one edit."""
        try:
            preset = read_preset(path)
        except InspectionError as error:
            self.model.notice(str(error), is_error=True)
        else:
            self.tuning.apply(preset, PRESET_FIELDS, f"Load preset {path.stem}")
            self.model.notice(f"Preset {path.stem} loaded.")

    def export(self, path: Path) -> None:
        """Write the settings into a file."""
        path = path if path.suffix else path.with_suffix(".toml")
        try:
            write_preset(self.model.settings, path)
        except InspectionError as error:
            self.model.notice(str(error), is_error=True)
        else:
            self.model.notice(f"Preset saved to {path}.")

    def _add(self, menu: QMenu, name: str, tip: str) -> None:
        action = menu.addAction(_shown(name), partial(self.apply, name))
        action.setToolTip(tip)
        action.setCheckable(True)
        action.setChecked(self._is_shown(name))

    def _is_shown(self, name: str) -> bool:
        try:
            preset = Settings() if name == AUTOMATIC else self.store.read(name)
        except InspectionError:
            return False
        now = self.model.settings
        return all(getattr(preset, field) == getattr(now, field) for field in PRESET_FIELDS)

    def ask_to_keep(self) -> None:
        """Ask for a name and save the settings under it."""
        name, given = QInputDialog.getText(self, "Save preset", "Name of the preset:")
        if not given:
            return
        old = self.store.known(name)
        if old is not None:
            answer = QMessageBox.question(self, "Save preset", f"Replace the preset {old!r}?")
            if answer != QMessageBox.StandardButton.Yes:
                return
        self.keep(name)

    def ask_to_remove(self, name: str) -> None:
        """Ask whether to delete a preset, and do so."""
        answer = QMessageBox.question(self, "Delete preset", f"Delete the preset {name!r}?")
        if answer == QMessageBox.StandardButton.Yes:
            self.remove(name)

    def _on_load(self) -> None:
        path = QFileDialog.getOpenFileName(self, "Preset", "", FILES)[0]
        if path:
            self.load(Path(path))

    def _on_export(self) -> None:
        path = QFileDialog.getSaveFileName(self, "Preset", "preset.toml", FILES)[0]
        if path:
            self.export(Path(path))


def _shown(name: str) -> str:
    # Qt takes one "&" for the mark of a key.
    return name.replace("&", "&&")
