"""The fit of all frames that follows an edit of points, once the hand rests."""

from __future__ import annotations

from functools import partial

from napari_pv_inspect.models.point_editor import PointEditor
from napari_pv_inspect.models.workbench import RunState, WorkbenchModel
from napari_pv_inspect.tasks.newest_answer import NewestAnswer
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
        self._newest = NewestAnswer(self._on_fit, REST_MS)
        self._for: Inspection | None = None
        self._editor = editor
        editor.changed.connect(self._on_edit)
        model.run_changed.connect(self._on_edit)

    @property
    def busy(self) -> bool:
        """Whether a fit is still to come."""
        return self._newest.busy

    def close(self) -> None:
        """Start no more fits."""
        self._newest.close()

    def _on_edit(self, _: object = None) -> None:
        inspection = self._model.inspection
        wanted = (
            inspection is not None
            and inspection.crossings is not None
            and inspection.crossings is self._editor.crossings
            and inspection.calibration is None
            and bool(self._editor.edits)
            and self._model.run_state is RunState.IDLE
        )
        if not wanted:
            self._for = None
            self._newest.drop()
        elif inspection is not self._for:
            assert inspection is not None
            self._for = inspection
            crossings, shape = inspection.crossings, inspection.sequence.shape
            self._newest.ask(partial(calibrate, crossings, shape, inspection.settings))

    def _on_fit(self, answer: Calibration | InspectionError) -> None:
        inspection = self._model.inspection
        if isinstance(answer, InspectionError):
            self._model.notice(str(answer), is_error=True)
        elif inspection is not None and inspection is self._for:
            self._model.revise(inspection.with_part(answer))
