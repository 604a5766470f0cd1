"""What is known about the cells, as the current rater sees it. No Qt, no napari."""

from __future__ import annotations

from napari_pv_inspect.review.data import ReviewData
from napari_pv_inspect.review.subject import Mask
from pv_inspect.cracks import CellCounts, CellFeatures, CellState, state_of
from pv_inspect.review import Cell, Progress, Verdict, progress

__all__ = ["ReviewQueries"]


class ReviewQueries:
    """Answers what is known about the cells; changes nothing."""

    def __init__(self, data: ReviewData) -> None:
        self._data = data

    # One cell

    def is_pending(self, cell: Cell) -> bool:
        """Whether something about the cell is not stored yet."""
        return self._data.rater_review.unstored[cell] > 0

    def verdict(self, cell: Cell) -> Verdict | None:
        """Verdict of the rater."""
        return self._data.rater_review.verdicts.get(cell)

    def others(self, cell: Cell) -> list[Verdict]:
        """Verdicts of the other raters."""
        return self._data.module_review.others(cell, self._data.rater)

    def is_disputed(self, cell: Cell) -> bool:
        """Whether raters say different things."""
        mine = self.verdict(cell)
        kinds = {verdict.kind for verdict in self.others(cell)}
        return len(kinds if mine is None else kinds | {mine.kind}) > 1

    def note(self, cell: Cell) -> str:
        """Note about a cell, also one that waits for its verdict."""
        verdict = self.verdict(cell)
        return self._data.rater_review.notes.get(cell, "") if verdict is None else verdict.note

    def features(self, cell: Cell) -> CellFeatures | None:
        """Features of a cell, those of the corrected marks if there are any."""
        corrected = self._data.rater_review.corrected.get(cell)
        if corrected is not None and corrected.features is not None:
            return corrected.features
        return self._data.detected.get(cell)

    def correction(self, cell: Cell) -> Mask | None:
        """Marks as the rater corrected them; None if they are the detector's.

        Marks that were drawn on an image of another size do not count.
        """
        corrected, subject = self._data.rater_review.corrected.get(cell), self._data.subject
        if corrected is None or subject is None:
            return None
        fits = corrected.mask.shape == subject.tiles.shape(*cell)
        return corrected.mask if fits else None

    def marks(self, cell: Cell) -> Mask | None:
        """Marks that are shown, (h, w) bool."""
        mask = self.correction(cell)
        return self.found_marks(cell) if mask is None else mask

    def found_marks(self, cell: Cell) -> Mask | None:
        """Marks of the detector, (h, w) bool."""
        subject = self._data.subject
        return None if subject is None else subject.marks(cell, self._data.threshold)

    def state_of(self, cell: Cell) -> CellState | None:
        """What the detector says about a cell; marks that a person corrected do not change it."""
        found = self._data.detected.get(cell)
        return None if found is None else state_of(found)

    # All cells

    @property
    def corrections(self) -> dict[Cell, Mask]:
        """All marks that the rater has corrected, by cell."""
        found = {cell: self.correction(cell) for cell in self._data.rater_review.corrected}
        return {cell: mask for cell, mask in found.items() if mask is not None}

    @property
    def counts(self) -> CellCounts | None:
        """Cells by what the detector says about them; None while it has not said anything."""
        return CellCounts.of(self._data.detected.values()) if self._data.detected else None

    @property
    def progress(self) -> Progress | None:
        """How many cells the rater has judged."""
        if self._data.subject is None:
            return None
        layout = self._data.subject.tiles.grid.layout
        return progress(self._data.rater_review.verdicts.values(), layout)
