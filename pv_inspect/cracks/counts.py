"""How many cells are suspected, clean, dark or can't be judged: counted and worded in one place."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from pv_inspect.cracks.features import CellFeatures
from pv_inspect.cracks.seen import MOST_BLUR

__all__ = ["CellCounts", "CellState", "look_at_first", "state_of"]


class CellState(StrEnum):
    """What is known about the cracks of a cell; each cell has exactly one of these."""

    SUSPECTED = "suspected"
    UNDECIDABLE = "can't be judged"
    DARK = "dark"
    CLEAN = "clean"

    @property
    def meaning(self) -> str:
        """One sentence for a tooltip or a legend."""
        return _MEANING[self]


_MEANING = {
    CellState.SUSPECTED: "At least one mark that a crack could have made.",
    CellState.UNDECIDABLE: (
        "It is left open whether there are cracks, or how bad they are: cracks would not show in "
        "these frames, all marks are too short or too faint, or the cell looks unlike all that the "
        "detector has learnt."
    ),
    CellState.DARK: "Dark as a whole: its cracks are not judged.",
    CellState.CLEAN: (
        "No mark that a crack could have made; the frames would have shown a crack like those that "
        "the detector has learnt. Fainter or narrower ones (hair cracks) can be missed."
    ),
}


def state_of(cell: CellFeatures) -> CellState:
    """Return the one state of a cell.

    A cell that can't be judged is neither suspected nor clean, whatever marks it has.
    """
    if cell.dark:
        return CellState.DARK
    if cell.undecidable:
        return CellState.UNDECIDABLE
    return CellState.SUSPECTED if cell.has_marks else CellState.CLEAN


@dataclass(frozen=True)
class CellCounts:
    """Cells by what is known about their cracks; the four add up to all cells.

    Parameters
    ----------
    suspected, clean : int
        Cells that could be judged.
    undecidable : int
        Cells that can't be judged (class "unsure" in the tables).
    dark : int
        Cells that are dark as a whole and therefore not judged.
    unfamiliar : int
        Those of ``undecidable`` that look unlike all that the detector has learnt.
    weak : int
        Those of the others of ``undecidable`` whose marks are all too short or too faint.
    blurred : int
        Those of ``undecidable`` in which the image is too blurred for cracks to show.
    """

    suspected: int
    clean: int
    undecidable: int
    dark: int
    unfamiliar: int = 0
    weak: int = 0
    blurred: int = 0

    @classmethod
    def of(cls, cells: Iterable[CellFeatures]) -> CellCounts:
        """Count cells."""
        cells = list(cells)
        found = Counter(map(state_of, cells))
        open_cells = [cell for cell in cells if cell.undecidable]
        unfamiliar = sum(cell.unfamiliar for cell in open_cells)
        return cls(
            found[CellState.SUSPECTED],
            found[CellState.CLEAN],
            found[CellState.UNDECIDABLE],
            found[CellState.DARK],
            unfamiliar,
            sum(cell.weak_marks and not cell.unfamiliar for cell in open_cells),
            sum(cell.edge_blur > MOST_BLUR for cell in open_cells),
        )

    def __getitem__(self, state: CellState) -> int:
        return {
            CellState.SUSPECTED: self.suspected,
            CellState.UNDECIDABLE: self.undecidable,
            CellState.DARK: self.dark,
            CellState.CLEAN: self.clean,
        }[state]

    @property
    def total(self) -> int:
        """All cells."""
        return self.suspected + self.clean + self.undecidable + self.dark

    @property
    def judged(self) -> int:
        """Cells with an answer: suspected or clean."""
        return self.suspected + self.clean

    @property
    def unjudged_text(self) -> str:
        """What was not judged, "" if all was: ``7 of 60 cells can't be judged from these frames``.

        The absence of marks says nothing about these cells: whoever tells a count tells this first.
        """
        return self._unjudged(f" ({self._reasons})" if self._reasons else _FROM_FRAMES)

    def _unjudged(self, because: str) -> str:
        of_all = f" of {self.total} {'cell' if self.total == 1 else 'cells'}"
        parts = []
        if self.undecidable:
            parts.append(f"{self.undecidable}{of_all} can't be judged{because}")
        if self.dark:
            is_dark = "is dark" if self.dark == 1 else "are dark"
            parts.append(f"{self.dark}{'' if parts else of_all} {is_dark} and not judged")
        return ", ".join(parts)

    @property
    def _reasons(self) -> str:
        """Why cells can't be judged, the reason with the most to say about the run first.

        "" where it is the frames alone.
        """
        if not (self.unfamiliar or self.weak):
            return ""
        reasons = {
            "unlike all that the detector has learnt": self.unfamiliar,
            "with marks too short or too faint for a crack": self.weak,
            "in which cracks would not show": self.undecidable - self.unfamiliar - self.weak,
        }
        return ", ".join(f"{n} {why}" for why, n in reasons.items() if n)

    @property
    def text(self) -> str:
        """All counts in one line, what was not judged first; no full stop.

        Only where every cell was judged and none is suspected it says that no cracks are suspected,
        and that hair cracks can be missed all the same.
        """
        return self._text(self.unjudged_text)

    @property
    def short_text(self) -> str:
        """`text` without the reasons why cells can't be judged."""
        return self._text(self._unjudged("" if self._reasons else _FROM_FRAMES))

    def _text(self, unjudged: str) -> str:
        if not self.total:
            return "no cells"
        cells = "cell" if self.total == 1 else "cells"
        if unjudged and not self.judged:
            return f"{unjudged}: none suspected, none clean"
        if unjudged:
            return f"{unjudged}; cracks suspected in {self.suspected}, {self.clean} clean"
        if self.suspected:
            of_all = f"{self.suspected} of {self.total} {cells}"
            return f"cracks suspected in {of_all}, {self.clean} clean"
        all_clean = "the cell is clean" if self.total == 1 else f"all {self.total} cells are clean"
        return f"no cracks are suspected: {all_clean} (hair cracks can be missed)"


_FROM_FRAMES = " from these frames"
_RANK = {state: rank for rank, state in enumerate(CellState)}


def look_at_first(cells: Iterable[CellFeatures]) -> list[CellFeatures]:
    """Sort cells by how much they want an expert's eye.

    Suspected cells come first, then those that can't be judged, then dark ones, clean ones last;
    within each the longest marks first, then the highest crack score.
    """
    return sorted(
        cells,
        key=lambda cell: (
            _RANK[state_of(cell)],
            -cell.crack_length_cells,
            -cell.crack_score,
            cell.row,
            cell.col,
        ),
    )
