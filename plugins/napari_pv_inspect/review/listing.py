"""Which cells the gallery lists, and in which order. No Qt, no napari."""

from __future__ import annotations

from collections.abc import Iterable

from psygnal import Signal

from napari_pv_inspect.review.data import ReviewData
from napari_pv_inspect.review.queries import ReviewQueries
from pv_inspect.cracks import CellFeatures, CellState
from pv_inspect.review import Cell, Order, VerdictKind, filtered, next_unjudged, ordered

__all__ = ["EVERY", "CellListing"]

EVERY: tuple[VerdictKind | None, ...] = (None, *VerdictKind)
"""Filter that leaves nothing out; None stands for cells without a verdict."""


class CellListing:
    """Order and filter of the cells.

    Attributes
    ----------
    order : Order
    kinds : tuple of VerdictKind or None
        Verdicts of the cells that are listed.
    disputed_only : bool
        List only cells about which raters say different things.
    states : tuple of CellState
        What must be known about the cracks of the cells that are listed.
    """

    changed = Signal()
    """Order or filter are others; verdicts and subject have their own signals."""

    def __init__(self, data: ReviewData, queries: ReviewQueries) -> None:
        self._data, self._queries = data, queries
        self.order = Order.POSITION
        self.kinds = EVERY
        self.disputed_only = False
        self.states = tuple(CellState)

    @property
    def cells(self) -> tuple[Cell, ...]:
        """Cells that pass the filter, in order."""
        passed = filtered(self._ordered(), self._data.rater_review.verdicts, self.kinds)
        cells = ((f.row, f.col) for f in passed)
        every = len(self.states) == len(CellState)
        return tuple(
            c
            for c in cells
            if (not self.disputed_only or self._queries.is_disputed(c))
            and (every or self._queries.state_of(c) in self.states)
        )

    def next_unjudged(self, after: Cell | None) -> Cell | None:
        """Next cell without a verdict among those that are listed; None if there is none."""
        listed = {*self.cells, after}
        cells = [f for f in self._ordered() if (f.row, f.col) in listed]
        return next_unjudged(cells, self._data.rater_review.verdicts, after)

    def set_order(self, order: Order) -> None:
        """List the cells in another order."""
        self.order = order
        self.changed.emit()

    def set_filter(
        self,
        kinds: Iterable[VerdictKind | None],
        disputed_only: bool = False,
        states: Iterable[CellState] = CellState,
    ) -> None:
        """List cells with these verdicts and states only; None stands for no verdict."""
        self.kinds, self.disputed_only = tuple(kinds), disputed_only
        self.states = tuple(states)
        self.changed.emit()

    def _ordered(self) -> tuple[CellFeatures, ...]:
        subject = self._data.subject
        if subject is None:
            return ()
        blank = {at: CellFeatures(*at, 0.0, 0, 0.0, 0.0, 0.0) for at in subject.places}
        cells = {**blank, **self._data.detected}.values()
        return ordered(cells, self._data.rater_review.verdicts, self.order)
