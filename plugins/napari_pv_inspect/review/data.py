"""State of a review in memory, and the signals that tell of its changes. No Qt, no napari."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

from psygnal import Signal

from napari_pv_inspect.review.module_review import ModuleReview, RaterReview
from napari_pv_inspect.review.subject import Subject
from pv_inspect.cracks import CellFeatures
from pv_inspect.review import Cell

__all__ = ["ALL_MARKS", "NO_CELLS", "VERDICTS", "ReviewChange", "ReviewData"]

NO_CELLS = "There are no cells yet: run the inspection first."


@dataclass(frozen=True)
class ReviewChange:
    """What one change of a review is about.

    Attributes
    ----------
    verdicts : bool
        Verdicts, notes, or what of them is stored.
    marks : frozenset of (row, col)
        Cells whose marks or features are others now.
    all_marks : bool
        Those of all cells may be others.
    """

    verdicts: bool = False
    marks: frozenset[Cell] = frozenset()
    all_marks: bool = False

    def __or__(self, other: ReviewChange) -> ReviewChange:
        return ReviewChange(
            self.verdicts or other.verdicts,
            self.marks | other.marks,
            self.all_marks or other.all_marks,
        )

    @property
    def has_marks(self) -> bool:
        """Whether marks of any cell are others."""
        return self.all_marks or bool(self.marks)

    def marks_of(self, cell: Cell | None) -> bool:
        """Whether the marks of this cell are others."""
        return self.all_marks or cell in self.marks


VERDICTS = ReviewChange(verdicts=True)
ALL_MARKS = ReviewChange(all_marks=True)


class ReviewData:
    """What is reviewed, by whom, and what was said about it.

    Attributes
    ----------
    subject : Subject or None
        What is shown and can be judged.
    reviewed : Subject or None
        What the verdicts are about, also while its cells are not shown.
    why_empty : str
        One sentence for when there is no subject.
    rater : str
    threshold : float
        Probability from which pixels are painted as cracks.
    detected : mapping of Cell to CellFeatures
        What the detector found; empty while it has not said anything.
    module_review : ModuleReview
        Verdicts, notes and marks of all raters.
    """

    subject_changed = Signal(object)
    """The subject: all that is shown about cells is another now. No other signal comes with it."""
    changed = Signal(object)
    """ReviewChange, once for all that changed together."""
    threshold_changed = Signal(float)

    def __init__(self, rater: str) -> None:
        self.subject: Subject | None = None
        self.reviewed: Subject | None = None
        self.why_empty = NO_CELLS
        self.rater = rater
        self.threshold = 0.5
        self.detected: Mapping[Cell, CellFeatures] = {}
        self.module_review = ModuleReview()
        self._depth = 0
        self._collected = ReviewChange()

    @property
    def rater_review(self) -> RaterReview:
        """What the current rater said."""
        return self.module_review.rater_review(self.rater)

    def set_threshold(self, threshold: float) -> None:
        """Paint pixels as cracks from this probability on; nothing is measured again."""
        self.threshold = threshold
        self.threshold_changed.emit(threshold)

    @contextmanager
    def one_change(self) -> Generator[None]:
        """Tell of all that changes inside the context by one signal, at its end."""
        self._depth += 1
        try:
            yield
        finally:
            self._depth -= 1
            if self._depth == 0:
                change, self._collected = self._collected, ReviewChange()
                if change != ReviewChange():
                    self.changed.emit(change)

    def tell(self, change: ReviewChange) -> None:
        """Tell of a change, inside `one_change` at its end."""
        with self.one_change():
            self._collected |= change
