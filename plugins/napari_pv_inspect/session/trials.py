"""Keeps the trials of the tuning in the result folder, and brings them back with it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from qtpy.QtCore import QObject, QTimer, Signal

from napari_pv_inspect.models.cell_picture import CellPicture
from napari_pv_inspect.models.trials import Trial, Tuning
from napari_pv_inspect.models.workbench import WorkbenchModel
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.results.trials import KeptTrial, read_trials, write_trials

__all__ = ["TrialStore"]

DELAY_MS = 500


class TrialStore(QObject):
    """Writes the trials beside the open result soon after each change, in a thread.

    Attributes
    ----------
    folder : Path or None
        The result folder that belongs to what is open; None: it was not saved yet.
    """

    _failed = Signal(str)

    def __init__(self, model: WorkbenchModel, tuning: Tuning) -> None:
        super().__init__()
        self._model = model
        self._tuning = tuning
        # One thread: what was asked for last is written last.
        self._thread = ThreadPoolExecutor(1, "trials")
        self._due: tuple[Trial, ...] = ()
        self._kept: tuple[Trial, ...] = ()
        # What is known of the file; only the thread looks at it once it runs.
        self._base: tuple[KeptTrial, ...] | None = None
        self._frames = ""
        self._complained = False
        self.folder: Path | None = None
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._timer.setInterval(DELAY_MS)
        self._timer.timeout.connect(self.write)
        self._failed.connect(self._on_failure)
        model.sequence_changed.connect(self._on_sequence)
        tuning.changed.connect(self._on_trials)

    def attach(self, folder: Path) -> None:
        """Keep the trials beside a result that was just saved; those so far go with it."""
        self.write()  # what is due belongs to the folder before as well
        if folder != self.folder:
            self._thread.submit(self._set_base, None)
        self.folder, self._kept, self._complained = folder, (), False
        self._on_trials()

    def resume(self, result: Inspection) -> None:
        """Bring the trials of a result back; what is wrong with them becomes a notice."""
        assert result.stored is not None
        self.folder, self._complained = result.stored.folder, False
        try:
            kept = read_trials(self.folder)
        except InspectionError as error:
            self._model.notice(str(error), is_error=True)
            self._thread.submit(self._set_base, ())
            return
        self._thread.submit(self._set_base, kept)
        layout = result.layout
        self._kept = tuple(
            Trial(
                trial.number,
                trial.settings,
                CellPicture(trial.image, trial.cell, trial.caption, trial.settings),
                trial.text,
                trial.name,
            )
            for trial in kept
            # Another module may lie in the folder by now.
            if 0 <= trial.cell[0] < layout.rows and 0 <= trial.cell[1] < layout.cols
        )
        self._tuning.continue_from(self._kept)

    def wait(self) -> None:
        """Wait until all that was begun is written."""
        self._thread.submit(int).result()

    def close(self) -> None:
        """Write what is not written yet, and wait for it."""
        self.write()
        self.folder = None
        self._thread.shutdown()

    def _on_trials(self) -> None:
        # No trials: another sequence is coming. What was kept of this one stays.
        trials = self._tuning.trials
        if self.folder is not None and trials and trials != self._kept:
            self._due = trials
            sequence = self._model.sequence
            self._frames = "" if sequence is None else str(sequence.source.resolve())
            self._timer.start()

    def _on_sequence(self, _: object) -> None:
        self.write()
        self.folder, self._kept = None, ()

    def write(self) -> None:
        """Begin to write what is not written yet."""
        self._timer.stop()
        due, self._due = self._due, ()
        if due and self.folder is not None:
            self._kept = due
            self._thread.submit(self._written, due, self.folder, self._frames)

    def _set_base(self, base: tuple[KeptTrial, ...] | None) -> None:
        self._base = base

    def _written(self, trials: tuple[Trial, ...], folder: Path, frames: str) -> None:
        kept = tuple(
            KeptTrial(
                trial.number,
                trial.settings,
                trial.picture.image,
                trial.picture.cell,
                trial.picture.caption,
                trial.text,
                trial.name,
                frames,
            )
            for trial in trials
        )
        try:
            replaced = write_trials(kept, folder, self._base)
        except InspectionError as error:
            self._failed.emit(str(error))
            return
        self._base = kept
        if replaced:
            self._failed.emit(
                f"{replaced} settings tried on other frames lay in {folder}: they were replaced."
            )

    def _on_failure(self, text: str) -> None:
        # Once is enough: nobody loses more than the list.
        if not self._complained and self.folder is not None:
            self._complained = True
            self._model.notice(text, is_error=True)
