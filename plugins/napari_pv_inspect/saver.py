"""Writes result folders beside the window."""

from __future__ import annotations

import logging
from pathlib import Path

from napari.qt.threading import FunctionWorker, create_worker
from psygnal import Signal
from qtpy.QtCore import QObject, QThreadPool

from napari_pv_inspect.model import WorkbenchModel
from pv_inspect.errors import InspectionError
from pv_inspect.pipeline import Inspection
from pv_inspect.results import write_result

__all__ = ["Saver"]

log = logging.getLogger(__name__)


class Saver(QObject):
    """Writes one result at a time; closing the window waits until it is whole."""

    saved = Signal(object, object)

    def __init__(self, model: WorkbenchModel) -> None:
        super().__init__()
        self._model = model
        self._worker: FunctionWorker | None = None

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
        self._worker = create_worker(_written, inspection, folder, _start_thread=False)
        self._worker.returned.connect(self._on_return)
        self._worker.start()
        return True

    def close(self) -> None:
        """Wait for what is being written; nobody is told any more."""
        if self._worker is not None:
            self._worker.returned.disconnect(self._on_return)
            self._worker = None
            QThreadPool.globalInstance().waitForDone()

    def _on_return(self, answer: tuple[Inspection, Path, str]) -> None:
        inspection, folder, trouble = answer
        self._worker = None
        if trouble:
            self._model.notice(trouble, is_error=True)
            return
        self._model.notice(f"Saved to {folder}.")
        self.saved.emit(inspection, folder)


def _written(inspection: Inspection, folder: Path) -> tuple[Inspection, Path, str]:
    try:
        write_result(inspection, folder)
    except InspectionError as error:
        return inspection, folder, str(error)
    except Exception as error:
        log.exception("saving failed")
        return inspection, folder, f"It was not saved ({type(error).__name__}: {error})."
    return inspection, folder, ""
