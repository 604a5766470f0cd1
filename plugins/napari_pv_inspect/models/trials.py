"""Trials of the tuning: settings with a picture each, and undo of their changes. No Qt."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from psygnal import Signal

from napari_pv_inspect.models.cell_picture import CellPicture
from napari_pv_inspect.models.history import Action, History
from napari_pv_inspect.models.workbench import WorkbenchModel
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings, Stage

__all__ = ["LIVE_FIELDS", "Trial", "Tuning", "what_differs"]

LIVE_FIELDS = tuple(name for name in Settings.model_fields if Settings.declared(name).live)
"""Settings that the live cell follows."""
UNDONE_FIELDS = tuple(
    name
    for name in Settings.model_fields
    if Settings.stage_of(name) > Stage.DETECT and not Settings.declared(name).set_by
)
"""Settings whose changes are edits that can be taken back, once the controls rest.

Those of reading and detection make another inspection; what a list of frames sets has edits of its
own.
"""
DEPTH = 100


@dataclass(frozen=True, eq=False)
class Trial:
    """A setting that was tried.

    Attributes
    ----------
    number : int
        From 1, never given twice.
    settings : Settings
    picture : CellPicture
        The live cell, as it looked then.
    text : str
        What differs from the trial before.
    name : str
        Given by the user, or empty.
    """

    number: int
    settings: Settings
    picture: CellPicture
    text: str
    name: str = ""

    @property
    def title(self) -> str:
        """The name, or what differs."""
        return self.name or self.text


class Tuning:
    """The trials; a change of the settings that is finished becomes an action of the history.

    While a slider moves nothing is noted; `commit` is called once it rests.

    Attributes
    ----------
    trials : tuple of Trial
        In the order in which they were tried first.
    current : Trial or None
        The trial whose settings the controls showed last, once they rested.
    previous : Trial or None
        The one before it.
    """

    changed = Signal()

    def __init__(self, model: WorkbenchModel, history: History) -> None:
        self._model = model
        self.history = history
        self._committed = _part(model.settings, UNDONE_FIELDS)
        self._values_at_rest: dict[str, Any] = _part(model.settings, LIVE_FIELDS)
        self._newest: CellPicture | None = None
        self._count = 0
        self.trials: tuple[Trial, ...] = ()
        self.current: Trial | None = None
        self.previous: Trial | None = None
        model.sequence_changed.connect(self._on_sequence)

    @property
    def before(self) -> Trial | None:
        """The previous setting, seen from where the controls stand."""
        current = self.current
        if current is not None and not _equal(current.settings, self._model.settings, LIVE_FIELDS):
            return current
        return self.previous

    def commit(self) -> None:
        """Note that the controls rest: what changed since the last time becomes one edit."""
        now = _part(self._model.settings, UNDONE_FIELDS)
        if now != self._committed:
            self._perform(self._committed, now)
        self._values_at_rest = _part(self._model.settings, LIVE_FIELDS)
        self._note()

    def apply(self, settings: Settings, fields: tuple[str, ...], text: str) -> None:
        """Take some fields over from other settings, as one edit."""
        self.commit()
        old, new = _part(self._model.settings, fields), _part(settings, fields)
        if old != new:
            self._perform(old, new, text)
            self.commit()

    def restore(self, trial: Trial) -> None:
        """Return to a trial, as one edit."""
        self.apply(trial.settings, LIVE_FIELDS, f"Return to {trial.title}")

    def rename(self, trial: Trial, name: str) -> None:
        """Give a trial a name, as one edit; an empty one brings the text back."""
        old = trial.name
        if name.strip() != old:
            self.history.perform(
                Action(
                    "Name a trial",
                    lambda: self._put_name(trial.number, name.strip()),
                    lambda: self._put_name(trial.number, old),
                )
            )

    def continue_from(self, trials: tuple[Trial, ...]) -> None:
        """Continue from the trials of an earlier session."""
        self.trials = trials[-DEPTH:]
        self._count = max((trial.number for trial in trials), default=0)
        self.current = self.previous = None
        self.changed.emit()

    def pictured(self, picture: CellPicture) -> None:
        """Receive a picture of the live cell."""
        if picture.finished and picture.settings is not None:
            self._newest = picture
            self._note()

    def _note(self) -> None:
        """Make the newest picture a trial if the controls rest at its settings."""
        picture = self._newest
        if picture is None or picture.settings is None:
            return
        settings = picture.settings
        if _part(settings, LIVE_FIELDS) != self._values_at_rest:
            return
        known = next((t for t in self.trials if _equal(t.settings, settings, LIVE_FIELDS)), None)
        if known is not None and known is self.current:
            return
        if known is None:
            self._count += 1
            reference = None if self.current is None else self.current.settings
            text = what_differs(reference, settings)
            known = Trial(self._count, settings, picture, text)
            self.trials = (*self.trials, known)[-DEPTH:]
        self.previous, self.current = self.current, known
        self.changed.emit()

    def _perform(self, old: dict[str, Any], new: dict[str, Any], text: str = "") -> None:
        text = text or "Change " + ", ".join(
            Settings.declared(k).title for k in new if new[k] != old[k]
        )
        self.history.perform(Action(text, lambda: self._set(new), lambda: self._set(old)))

    def _set(self, values: dict[str, Any]) -> None:
        # Before the model tells of it, so that this is no new edit.
        self._committed = {k: values.get(k, v) for k, v in self._committed.items()}
        self._model.change_settings(**values)

    def _put_name(self, number: int, name: str) -> None:
        self.trials = tuple(
            replace(trial, name=name) if trial.number == number else trial for trial in self.trials
        )
        by_number = {trial.number: trial for trial in self.trials}
        if self.current is not None:
            self.current = by_number.get(self.current.number, self.current)
        if self.previous is not None:
            self.previous = by_number.get(self.previous.number, self.previous)
        self.changed.emit()

    def _on_sequence(self, _: FrameSequence | None) -> None:
        self._committed = _part(self._model.settings, UNDONE_FIELDS)
        self._values_at_rest = _part(self._model.settings, LIVE_FIELDS)
        self.trials, self.current, self.previous, self._newest = (), None, None, None
        self.changed.emit()


def what_differs(before: Settings | None, after: Settings) -> str:
    """Return what differs between two settings, in a few words."""
    if before is None:
        return "first setting"
    changes = [
        f"{Settings.declared(name).title} {_shown(name, getattr(after, name))}"
        for name in LIVE_FIELDS
        if getattr(before, name) != getattr(after, name)
    ]
    return ", ".join(changes) or "as before"


def _shown(name: str, value: Any) -> str:
    if isinstance(value, tuple):
        return str(len(value))
    if value is None:
        return Settings.declared(name).automatic
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _part(settings: Settings, fields: tuple[str, ...]) -> dict[str, Any]:
    return {name: getattr(settings, name) for name in fields}


def _equal(a: Settings, b: Settings, fields: tuple[str, ...]) -> bool:
    return _part(a, fields) == _part(b, fields)
