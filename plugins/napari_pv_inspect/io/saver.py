"""Writes result folders in the background."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from napari.qt.threading import FunctionWorker, create_worker
from psygnal import Signal
from qtpy.QtCore import QObject, QThreadPool

from napari_pv_inspect.models.workbench import WorkbenchModel
from napari_pv_inspect.tasks.guard import attempt
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.results.write import write_result

__all__ = ["Saver"]


# What was written, where to, and what went wrong, in a sentence.
Answer = tuple[Inspection, Path, str]


class Saver(QObject):
    """Writes one result at a time; closing the window waits until it is whole."""

    saved = Signal(object, object)

    def __init__(self, model: WorkbenchModel) -> None:
        super().__init__()
        self._model = model
        self._worker: FunctionWorker | None = None
        self._answer: Answer | None = None

    @property
    def busy(self) -> bool:
        """Whether a result is being written."""
        return self._worker is not None

    def save(self, inspection: Inspection, folder: Path) -> bool:
        """Start to write; False if another result is still being written."""
        if self.busy:
            self._model.notice("The last result is still being written: save again in a moment.")
            return False
        self._model.notice(f"Saving to {folder} ...")
        self._answer = None
        self._worker = create_worker(self._write, inspection, folder, _start_thread=False)
        self._worker.returned.connect(self._on_return)
        self._worker.start()
        return True

    def close(self) -> tuple[Inspection, Path] | None:
        """Wait for what is being written; `saved` is not emitted any more.

        Returns
        -------
        (Inspection, Path) or None
            What was written, and where.
        """
        if self._worker is None:
            return None
        self._worker.returned.disconnect(self._on_return)
        self._worker = None
        QThreadPool.globalInstance().waitForDone()
        answer = self._answer
        return None if answer is None or answer[2] else answer[:2]

    def _write(self, inspection: Inspection, folder: Path) -> Answer:
        answer = self._answer = _written(inspection, folder)
        return answer

    def _on_return(self, answer: Answer) -> None:
        inspection, folder, trouble = answer
        self._worker = None
        if trouble:
            self._model.notice(trouble, is_error=True)
            return
        self._model.notice(f"Saved to {folder}.")
        self.saved.emit(inspection, folder)


def _written(inspection: Inspection, folder: Path) -> Answer:
    written = attempt(partial(write_result, inspection, folder), "It was not saved")
    return inspection, folder, str(written) if isinstance(written, InspectionError) else ""
