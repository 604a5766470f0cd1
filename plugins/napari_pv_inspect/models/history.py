"""Undo and redo of edits. No Qt, no napari."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from psygnal import Signal

__all__ = ["Action", "History"]

DEPTH = 500


@dataclass(frozen=True, eq=False)
class Action:
    """An edit and how to undo it.

    Attributes
    ----------
    text : str
        What it does, in a few words: "Move a crossing point".
    do, undo : callable
        An action that raises has changed nothing.
    """

    text: str
    do: Callable[[], None]
    undo: Callable[[], None]


class History:
    """The actions that were done, and those that were undone."""

    changed = Signal()
    committing = Signal()
    """Edits that have not become actions yet, as of a slider that still moves, must do so now."""

    def __init__(self) -> None:
        self._done: list[Action] = []
        self._undone: list[Action] = []

    @property
    def done(self) -> tuple[Action, ...]:
        """The actions that can be taken back, the last one at the end."""
        return tuple(self._done)

    @property
    def undone(self) -> tuple[Action, ...]:
        """The actions that can be done again, the next one at the end."""
        return tuple(self._undone)

    @property
    def undo_text(self) -> str | None:
        """What `undo` would take back."""
        return self._done[-1].text if self._done else None

    @property
    def redo_text(self) -> str | None:
        """What `redo` would do again."""
        return self._undone[-1].text if self._undone else None

    def perform(self, action: Action) -> None:
        """Do something that can be taken back; what was undone before is forgotten."""
        action.do()
        self._done.append(action)
        del self._done[:-DEPTH]
        self._undone.clear()
        self.changed.emit()

    def commit(self) -> None:
        """Make actions of edits that are not finished."""
        self.committing.emit()

    def undo(self) -> None:
        """Take the last action back; nothing happens if there is none."""
        self.commit()
        if self._done:
            self._done[-1].undo()
            self._undone.append(self._done.pop())
            self.changed.emit()

    def redo(self) -> None:
        """Do again what was taken back last; nothing happens if there is nothing."""
        self.commit()
        if self._undone:
            self._undone[-1].do()
            self._done.append(self._undone.pop())
            self.changed.emit()

    def clear(self) -> None:
        """Forget all actions, for another sequence or another result."""
        self._done.clear()
        self._undone.clear()
        self.changed.emit()
