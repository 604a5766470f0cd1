"""Calibrates all frames again after an edit of points."""

from __future__ import annotations

from functools import partial

from napari_pv_inspect.models.point_editor import PointEditor
from napari_pv_inspect.models.workbench import RunState, WorkbenchModel
from napari_pv_inspect.tasks.latest import LatestOnly
from pv_inspect.calibration.calibrate import Calibration, calibrate
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection

__all__ = ["Recalibration"]

REST_MS = 300


class Recalibration:
    """Fits camera and poses to the edited points in a thread and enters them into the inspection.

    The settings are those of the inspection: what the controls say now is for the next run.
    """

    def __init__(self, model: WorkbenchModel, editor: PointEditor) -> None:
        self._model = model
        self._latest = LatestOnly(self._on_fit, self._on_failure, delay_ms=REST_MS)
        self._for: Inspection | None = None
        self._editor = editor
        editor.changed.connect(self._on_edit)
        model.run_changed.connect(self._on_edit)

    @property
    def busy(self) -> bool:
        """Whether a fit is still to come."""
        return self._latest.busy

    def close(self) -> None:
        """Start no more fits."""
        self._latest.close()

    def _on_edit(self, _: object = None) -> None:
        inspection = self._model.inspection
        crossings = None if inspection is None else inspection.crossings
        if (
            inspection is None
            or crossings is None
            or crossings is not self._editor.crossings
            or inspection.calibration is not None
            or not self._editor.edits
            or self._model.run_state is not RunState.IDLE
        ):
            self._for = None
            self._latest.cancel()
        elif inspection is not self._for:
            self._for = inspection
            shape, settings = inspection.frames.shape, inspection.settings
            self._latest.ask(partial(calibrate, crossings, shape, settings))

    def _on_fit(self, fit: Calibration) -> None:
        inspection = self._model.inspection
        if inspection is not None and inspection is self._for:
            self._model.revise(inspection.with_part(fit))

    def _on_failure(self, error: InspectionError) -> None:
        self._model.notice(str(error), is_error=True)
