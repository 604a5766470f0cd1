"""Guesses rows and columns in the background when a sequence comes without them."""

from __future__ import annotations

from functools import partial

from napari_pv_inspect.models.workbench import WorkbenchModel
from napari_pv_inspect.tasks.latest import LatestOnly
from pv_inspect.detection.layout_guess import LayoutGuess, guess_layout, is_known
from pv_inspect.errors import InspectionError
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings

__all__ = ["LayoutGuesser"]


class LayoutGuesser:
    """Guesses the layout of each sequence whose rows and columns are unknown."""

    def __init__(self, model: WorkbenchModel) -> None:
        self._model = model
        self._asked: tuple[FrameSequence, tuple[float, float] | None] | None = None
        self._latest = LatestOnly(
            self._on_guess,
            self._on_failure,
            failure="Rows and columns could not be guessed",
            at_once=True,
        )
        model.sequence_changed.connect(self._on_sequence)
        model.settings_changed.connect(self._on_settings)

    def close(self) -> None:
        """Start no more guesses; one that is under way is not listened to."""
        self._model.sequence_changed.disconnect(self._on_sequence)
        self._model.settings_changed.disconnect(self._on_settings)
        self._latest.close()

    def _on_sequence(self, sequence: FrameSequence | None) -> None:
        self._asked = None
        self._latest.cancel()
        if sequence is not None and not is_known(sequence, self._model.settings):
            self._guess(sequence, self._model.settings)

    def _on_settings(self, settings: Settings) -> None:
        # Another module of the same frames may have other rows and columns.
        if self._asked is None or settings.module_at == self._asked[1]:
            return
        if self._model.layout_is_guessed or settings.rows is None:
            unknown = settings.changed(rows=None, cols=None, cell_aspect=None)
            self._guess(self._asked[0], unknown)

    def _guess(self, sequence: FrameSequence, settings: Settings) -> None:
        self._asked = (sequence, settings.module_at)
        self._model.set_guessing(True)
        self._latest.ask(partial(guess_layout, sequence, settings, settings.module_at))

    def _on_guess(self, guess: LayoutGuess | None) -> None:
        if self._asked is not None:
            self._model.offer_layout(self._asked[0], guess)

    def _on_failure(self, _: InspectionError) -> None:
        self._on_guess(None)
