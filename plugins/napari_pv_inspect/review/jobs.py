"""Reads and writes of a review in its store, done in the journal's thread. No Qt, no napari."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from napari_pv_inspect.review.subject import Mask, Subject
from pv_inspect.cracks import CellFeatures
from pv_inspect.errors import InspectionError
from pv_inspect.review import (
    Cell,
    Change,
    ModuleData,
    ReviewState,
    ReviewStore,
    Verdict,
)

__all__ = [
    "Corrected",
    "Edit",
    "Loaded",
    "Stepped",
    "TakeOver",
    "Unstored",
    "load",
    "step",
    "step_back",
    "store_marks",
    "store_verdict",
]


@dataclass(frozen=True, eq=False)
class Corrected:
    """Corrected marks and the features of the cell with them, None if they can't be measured."""

    mask: Mask
    features: CellFeatures | None

    @classmethod
    def of(cls, subject: Subject | None, cell: Cell, mask: Mask | None) -> Corrected | None:
        """Measure marks; None if there are none."""
        if mask is None:
            return None
        try:
            return cls(mask, None if subject is None else subject.measured(cell, mask))
        except InspectionError:  # drawn on a result of another size, or the detector is missing
            return cls(mask, None)

    def store(self, store: ReviewStore, cell: Cell, rater: str) -> int:
        """Store marks and measures; returns the number of the edit."""
        length = isolated = None
        if self.features is not None:
            length, isolated = self.features.crack_length_cells, self.features.isolated_area_share
            isolated = None if math.isnan(isolated) else isolated
        return store.correct(cell, rater, self.mask, length, isolated)


@dataclass(eq=False)
class Edit:
    """An edit by its name, also while it waits to be stored.

    Attributes
    ----------
    rater : str
    cell : (int, int)
        (row, column) from 0.
    number : int or None
        In the store; only its thread reads and sets it.
    """

    rater: str
    cell: Cell
    number: int | None = None


@dataclass(frozen=True, eq=False)
class Loaded:
    """What a store holds, as one rater sees it."""

    rater: str
    verdicts: tuple[Verdict, ...]
    notes: Mapping[Cell, str]
    masks: Mapping[Cell, Mask]
    module_data: ModuleData
    state: ReviewState | None


@dataclass(frozen=True, eq=False)
class Stepped:
    """What an undo or redo has changed, and the marks that hold now."""

    change: Change
    corrected: Corrected | None


def load(store: ReviewStore, rater: str) -> Loaded:
    """Read all that a store holds."""
    verdicts, notes, masks = store.current(), store.waiting_notes(rater), store.masks(rater)
    return Loaded(rater, verdicts, notes, masks, store.module_data(), store.remembered(rater))


def step(store: ReviewStore, way: str, subject: Subject | None, edit: Edit) -> Stepped | None:
    """Undo or redo an edit; None if the store does not know it."""
    take = store.undo if way == "undo" else store.redo
    return (
        None
        if edit.number is None
        else _stepped(store, subject, edit.rater, take(edit.rater, edit.number))
    )


def step_back(store: ReviewStore, subject: Subject | None, rater: str) -> Stepped | None:
    """Undo the rater's last edit, whoever made it; None if there is none."""
    return _stepped(store, subject, rater, store.undo(rater))


def _stepped(
    store: ReviewStore, subject: Subject | None, rater: str, change: Change | None
) -> Stepped | None:
    if change is None:
        return None
    mask = None
    if change.mask_changed or change.superseded:
        mask = store.mask(change.cell, rater)
    return Stepped(change, Corrected.of(subject, change.cell, mask))


def store_verdict(store: ReviewStore, edit: Edit, verdict: Verdict | None, note: str) -> None:
    """Store a verdict with its note; without one the note waits, and the cell is not judged."""
    if verdict is not None:
        edit.number = store.give(verdict)
    elif any(v.cell == edit.cell and v.rater == edit.rater for v in store.current()):
        edit.number = store.withdraw(edit.cell, edit.rater)
    else:
        edit.number = store.note(edit.cell, edit.rater, note)


def store_marks(
    store: ReviewStore, subject: Subject, edit: Edit, mask: Mask | None
) -> Corrected | None:
    """Measure and store corrected marks; None goes back to those of the detector."""
    corrected = Corrected.of(subject, edit.cell, mask)
    if corrected is None:
        edit.number = store.correct(edit.cell, edit.rater, None)
    else:
        edit.number = corrected.store(store, edit.cell, edit.rater)
    return corrected


@dataclass(frozen=True, eq=False)
class Unstored:
    """What a rater said about a cell, while it could not be stored."""

    rater: str
    cell: Cell
    verdict: Verdict | None
    note: str
    corrected: Corrected | None

    def store(self, store: ReviewStore) -> None:
        """Store it as the newest that is said."""
        store_verdict(store, Edit(self.rater, self.cell), self.verdict, self.note)
        if self.corrected is not None:
            self.corrected.store(store, self.cell, self.rater)
        elif store.mask(self.cell, self.rater) is not None:
            store.correct(self.cell, self.rater, None)


class TakeOver:
    """Job that takes over the review of another folder, and what did not get as far as that.

    What the folder says already stays. Returns a sentence about that, or about the other folder if
    it can't be read any more.
    """

    def __init__(self, old: Path, unstored: Sequence[Unstored]) -> None:
        self._old, self._unstored = old, unstored
        self._here: set[tuple[str, Cell]] | None = None

    def __call__(self, store: ReviewStore) -> str:
        """Copy the review; if it fails it may be called again."""
        if self._here is None:
            self._here = set(store.contents().said)
        differ: set[tuple[str, Cell]] = set()
        sentences = []
        try:
            with ReviewStore(self._old) as other:
                contents = other.contents()
        except InspectionError as error:
            sentences.append(f"The review was not taken along: {error}")
        else:
            differ |= {place for place in store.merge(contents) if place in self._here}
        for entry in self._unstored:
            if (entry.rater, entry.cell) in self._here:
                differ.add((entry.rater, entry.cell))
            else:
                entry.store(store)
        if differ:
            cells = "1 cell" if len(differ) == 1 else f"{len(differ)} cells"
            sentences.append(
                f"{store.path.parent} says something else about {cells} already: that stays, and "
                f"what was said here is still in {self._old}."
            )
        return " ".join(sentences)
