"""Opens paths in the background: frames, result folders, and frames once more in another way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from psygnal import Signal
from qtpy.QtCore import QObject

from napari_pv_inspect import reader
from napari_pv_inspect.layers.layer_data import open_sequence
from napari_pv_inspect.models.workbench import WorkbenchModel
from napari_pv_inspect.tasks.latest import LatestOnly
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.results.read import read_result
from pv_inspect.results.resume import reopen, resume
from pv_inspect.sequence.lock_in import lock_in_sentence
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from pv_inspect.storage.folders import read_steadily

__all__ = ["Opened", "Opener", "open_any", "open_result"]


Reading = tuple[Path | None, Path | None, bool | None]


AS_THEY_ARE: Reading = (None, None, None)


@dataclass(frozen=True, eq=False)
class Opened:
    """What was found at a path.

    Parameters
    ----------
    sequence : FrameSequence or None
    result : Inspection or None
        Of a result folder; without a sequence if the frames can't be used.
    reading : (dark frame, flat frame, lock-in)
        How the frames were read.
    trouble : str
        A sentence for the user; "" if all went well.
    again : bool
        The same frames as before, read in another way.
    """

    sequence: FrameSequence | None = None
    result: Inspection | None = None
    reading: Reading = AS_THEY_ARE
    trouble: str = ""
    again: bool = False


def open_any(path: Any, settings: Settings) -> Opened:
    """Open a result folder or a sequence."""
    if isinstance(path, (str, Path)) and reader.get_reader(path) is reader.read_result:
        # Also what is read after the result itself belongs to it.
        return read_steadily(Path(path), lambda: open_result(read_result(Path(path))))
    return Opened(_read(path, settings), reading=reading_of(settings))


def open_result(result: Inspection) -> Opened:
    """Take a result up again, with its frames if they are still there."""
    try:
        whole = resume(result, reopen(result))
    except InspectionError as error:
        return Opened(result=result, trouble=str(error))
    return Opened(whole.sequence, whole, reading_of(result.settings))


def open_again(sequence: FrameSequence, settings: Settings) -> Opened:
    """Read the same frames in another way."""
    given = sequence.opened_from or sequence.source
    return Opened(_read(given, settings), reading=reading_of(settings), again=True)


def reading_of(settings: Settings) -> Reading:
    """Return how the settings want the frames to be read."""
    return settings.dark_frame, settings.flat_frame, settings.lock_in


def _read(given: Any, settings: Settings) -> FrameSequence:
    dark, flat, lock_in = reading_of(settings)
    return open_sequence(given, dark, flat, settings.read_limits, settings.series, lock_in)


class Opener(QObject):
    """Opens one path at a time; only the newest request counts.

    Attributes
    ----------
    may_leave : callable
        Asked before anything that would close what is open; False: all stays as it is.
    """

    result_opened = Signal(object)

    def __init__(self, model: WorkbenchModel) -> None:
        super().__init__()
        self._model = model
        self._latest = LatestOnly(
            self._on_opened, self._on_failure, failure="It can't be opened", at_once=True
        )
        self._read_with: Reading = AS_THEY_ARE
        self._putting: Reading | None = None
        self._again = False
        self._name = ""
        self.may_leave: Callable[[], bool] = _always
        model.settings_changed.connect(self._on_settings)
        model.sequence_changed.connect(self._on_sequence)

    @property
    def busy(self) -> bool:
        """Whether something is being opened."""
        return self._latest.busy

    def open(self, path: Any) -> None:
        """Put the frames or the result at a path, or a list of frames, into the workbench."""
        if not self.may_leave():
            return
        name = Path(path).name if isinstance(path, (str, Path)) else f"{len(path)} frames"
        self._model.notice(f"Opening {name} ...")
        self._name = name
        self._start(open_any, path, self._model.settings)

    def restore(self, result: Inspection) -> None:
        """Put a result that was read already into the workbench, with its frames if possible."""
        if self.may_leave():
            self._name = result.source.name
            self._start(open_result, result)

    def close(self, wait_s: float = 3.0) -> None:
        """Open nothing more; wait briefly for the thread."""
        self._model.settings_changed.disconnect(self._on_settings)
        self._model.sequence_changed.disconnect(self._on_sequence)
        self.may_leave = _always
        self._latest.close(wait_s)

    def _start(self, work: Callable[..., Opened], *given: Any) -> None:
        self._again = work is open_again
        self._latest.ask(partial(work, *given))

    def _on_failure(self, error: InspectionError) -> None:
        self._name = ""
        if self._again:
            self._set_reading_back()
        self._model.notice(str(error), is_error=True)

    def _on_opened(self, opened: Opened) -> None:
        name, self._name = self._name, ""
        model = self._model
        if name:
            model.notice(" ".join([f"Opened {name}.", *_said_of(opened.sequence)]))
        self._putting = opened.reading
        try:
            self._put(opened)
        finally:
            self._putting = None
        if opened.result is not None:
            self.result_opened.emit(opened.result)
        if opened.trouble:
            model.notice(opened.trouble, is_error=True)

    def _put(self, opened: Opened) -> None:
        model = self._model
        if opened.again and opened.sequence is not None:
            model.reopen(opened.sequence)
        elif opened.result is not None and opened.result.sequence is not None:
            model.restore(opened.result)
        elif opened.result is not None:
            model.open_result(opened.result, opened.trouble)
        elif opened.sequence is not None:
            model.open(opened.sequence)

    def _on_sequence(self, _: FrameSequence | None) -> None:
        if self._putting is None:
            # Somebody else was faster.
            if self._name:
                self._model.notice("")
                self._name = ""
            self._latest.cancel()
        self._read_with = self._putting or AS_THEY_ARE

    def _on_settings(self, settings: Settings) -> None:
        wanted = reading_of(settings)
        if self._model.sequence is not None and wanted != self._read_with and not self.busy:
            if self.may_leave():
                self._start(open_again, self._model.sequence, settings)
            else:
                self._set_reading_back()

    def _set_reading_back(self) -> None:
        # The controls say how the open frames were read.
        dark, flat, lock_in = self._read_with
        self._model.change_settings(dark_frame=dark, flat_frame=flat, lock_in=lock_in)


def _said_of(sequence: FrameSequence | None) -> list[str]:
    """Say how frames were read if nobody may have asked for it."""
    found = None if sequence is None else lock_in_sentence(sequence.lock_in, confirm=False)
    return [found] if found else []


def _always() -> bool:
    return True
