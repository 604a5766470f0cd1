"""Stores a review in a result folder and reads it from there. No Qt, no napari.

What was stored and read is taken in by `collect`, in the thread that calls it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from psygnal import Signal

from napari_pv_inspect.models.history import History
from napari_pv_inspect.review import jobs as jobs
from napari_pv_inspect.review.data import ALL_MARKS, VERDICTS, ReviewChange, ReviewData
from napari_pv_inspect.review.jobs import Corrected, Loaded, TakeOver, Unstored
from napari_pv_inspect.review.journal import Done, Job, Journal, wait_for_all
from napari_pv_inspect.review.module_review import ModuleReview
from napari_pv_inspect.review.subject import Mask
from pv_inspect.review import Cell, ModuleData, ReviewState, ReviewStore, Verdict

__all__ = ["ReviewStorage"]


class ReviewStorage:
    """Stores what is said in a result folder, as soon as there is one.

    Parameters
    ----------
    data : ReviewData
    history : History
    make_journal : callable, optional
        Makes the queue of things to store.

    Attributes
    ----------
    given_up : int
        How many entries the user has agreed to lose.
    module_data : ModuleData
    """

    module_data_changed = Signal(object)
    folder_wanted = Signal(str)
    """One sentence that asks the user to save the result; once."""
    failed = Signal(str)
    remembered = Signal(object)
    """The cell that the rater had selected last."""
    flush_wanted = Signal()
    """Widgets hand over what is typed but not entered yet."""

    def __init__(
        self,
        data: ReviewData,
        history: History,
        make_journal: Callable[..., Journal] = Journal,
    ) -> None:
        self._data = data
        self._history = history
        self._make_journal = make_journal
        self._journal = self._new_journal()
        self._earlier: list[Journal] = []
        self._asked_for_folder = False
        self._version = self.given_up = 0
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

    def attach(self, folder: Path) -> None:
        """Store in this result folder from now on, and read what is there.

        What was judged before, by whomever, goes there as well.
        """
        if self._data.subject is None:
            return
        old = self.folder
        if old is not None and old != folder:
            review, data = self._data.module_review, self.module_data
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
            self.begin_another()
            # What was said stays in sight until the other folder is read.
            self._data.module_review, self.module_data = review.without_pending(), data
            self._journal.attach(folder, TakeOver(old, unstored), self._on_taken)
            self.reload()
            return
        waiting = self._journal.pending > 0
        self._journal.attach(folder, self._load, self._on_first_loaded)
        if waiting:
            self.reload()

    def describe(self, data: ModuleData) -> None:
        """Store what is known about the module."""
        if data != self.module_data:
            self.module_data = data
            self.submit(None, lambda store: store.describe(data))
            self.ask_for_folder()

    def remember(self, cell: Cell) -> None:
        """Store where the rater is, if there is a folder."""
        if self.folder is not None:
            state = ReviewState(self._data.rater, *cell)
            self.submit(None, lambda store: store.remember(state))

    def after_storing(self, call: Callable[[], None]) -> None:
        """Call something as soon as all that was said so far is stored."""
        self.submit(None, lambda _: None, lambda _: call())
        self.ask_for_folder()

    # What comes back

    def collect(self) -> None:
        """Take in what the threads have stored and read."""
        with self._data.one_change():
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

    def submit(
        self, cell: Cell | None, job: Job, done: Done | None = None, rater: str | None = None
    ) -> None:
        """Have something stored; ``done`` is not called if another review is shown by then."""
        review = self._data.module_review
        own = review.rater_review(rater or self._data.rater)
        if cell is not None:
            own.unstored[cell] += 1

        def stored(value: Any) -> None:
            if cell is not None:
                own.unstored[cell] -= 1
            if done is not None and review is self._data.module_review:
                done(value)
            self._data.tell(VERDICTS)

        self._journal.submit(job, stored)

    def put_marks(self, rater: str, cell: Cell, corrected: Corrected | None) -> None:
        """Show marks with their features; None: those of the detector."""
        self._data.module_review.rater_review(rater).put_marks(cell, corrected)
        if rater == self._data.rater:
            self._data.tell(ReviewChange(marks=frozenset({cell})))

    def reload(self) -> None:
        """Read what is stored again."""
        self._journal.submit(self._loader(), self._on_loaded)

    def _load(self, store: ReviewStore) -> Loaded:
        return jobs.load(store, self._data.rater)

    def _loader(self) -> Job:
        rater = self._data.rater
        return lambda store: jobs.load(store, rater)

    def _on_taken(self, sentence: str) -> None:
        if sentence:
            self.failed.emit(sentence)

    def _on_first_loaded(self, found: Loaded) -> None:
        """Tell of verdicts in the folder that differ from those given before it was read."""
        review = self._data.module_review
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
        own = self._data.module_review.rater_review(found.rater)
        own.take_notes(found.notes)
        for cell in own.take_masks(found.masks):
            self.measure(found.rater, cell, found.masks[cell])
        self._on_verdicts(found.verdicts)
        if found.rater != self._data.rater:
            return
        self._data.tell(ALL_MARKS)
        if self.module_data == ModuleData():
            self.module_data = found.module_data
            self.module_data_changed.emit(found.module_data)
        if found.state is not None:
            self.remembered.emit((found.state.row, found.state.col))

    def measure(self, rater: str, cell: Cell, mask: Mask) -> None:
        """Measure marks in the journal's thread; verdicts are shown without them."""
        review, subject = self._data.module_review, self._data.subject
        own = review.rater_review(rater)
        revision = own.revisions[cell]

        def measured(found: Corrected | None) -> None:
            if review is self._data.module_review and revision == own.revisions[cell]:
                self.put_marks(rater, cell, found)

        self._journal.later(lambda: Corrected.of(subject, cell, mask), measured)

    def _read_if_changed(self, store: ReviewStore) -> tuple[Verdict, ...] | None:
        """Verdicts, if another process has stored something; runs in the journal's thread."""
        version = store.data_version()
        changed = version != self._version
        self._version = version
        return store.current() if changed else None

    def _on_verdicts(self, verdicts: Iterable[Verdict]) -> None:
        self._data.module_review.take_all_verdicts(verdicts)
        self._data.tell(VERDICTS)

    def ask_for_folder(self) -> None:
        """Tell the user once that what is said needs a folder, while there is none."""
        if self.folder is None and not self._asked_for_folder:
            self._asked_for_folder = True
            self.folder_wanted.emit(
                "Verdicts are kept in the result folder: save the result, they go there with it."
            )

    def begin_another(self) -> None:
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
        self._data.module_review = ModuleReview()
        self._version = 0
        self.module_data = ModuleData()

    def _new_journal(self) -> Journal:
        return self._make_journal(self.failed.emit, self._read_if_changed, self._on_verdicts)
