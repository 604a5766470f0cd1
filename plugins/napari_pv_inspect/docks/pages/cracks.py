"""How cracks are found: detector and threshold."""

from __future__ import annotations

from qtpy.QtWidgets import QGroupBox, QVBoxLayout, QWidget

from napari_pv_inspect.forms.form import SettingsForm
from napari_pv_inspect.models.workbench import WorkbenchModel
from pv_inspect.cracks import detector_of, operating_point_of
from pv_inspect.errors import InspectionError
from pv_inspect.settings import Group

__all__ = ["CracksBox"]


class CracksBox(QGroupBox):
    """The form of the cracks; the next run uses it."""

    def __init__(self, model: WorkbenchModel, parent: QWidget | None = None) -> None:
        super().__init__(Group.CRACKS, parent)
        self._model = model
        self.form = SettingsForm(model, Group.CRACKS, self._stand_ins)
        layout = QVBoxLayout(self)
        layout.addWidget(self.form)

    def _stand_ins(self) -> dict[str, float | None]:
        settings = self._model.settings
        if settings.crack_threshold is not None:
            return {}
        try:
            point = operating_point_of(detector_of(settings), settings)
        except InspectionError:  # its model is missing: the run says so
            return {}
        return {"crack_threshold": point.threshold}
