"""A box with nothing but the form of one group of settings."""

from __future__ import annotations

from qtpy.QtWidgets import QGroupBox, QVBoxLayout, QWidget

from napari_pv_inspect.forms.form import SettingsForm
from napari_pv_inspect.models.workbench import WorkbenchModel
from pv_inspect.settings import Group

__all__ = ["FormBox"]


class FormBox(QGroupBox):
    """The settings of a group, under its name."""

    def __init__(self, model: WorkbenchModel, group: Group, parent: QWidget | None = None) -> None:
        super().__init__(group, parent)
        self.form = SettingsForm(model, group)
        layout = QVBoxLayout(self)
        layout.addWidget(self.form)
