"""Guesses rows and columns beside the window when a sequence comes without them."""

from __future__ import annotations

from napari.qt.threading import create_worker

from napari_pv_inspect.model import WorkbenchModel
from pv_inspect.errors import InspectionError
from pv_inspect.layout_guess import LayoutGuess, guess_layout, is_known
from pv_inspect.sequence import Sequence
from pv_inspect.settings import Settings

__all__ = ["LayoutGuesser"]


class LayoutGuesser:
    """Offers the model a layout for each sequence whose rows and columns are unknown."""

    def __init__(self, model: WorkbenchModel) -> None:
        self._model = model
        model.sequence_changed.connect(self._on_sequence)

    def close(self) -> None:
        """Start no more guesses; one that is under way is not listened to."""
        self._model.sequence_changed.disconnect(self._on_sequence)

    def _on_sequence(self, sequence: Sequence | None) -> None:
        self._model.guessing = False
        if sequence is None or is_known(sequence, self._model.settings):
            return
        self._model.guessing = True
        worker = create_worker(_guess_or_none, sequence, self._model.settings)
        worker.returned.connect(lambda guess: self._model.offer_layout(sequence, guess))
        worker.start()


def _guess_or_none(sequence: Sequence, settings: Settings) -> LayoutGuess | None:
    try:
        return guess_layout(sequence, settings, settings.module_at)
    except InspectionError:
        return None
