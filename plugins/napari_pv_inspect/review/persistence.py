"""Stores a review in a result folder and reads it from there. No Qt, no napari.

What is stored is taken in by `collect`, in the thread that calls it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from psygnal import Signal

from napari_pv_inspect.models.history import History
from napari_pv_inspect.review import jobs as jobs
from napari_pv_inspect.review.jobs import Corrected, Loaded, TakeOver, Unstored
from napari_pv_inspect.review.journal import Done, Job, Journal, wait_for_all
from napari_pv_inspect.review.module_review import ModuleReview
from napari_pv_inspect.review.queries import NO_CELLS, ReviewView
from napari_pv_inspect.review.subject import Mask, Subject
from pv_inspect.review import Cell, ModuleData, ReviewState, ReviewStore, Verdict

__all__ = ["StoredReview"]


class StoredReview(ReviewView):
    """A review that is stored in a result folder as soon as there is one.

    Parameters
    ----------
    history : History
    rater : str
        Name of the person who judges.
    make_journal : callable, optional
        Makes the queue of things to store.

    Attributes
    ----------
    reviewed : Subject or None
        What the verdicts are about, also while its cells are not shown.
    given_up : int
        How many entries the user has agreed to lose.
    module_data : ModuleData
    """

    module_data_changed = Signal(object)
    folder_wanted = Signal(str)
    failed = Signal(str)
    remembered = Signal(object)
    flush_wanted = Signal()

    def __init__(
        self, history: History, rater: str, make_journal: Callable[..., Journal] = Journal
    ) -> None:
        super().__init__(rater)
        self._history = history
        self._make_journal = make_journal
        self._journal = self._new_journal()
        self._earlier: list[Journal] = []
        self._asked_for_folder = False
        self._version = self.given_up = 0
        self.reviewed: Subject | None = None
        self.module_data = ModuleData()

    @property
    def folder(self) -> Path | None:
        """Where verdicts are stored; None as long as the inspection is not saved."""
        return self._journal.folder

    @property
    def pending(self) -> int:
        """How many things are not stored yet."""
        return self._journal.pending + sum(journal.pending for journal in self._earlier)

    @property
    def is_failing(self) -> bool:
        """Whether storing fails just now."""
        return any(journal.failing for journal in (*self._earlier, self._journal))

    # What is reviewed, where, and by whom

    def show(self, subject: Subject | None, folder: Path | None = None) -> None:
        """Review something else.

        Verdicts stay with the folder as long as the module is the same one: the next run of it
        goes on where this one is.
        """
        other_folder = folder is not None and self.folder not in (None, folder)
        leaves = not _same_module(self.reviewed, subject) or other_folder
        if leaves:
            self.flush_wanted.emit()
        self.subject = self.reviewed = subject
        self.why_empty = NO_CELLS
        if subject is not None and subject.cracks is not None:
            self.threshold = subject.cracks.threshold
        cells = () if subject is None or subject.cracks is None else subject.cracks.cells
        self._found = {(cell.row, cell.col): cell for cell in cells}
        if leaves:
            self._begin_another()
        elif self.folder is not None:
            self._reload()  # marks are measured on the new image
        self.subject_changed.emit(subject)
        self.listing_changed.emit()
        if folder is not None:
            self.attach(folder)

    def empty(self, why: str) -> None:
        """Show no cells until the next run; what was said stays with the module.

        Parameters
        ----------
        why : str
            One sentence, also what to do.
        """
        if self.subject is None and why == self.why_empty:
            return
        self.flush_wanted.emit()
        self.subject, self.why_empty, self._found = None, why, {}
        self.subject_changed.emit(None)
        self.listing_changed.emit()

    def attach(self, folder: Path) -> None:
        """Store in this result folder from now on, and read what is there.

        What was judged before, by whomever, goes there as well.
        """
        if self.subject is None:
            return
        old = self.folder
        if old is not None and old != folder:
            review, data = self._module_review, self.module_data
            unstored = [
                Unstored(
                    rater,
                    cell,
                    review.raters[rater].verdicts.get(cell),
                    review.raters[rater].notes.get(cell, ""),
                    review.raters[rater].corrected.get(cell),
                )
                for rater, cell in review.unstored()
            ]
            self._begin_another()
            # What was said stays in sight until the other folder is read.
            self._module_review, self.module_data = review.without_pending(), data
            self._journal.attach(folder, TakeOver(old, unstored), self._on_taken)
            self._reload()
            return
        waiting = self._journal.pending > 0
        self._journal.attach(folder, self._load, self._on_first_loaded)
        if waiting:
            self._reload()

    def set_rater(self, rater: str) -> None:
        """Judge as somebody else; an empty name changes nothing."""
        rater = rater.strip()
        if not rater or rater == self.rater:
            return
        self.flush_wanted.emit()
        self.rater = rater
        self.verdicts_changed.emit()
        self.marks_changed.emit(None)
        if self.folder is not None:
            self._reload()

    def describe(self, data: ModuleData) -> None:
        """Store what is known about the module."""
        if data != self.module_data:
            self.module_data = data
            self._submit(None, lambda store: store.describe(data))
            self._need_folder()

    def remember(self, cell: Cell) -> None:
        """Store where the rater is, if there is a folder."""
        if self.folder is not None:
            state = ReviewState(self.rater, *cell)
            self._submit(None, lambda store: store.remember(state))

    def after_storing(self, call: Callable[[], None]) -> None:
        """Call something as soon as all that was said so far is stored."""
        self._submit(None, lambda _: None, lambda _: call())
        self._need_folder()

    # What comes back

    def collect(self) -> None:
        """Take in what the threads have stored and read."""
        for journal in (*self._earlier, self._journal):
            journal.collect()
        self._earlier = [journal for journal in self._earlier if journal.pending]

    def wait(self, timeout_s: float) -> bool:
        """Wait until everything is stored; False if it can't be."""
        stored = wait_for_all([*self._earlier, self._journal], timeout_s)
        self.collect()
        return stored

    def close(self) -> None:
        """Store nothing more; `wait` first."""
        for journal in (*self._earlier, self._journal):
            journal.close(give_up=True)

    def _submit(
        self, cell: Cell | None, job: Job, done: Done | None = None, rater: str | None = None
    ) -> None:
        """Have something stored; ``done`` is not called if another review is shown by then."""
        review = self._module_review
        own = review.rater_review(rater or self.rater)
        if cell is not None:
            own.unstored[cell] += 1

        def stored(value: Any) -> None:
            if cell is not None:
                own.unstored[cell] -= 1
            if done is not None and review is self._module_review:
                done(value)
            self.verdicts_changed.emit()

        self._journal.submit(job, stored)

    def _put_marks(self, rater: str, cell: Cell, corrected: Corrected | None) -> None:
        self._module_review.rater_review(rater).put_marks(cell, corrected)
        if rater == self.rater:
            self.marks_changed.emit(cell)

    def _reload(self) -> None:
        self._journal.submit(self._loader(), self._on_loaded)

    def _load(self, store: ReviewStore) -> Loaded:
        return jobs.load(store, self.rater)

    def _loader(self) -> Job:
        rater = self.rater
        return lambda store: jobs.load(store, rater)

    def _on_taken(self, sentence: str) -> None:
        if sentence:
            self.failed.emit(sentence)

    def _on_first_loaded(self, found: Loaded) -> None:
        """Say so where the folder knows another verdict than the one given before it was known."""
        review = self._module_review
        given = {(r, c): review.raters[r].verdicts.get(c) for r, c in review.unstored()}
        differ = 0
        for verdict in found.verdicts:
            newer = given.get((verdict.rater, verdict.cell))
            differ += newer is not None and newer.kind is not verdict.kind
        if differ:
            self.failed.emit(
                f"{self.folder} had other verdicts of yours on {differ} of the cells: the new ones "
                "count, Undo brings the earlier ones back."
            )
        self._on_loaded(found)

    def _on_loaded(self, found: Loaded) -> None:
        own = self._module_review.rater_review(found.rater)
        own.take_notes(found.notes)
        for cell in own.take_masks(found.masks):
            self._measure(found.rater, cell, found.masks[cell])
        self._on_verdicts(found.verdicts)
        if found.rater != self.rater:
            return
        self.marks_changed.emit(None)
        if self.module_data == ModuleData():
            self.module_data = found.module_data
            self.module_data_changed.emit(found.module_data)
        if found.state is not None:
            self.remembered.emit((found.state.row, found.state.col))

    def _measure(self, rater: str, cell: Cell, mask: Mask) -> None:
        """Measure marks in the journal's thread; verdicts are shown without them."""
        review, subject = self._module_review, self.subject
        own = review.rater_review(rater)
        stroke = own.strokes[cell]

        def measured(found: Corrected | None) -> None:
            if review is self._module_review and stroke == own.strokes[cell]:
                self._put_marks(rater, cell, found)

        self._journal.later(lambda: Corrected.of(subject, cell, mask), measured)

    def _read_if_changed(self, store: ReviewStore) -> tuple[Verdict, ...] | None:
        """Verdicts, if another process has stored something; runs in the journal's thread."""
        version = store.data_version()
        changed = version != self._version
        self._version = version
        return store.current() if changed else None

    def _on_verdicts(self, verdicts: Iterable[Verdict]) -> None:
        self._module_review.take_all_verdicts(verdicts)
        self.verdicts_changed.emit()

    def _need_folder(self) -> None:
        if self.folder is None and not self._asked_for_folder:
            self._asked_for_folder = True
            self.folder_wanted.emit(
                "Verdicts are kept in the result folder: save the result, they go there with it."
            )

    def _begin_another(self) -> None:
        """Begin another review; what is pending is stored all the same."""
        if self.folder is None and self._journal.pending > self.given_up:
            self.failed.emit(
                f"{self._journal.pending} entries of the review were not stored, because the "
                "result was never saved."
            )
        if self.folder is not None or self._journal.pending:
            if self.folder is not None:
                self._earlier.append(self._journal)
            self._journal.close(give_up=False)
            self._journal = self._new_journal()
            self._history.clear()
        self._asked_for_folder = False
        self.given_up = 0
        self._module_review = ModuleReview()
        self._version = 0
        self.module_data = ModuleData()

    def _new_journal(self) -> Journal:
        return self._make_journal(self.failed.emit, self._read_if_changed, self._on_verdicts)


def _same_module(a: Subject | None, b: Subject | None) -> bool:
    if a is None or b is None or a.inspection is None or b.inspection is None:
        return False
    same_layout = a.tiles.grid.layout == b.tiles.grid.layout
    return same_layout and a.inspection.sequence is b.inspection.sequence
