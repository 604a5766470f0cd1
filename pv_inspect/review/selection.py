"""How many cells are judged, which ones to show, and in which order."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from pv_inspect.cracks import CellFeatures
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.review.verdicts import Cell, Verdict, VerdictKind

__all__ = ["Order", "Progress", "filtered", "next_unjudged", "ordered", "progress"]

# The worst first; cells without a verdict come last.
_SEVERITY = (
    VerdictKind.CRACK_C,
    VerdictKind.CRACK_B,
    VerdictKind.CRACK_A,
    VerdictKind.INACTIVE,
    VerdictKind.FINGER,
    VerdictKind.OTHER,
    VerdictKind.UNSURE,
    VerdictKind.OK,
)


class Order(StrEnum):
    """In which order cells are shown."""

    POSITION = "position"
    CRACK_SCORE = "crack score"
    VERDICT = "verdict"


@dataclass(frozen=True)
class Progress:
    """How far a review is.

    Parameters
    ----------
    judged, total : int
        Cells.
    counts : dict of VerdictKind to int
        Every kind, in its usual order.
    """

    judged: int
    total: int
    counts: dict[VerdictKind, int]

    @property
    def text(self) -> str:
        """For a status line: ``12 of 60 cells judged``."""
        return f"{self.judged} of {self.total} cells judged"


def progress(verdicts: Iterable[Verdict], layout: ModuleLayout) -> Progress:
    """Count what is judged.

    Parameters
    ----------
    verdicts : iterable of Verdict
        Of one rater, or of several: a cell counts as judged once, its verdicts each.
        Those outside of the layout (of an earlier run with another one) do not count.
    layout : ModuleLayout

    Returns
    -------
    Progress
    """
    inside = [v for v in verdicts if v.row < layout.rows and v.col < layout.cols]
    found = Counter(verdict.kind for verdict in inside)
    return Progress(
        len({verdict.cell for verdict in inside}),
        layout.rows * layout.cols,
        {kind: found[kind] for kind in VerdictKind},
    )


def filtered(
    cells: Iterable[CellFeatures],
    verdicts: Mapping[Cell, Verdict],
    kinds: Collection[VerdictKind | None],
) -> tuple[CellFeatures, ...]:
    """Cells with one of the verdicts, in the order given; None stands for cells without one."""
    return tuple(cell for cell in cells if _kind(cell, verdicts) in kinds)


def ordered(
    cells: Iterable[CellFeatures], verdicts: Mapping[Cell, Verdict], order: Order
) -> tuple[CellFeatures, ...]:
    """Put cells in an order.

    Parameters
    ----------
    cells : iterable of CellFeatures
    verdicts : mapping of (row, column) to Verdict
        Of one rater, see `of_rater`.
    order : Order
        By position row by row; by crack score the highest first; by verdict from crack C to ok
        and the cells without one last. What is equal stays ordered by position.

    Returns
    -------
    tuple of CellFeatures
    """

    def rank(cell: CellFeatures) -> float:
        if order is Order.CRACK_SCORE:
            return -cell.crack_score
        if order is Order.VERDICT:
            kind = _kind(cell, verdicts)
            return len(_SEVERITY) if kind is None else _SEVERITY.index(kind)
        return 0

    return tuple(sorted(cells, key=lambda cell: (rank(cell), cell.row, cell.col)))


def next_unjudged(
    cells: Sequence[CellFeatures], verdicts: Mapping[Cell, Verdict], after: Cell | None
) -> Cell | None:
    """Next cell without a verdict in the order given, from the start again at the end.

    None if all are judged. ``after`` need not be among the cells; then the search starts at the
    first.
    """
    places = [(cell.row, cell.col) for cell in cells]
    start = places.index(after) + 1 if after in places else 0
    return next((c for c in places[start:] + places[:start] if c not in verdicts), None)


def _kind(cell: CellFeatures, verdicts: Mapping[Cell, Verdict]) -> VerdictKind | None:
    verdict = verdicts.get((cell.row, cell.col))
    return None if verdict is None else verdict.kind
