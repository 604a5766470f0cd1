"""Verdicts and marks in memory: those of the rater, those of the others. No Qt, no napari."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from napari_pv_inspect.review_jobs import Corrected
from napari_pv_inspect.review_subject import Mask
from pv_inspect.review import Cell, Verdict, of_rater

__all__ = ["Book"]


@dataclass
class Book:
    """What is said about the cells of one module.

    Attributes
    ----------
    stored : tuple of Verdict
        Of all raters, as last read.
    mine : dict of Cell to Verdict
        Of the rater, also those that are not stored yet.
    others : dict of Cell to list of Verdict
    notes : dict of Cell to str
        Notes that wait for a verdict.
    corrected : dict of Cell to Corrected
        Marks of the rater.
    unstored : Counter of Cell
        How many things about a cell are not stored yet.
    strokes : Counter of Cell
        How often its marks were corrected: only the newest measures count.
    """

    stored: tuple[Verdict, ...] = ()
    mine: dict[Cell, Verdict] = field(default_factory=dict)
    others: dict[Cell, list[Verdict]] = field(default_factory=dict)
    notes: dict[Cell, str] = field(default_factory=dict)
    corrected: dict[Cell, Corrected] = field(default_factory=dict)
    unstored: Counter[Cell] = field(default_factory=Counter)
    strokes: Counter[Cell] = field(default_factory=Counter)

    def sort_out(self, verdicts: Iterable[Verdict], rater: str) -> None:
        """Take over what is stored; what is not stored yet is newer."""
        self.stored = tuple(verdicts)
        read = of_rater(self.stored, rater)
        kept = {cell: v for cell, v in read.items() if not self.unstored[cell]}
        newer = {cell: v for cell, v in self.mine.items() if self.unstored[cell]}
        self.mine = {**kept, **newer}
        self.others = {}
        for verdict in self.stored:
            if verdict.rater != rater:
                self.others.setdefault(verdict.cell, []).append(verdict)

    def take_masks(self, read: Mapping[Cell, Mask]) -> list[Cell]:
        """Take over stored marks; returns the cells that have to be measured with them.

        What is not stored yet is newer.
        """
        taken = [cell for cell in read if not self.unstored[cell]]
        self.corrected |= {cell: Corrected(read[cell], None) for cell in taken}
        return taken

    def put_verdict(self, cell: Cell, verdict: Verdict | None) -> None:
        """Take over a verdict of the rater."""
        self.mine.pop(cell, None)
        if verdict is not None:
            self.mine[cell] = verdict

    def put_marks(self, cell: Cell, corrected: Corrected | None) -> None:
        """Take over marks of the rater."""
        self.corrected.pop(cell, None)
        if corrected is not None:
            self.corrected[cell] = corrected

    def for_rater(self, rater: str) -> Book:
        """Return the same book as another rater sees it, without marks."""
        other = Book(unstored=self.unstored)
        other.sort_out(self.stored, rater)
        return other
