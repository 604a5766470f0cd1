"""What a review shows: verdicts and marks of the cells, and which cells are listed. No Qt."""

from __future__ import annotations

from collections.abc import Iterable

from psygnal import Signal

from napari_pv_inspect.review.module_review import ModuleReview, RaterReview
from napari_pv_inspect.review.subject import Mask, Subject
from pv_inspect.cracks import CellCounts, CellFeatures, CellState, state_of
from pv_inspect.review import (
    Cell,
    Order,
    Progress,
    Verdict,
    VerdictKind,
    filtered,
    next_unjudged,
    ordered,
    progress,
)

__all__ = ["EVERY", "NO_CELLS", "ReviewView"]

NO_CELLS = "There are no cells yet: run the inspection first."

EVERY: tuple[VerdictKind | None, ...] = (None, *VerdictKind)
"""Filter that leaves nothing out; None stands for cells without a verdict."""


class ReviewView:
    """A review as one rater sees it.

    Attributes
    ----------
    subject : Subject or None
        What is shown and can be judged.
    why_empty : str
        One sentence for when there is no subject.
    rater : str
    order : Order
    kinds : tuple of VerdictKind or None
        Verdicts of the cells that are listed.
    disputed_only : bool
        List only cells about which raters say different things.
    states : tuple of CellState
        What must be known about the cracks of the cells that are listed.
    threshold : float
        Probability from which pixels are painted as cracks.
    """

    subject_changed = Signal(object)
    listing_changed = Signal()
    verdicts_changed = Signal()
    marks_changed = Signal(object)
    threshold_changed = Signal(float)

    def __init__(self, rater: str) -> None:
        self._found: dict[Cell, CellFeatures] = {}
        self._module_review = ModuleReview()
        self.subject: Subject | None = None
        self.why_empty = NO_CELLS
        self.rater = rater
        self.order = Order.POSITION
        self.kinds = EVERY
        self.disputed_only = False
        self.states = tuple(CellState)
        self.threshold = 0.5

    @property
    def _rater_review(self) -> RaterReview:
        return self._module_review.rater_review(self.rater)

    # One cell

    def is_pending(self, cell: Cell) -> bool:
        """Whether something about the cell is not stored yet."""
        return self._rater_review.unstored[cell] > 0

    def verdict(self, cell: Cell) -> Verdict | None:
        """Verdict of the rater."""
        return self._rater_review.verdicts.get(cell)

    def others(self, cell: Cell) -> list[Verdict]:
        """Verdicts of the other raters."""
        return self._module_review.others(cell, self.rater)

    def is_disputed(self, cell: Cell) -> bool:
        """Whether raters say different things."""
        mine = self.verdict(cell)
        kinds = {verdict.kind for verdict in self.others(cell)}
        return len(kinds if mine is None else kinds | {mine.kind}) > 1

    def note(self, cell: Cell) -> str:
        """Note about a cell, also one that waits for its verdict."""
        verdict = self.verdict(cell)
        return self._rater_review.notes.get(cell, "") if verdict is None else verdict.note

    def features(self, cell: Cell) -> CellFeatures | None:
        """Features of a cell, those of the corrected marks if there are any."""
        corrected = self._rater_review.corrected.get(cell)
        if corrected is not None and corrected.features is not None:
            return corrected.features
        return self._found.get(cell)

    def correction(self, cell: Cell) -> Mask | None:
        """Marks as the rater corrected them; None if they are the detector's.

        Marks that were drawn on an image of another size do not count.
        """
        corrected = self._rater_review.corrected.get(cell)
        if corrected is None or self.subject is None:
            return None
        fits = corrected.mask.shape == self.subject.tiles.images.shape[2:]
        return corrected.mask if fits else None

    @property
    def corrections(self) -> dict[Cell, Mask]:
        """All marks that the rater has corrected, by cell."""
        found = {cell: self.correction(cell) for cell in self._rater_review.corrected}
        return {cell: mask for cell, mask in found.items() if mask is not None}

    def marks(self, cell: Cell) -> Mask | None:
        """Marks that are shown, (h, w) bool."""
        mask = self.correction(cell)
        return self.found_marks(cell) if mask is None else mask

    def found_marks(self, cell: Cell) -> Mask | None:
        """Marks of the detector, (h, w) bool."""
        return None if self.subject is None else self.subject.marks(cell, self.threshold)

    # All cells

    @property
    def listed(self) -> tuple[Cell, ...]:
        """Cells that pass the filter, in order."""
        passed = filtered(self._ordered(), self._rater_review.verdicts, self.kinds)
        cells = ((f.row, f.col) for f in passed)
        every = len(self.states) == len(CellState)
        return tuple(
            c
            for c in cells
            if (not self.disputed_only or self.is_disputed(c))
            and (every or self.state_of(c) in self.states)
        )

    @property
    def counts(self) -> CellCounts | None:
        """Cells by what the detector says about them; None while it has not said anything."""
        return CellCounts.of(self._found.values()) if self._found else None

    def state_of(self, cell: Cell) -> CellState | None:
        """What the detector says about a cell; marks that a person corrected do not change it."""
        found = self._found.get(cell)
        return None if found is None else state_of(found)

    @property
    def progress(self) -> Progress | None:
        """How many cells the rater has judged."""
        if self.subject is None:
            return None
        return progress(self._rater_review.verdicts.values(), self.subject.tiles.grid.layout)

    def next_unjudged(self, after: Cell | None) -> Cell | None:
        """Next cell without a verdict among those that are listed; None if there is none."""
        listed = {*self.listed, after}
        cells = [f for f in self._ordered() if (f.row, f.col) in listed]
        return next_unjudged(cells, self._rater_review.verdicts, after)

    def set_order(self, order: Order) -> None:
        """List the cells in another order."""
        self.order = order
        self.listing_changed.emit()

    def set_filter(
        self,
        kinds: Iterable[VerdictKind | None],
        disputed_only: bool = False,
        states: Iterable[CellState] = CellState,
    ) -> None:
        """List cells with these verdicts and states only; None stands for no verdict."""
        self.kinds, self.disputed_only = tuple(kinds), disputed_only
        self.states = tuple(states)
        self.listing_changed.emit()

    def set_threshold(self, threshold: float) -> None:
        """Paint pixels as cracks from this probability on; nothing is measured again."""
        self.threshold = threshold
        self.threshold_changed.emit(threshold)

    def _ordered(self) -> tuple[CellFeatures, ...]:
        if self.subject is None:
            return ()
        blank = {at: CellFeatures(*at, 0.0, 0, 0.0, 0.0, 0.0) for at in self.subject.places}
        return ordered({**blank, **self._found}.values(), self._rater_review.verdicts, self.order)
