"""The review of a module: made of its data, queries, listing, storage and commands.

No Qt, no napari. All signals are emitted in the main thread, those about stored things by
`ReviewStorage.collect`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from napari_pv_inspect.models.history import History
from napari_pv_inspect.review.commands import ReviewCommands
from napari_pv_inspect.review.data import ALL_MARKS, NO_CELLS, VERDICTS, ReviewData
from napari_pv_inspect.review.journal import Journal
from napari_pv_inspect.review.listing import CellListing
from napari_pv_inspect.review.persistence import ReviewStorage
from napari_pv_inspect.review.queries import ReviewQueries
from napari_pv_inspect.review.subject import Subject

__all__ = ["ReviewModel"]


class ReviewModel:
    """A review, and what it is about.

    Parameters
    ----------
    history : History
        Where its edits are undone.
    rater : str
        Name of the person who judges.
    make_journal : callable, optional
        Makes the queue of things to store.

    Attributes
    ----------
    history : History
    data : ReviewData
        Subject, rater, and the signals.
    cells : ReviewQueries
        What is known about the cells.
    listing : CellListing
        Which cells are listed.
    storage : ReviewStorage
    commands : ReviewCommands
        What changes verdicts, notes and marks.
    """

    def __init__(
        self, history: History, rater: str, make_journal: Callable[..., Journal] = Journal
    ) -> None:
        self.history = history
        self.data = ReviewData(rater)
        self.cells = ReviewQueries(self.data)
        self.listing = CellListing(self.data, self.cells)
        self.storage = ReviewStorage(self.data, history, make_journal)
        self.commands = ReviewCommands(self.data, self.cells, self.storage, history)

    def show(self, subject: Subject | None, folder: Path | None = None) -> None:
        """Review something else.

        Verdicts stay with the folder as long as the module is the same one: the next run of it
        goes on where this one is.
        """
        data, storage = self.data, self.storage
        other_folder = folder is not None and storage.folder not in (None, folder)
        leaves = not _same_module(data.reviewed, subject) or other_folder
        if leaves:
            storage.flush_wanted.emit()
        cracks = None if subject is None else subject.cracks
        data.subject = data.reviewed = subject
        data.why_empty = NO_CELLS
        if cracks is not None:
            data.threshold = cracks.threshold
        data.detected = {(c.row, c.col): c for c in (() if cracks is None else cracks.cells)}
        if leaves:
            storage.begin_another()
        elif storage.folder is not None:
            storage.reload()  # marks are measured on the new image
        data.subject_changed.emit(subject)
        if folder is not None:
            storage.attach(folder)

    def empty(self, why: str) -> None:
        """Show no cells until the next run; what was said stays with the module.

        Parameters
        ----------
        why : str
            One sentence, also what to do.
        """
        data = self.data
        if data.subject is None and why == data.why_empty:
            return
        self.storage.flush_wanted.emit()
        data.subject, data.why_empty, data.detected = None, why, {}
        data.subject_changed.emit(None)

    def set_rater(self, rater: str) -> None:
        """Judge as somebody else; an empty name changes nothing."""
        rater = rater.strip()
        if not rater or rater == self.data.rater:
            return
        self.storage.flush_wanted.emit()
        self.data.rater = rater
        self.data.tell(VERDICTS | ALL_MARKS)
        if self.storage.folder is not None:
            self.storage.reload()


def _same_module(a: Subject | None, b: Subject | None) -> bool:
    if a is None or b is None or a.inspection is None or b.inspection is None:
        return False
    same_layout = a.tiles.grid.layout == b.tiles.grid.layout
    return same_layout and a.inspection.sequence is b.inspection.sequence
