"""Verdicts, notes and marks in memory, of every rater who judged here. No Qt, no napari."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from napari_pv_inspect.review.jobs import Corrected
from napari_pv_inspect.review.subject import Mask
from pv_inspect.review import Cell, Verdict, of_rater

__all__ = ["ModuleReview", "RaterReview"]


@dataclass
class RaterReview:
    """The verdicts, notes and marks of one rater.

    Attributes
    ----------
    verdicts : dict of Cell to Verdict
        Also those that are not stored yet.
    notes : dict of Cell to str
        Notes that wait for a verdict.
    corrected : dict of Cell to Corrected
    unstored : Counter of Cell
        How many things about a cell are not stored yet.
    revisions : Counter of Cell
        How often its marks were corrected: only the latest measures count.
    """

    verdicts: dict[Cell, Verdict] = field(default_factory=dict)
    notes: dict[Cell, str] = field(default_factory=dict)
    corrected: dict[Cell, Corrected] = field(default_factory=dict)
    unstored: Counter[Cell] = field(default_factory=Counter)
    revisions: Counter[Cell] = field(default_factory=Counter)

    def take_verdicts(self, read: Mapping[Cell, Verdict]) -> None:
        """Take over what is stored; what is not stored yet is newer."""
        kept = {cell: v for cell, v in read.items() if not self.unstored[cell]}
        newer = {cell: v for cell, v in self.verdicts.items() if self.unstored[cell]}
        self.verdicts = {**kept, **newer}
        for cell in kept:
            self.notes.pop(cell, None)

    def take_notes(self, read: Mapping[Cell, str]) -> None:
        """Take over stored notes that wait; what is not stored yet is newer."""
        kept = {cell: note for cell, note in read.items() if not self.unstored[cell]}
        newer = {cell: note for cell, note in self.notes.items() if self.unstored[cell]}
        self.notes = {**kept, **newer}

    def take_masks(self, read: Mapping[Cell, Mask]) -> list[Cell]:
        """Take over stored marks; returns the cells that have to be measured with them.

        What is not stored yet is newer.
        """
        taken = [cell for cell in read if not self.unstored[cell]]
        newer = {cell: marks for cell, marks in self.corrected.items() if self.unstored[cell]}
        self.corrected = {**{cell: Corrected(read[cell], None) for cell in taken}, **newer}
        return taken

    def put_verdict(self, cell: Cell, verdict: Verdict | None, note: str) -> None:
        """Take over a verdict and a note; without a verdict the note waits for one."""
        self.verdicts.pop(cell, None)
        self.notes.pop(cell, None)
        if verdict is not None:
            self.verdicts[cell] = verdict
        elif note:
            self.notes[cell] = note

    def put_marks(self, cell: Cell, corrected: Corrected | None) -> None:
        """Take over marks."""
        self.corrected.pop(cell, None)
        if corrected is not None:
            self.corrected[cell] = corrected


@dataclass
class ModuleReview:
    """The verdicts, notes and marks of all raters on one module.

    Attributes
    ----------
    stored : tuple of Verdict
        Of all raters, as last read.
    raters : dict of str to RaterReview
        Of those who judge here, by name.
    """

    stored: tuple[Verdict, ...] = ()
    raters: dict[str, RaterReview] = field(default_factory=dict)
    _stored_on: dict[Cell, list[Verdict]] = field(default_factory=dict)

    def rater_review(self, rater: str) -> RaterReview:
        """Return the review of a rater; a new one begins with what is stored."""
        if rater not in self.raters:
            self.raters[rater] = RaterReview(of_rater(self.stored, rater))
        return self.raters[rater]

    def take_all_verdicts(self, verdicts: Iterable[Verdict]) -> None:
        """Take over what is stored of all raters."""
        self.stored = tuple(verdicts)
        self._stored_on = {}
        for verdict in self.stored:
            self._stored_on.setdefault(verdict.cell, []).append(verdict)
        for rater, own in self.raters.items():
            own.take_verdicts(of_rater(self.stored, rater))

    def others(self, cell: Cell, rater: str) -> list[Verdict]:
        """Verdicts on a cell by everybody else, in the order of their names."""
        found = {v.rater: v for v in self._stored_on.get(cell, ()) if v.rater not in self.raters}
        for name, own in self.raters.items():
            if cell in own.verdicts:
                found[name] = own.verdicts[cell]
        found.pop(rater, None)
        return [found[name] for name in sorted(found)]

    def unstored(self) -> list[tuple[str, Cell]]:
        """Who said something about which cell that is not stored yet."""
        return [(r, c) for r, own in self.raters.items() for c, n in own.unstored.items() if n]

    def without_pending(self) -> ModuleReview:
        """Return what is said, for another store: nothing waits there yet."""
        raters = {
            rater: RaterReview(dict(own.verdicts), dict(own.notes), dict(own.corrected))
            for rater, own in self.raters.items()
        }
        return ModuleReview(self.stored, raters, self._stored_on)
