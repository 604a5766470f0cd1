"""What a review does with its store, in the thread that may wait for the disk. No Qt, no napari."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from napari_pv_inspect.review_subject import Mask, Subject
from pv_inspect.cracks import CellFeatures
from pv_inspect.errors import InspectionError
from pv_inspect.review import (
    Cell,
    Change,
    ModuleData,
    ReviewState,
    ReviewStore,
    Verdict,
    of_rater,
)

__all__ = [
    "Corrected",
    "Edit",
    "Loaded",
    "Stepped",
    "load",
    "step",
    "step_back",
    "store_marks",
    "store_verdict",
    "take_marks",
    "take_verdict",
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
    masks, data, state = store.masks(rater), store.module_data(), store.remembered(rater)
    return Loaded(rater, store.current(), masks, data, state)


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


def store_verdict(store: ReviewStore, edit: Edit, verdict: Verdict | None) -> None:
    """Store a verdict; None withdraws it."""
    if verdict is None:
        edit.number = store.withdraw(edit.cell, edit.rater)
    else:
        edit.number = store.give(verdict)


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


def take_verdict(verdict: Verdict) -> Callable[[ReviewStore], None]:
    """Job that takes a verdict over from another store, unless this one knows better."""

    def give(store: ReviewStore) -> None:
        if verdict.cell not in of_rater(store.current(), verdict.rater):
            store.give(verdict)

    return give


def take_marks(cell: Cell, corrected: Corrected, rater: str) -> Callable[[ReviewStore], None]:
    """Job that takes marks over from another store, unless this one knows better."""

    def correct(store: ReviewStore) -> None:
        if store.mask(cell, rater) is None:
            corrected.store(store, cell, rater)

    return correct
