"""State of the review: verdicts, corrected marks, what the gallery lists. No Qt, no napari.

All signals are emitted in the main thread, those about stored things by `collect`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from psygnal import Signal

from napari_pv_inspect import review_jobs as jobs
from napari_pv_inspect.history import Action, History
from napari_pv_inspect.review_book import Book
from napari_pv_inspect.review_jobs import Corrected, Edit, Loaded, Stepped
from napari_pv_inspect.review_journal import Done, Job, Journal, wait_for_all
from napari_pv_inspect.review_subject import Mask, Subject
from pv_inspect.cracks import CellFeatures
from pv_inspect.review import (
    Cell,
    ModuleData,
    Order,
    Progress,
    ReviewState,
    ReviewStore,
    Verdict,
    VerdictKind,
    filtered,
    fingerprint,
    next_unjudged,
    ordered,
    progress,
)

__all__ = ["EVERY", "ReviewModel"]

EVERY: tuple[VerdictKind | None, ...] = (None, *VerdictKind)
"""Filter that leaves nothing out; None stands for cells without a verdict."""


class ReviewModel:
    """What is reviewed and what was said about it.

    Parameters
    ----------
    history : History
    rater : str
        Name of the person who judges.
    make_journal : callable, optional
        Makes the line of things to store.

    Attributes
    ----------
    subject : Subject or None
    rater : str
    order : Order
    kinds : tuple of VerdictKind or None
        Verdicts of the cells that are listed.
    threshold : float
        Probability from which pixels are painted as cracks.
    module_data : ModuleData
    """

    subject_changed = Signal(object)
    listing_changed = Signal()
    verdicts_changed = Signal()
    marks_changed = Signal(object)
    threshold_changed = Signal(float)
    module_data_changed = Signal(object)
    folder_wanted = Signal(str)
    failed = Signal(str)
    remembered = Signal(object)

    def __init__(
        self,
        history: History,
        rater: str,
        make_journal: Callable[..., Journal] = Journal,
    ) -> None:
        self._history = history
        self._make_journal = make_journal
        self._journal = self._new_journal()
        self._earlier: list[Journal] = []
        self._asked_for_folder = False
        self._found: dict[Cell, CellFeatures] = {}
        self._book = Book()
        self._version = 0
        self.subject: Subject | None = None
        self.rater = rater
        self.order = Order.POSITION
        self.kinds = EVERY
        self.threshold = 0.5
        self.module_data = ModuleData()

    # What there is

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
        return self._journal.failing

    def is_pending(self, cell: Cell) -> bool:
        """Whether something about the cell is not stored yet."""
        return self._book.unstored[cell] > 0

    def verdict(self, cell: Cell) -> Verdict | None:
        """Verdict of the rater."""
        return self._book.mine.get(cell)

    def others(self, cell: Cell) -> list[Verdict]:
        """Verdicts of the other raters."""
        return self._book.others.get(cell, [])

    def features(self, cell: Cell) -> CellFeatures | None:
        """Features of a cell, those of the corrected marks if there are any."""
        corrected = self._book.corrected.get(cell)
        if corrected is not None and corrected.features is not None:
            return corrected.features
        return self._found.get(cell)

    def correction(self, cell: Cell) -> Mask | None:
        """Marks as the rater corrected them; None if they are the detector's.

        Marks that were drawn on an image of another size do not count.
        """
        corrected = self._book.corrected.get(cell)
        if corrected is None or self.subject is None:
            return None
        fits = corrected.mask.shape == self.subject.tiles.images.shape[2:]
        return corrected.mask if fits else None

    def marks(self, cell: Cell) -> Mask | None:
        """Marks that are shown, (h, w) bool."""
        mask = self.correction(cell)
        if mask is None and self.subject is not None:
            mask = self.subject.marks(cell, self.threshold)
        return mask

    def note(self, cell: Cell) -> str:
        """Note about a cell, also one that waits for its verdict."""
        verdict = self.verdict(cell)
        return self._book.notes.get(cell, "" if verdict is None else verdict.note)

    @property
    def listed(self) -> tuple[Cell, ...]:
        """Cells that pass the filter, in order."""
        passed = filtered(self._ordered(), self._book.mine, self.kinds)
        return tuple((f.row, f.col) for f in passed)

    @property
    def progress(self) -> Progress | None:
        """How many cells the rater has judged."""
        if self.subject is None:
            return None
        return progress(self._book.mine.values(), self.subject.tiles.grid.layout)

    def next_unjudged(self, after: Cell | None) -> Cell | None:
        """Next cell without a verdict among those that are listed; None if there is none."""
        listed = {*self.listed, after}
        cells = [f for f in self._ordered() if (f.row, f.col) in listed]
        return next_unjudged(cells, self._book.mine, after)

    # What is shown

    def show(self, subject: Subject | None, folder: Path | None = None) -> None:
        """Review something else.

        Verdicts stay with the folder as long as the module is the same one: the next run of it
        goes on where this one is.
        """
        before, self.subject = self.subject, subject
        if subject is not None and subject.cracks is not None:
            self.threshold = subject.cracks.threshold
        cells = () if subject is None or subject.cracks is None else subject.cracks.cells
        self._found = {(cell.row, cell.col): cell for cell in cells}
        other_folder = folder is not None and self.folder not in (None, folder)
        if not _same_module(before, subject) or other_folder:
            self._leave()
        elif self.folder is not None:
            self._reload()  # marks are measured on the new image
        self.subject_changed.emit(subject)
        self.listing_changed.emit()
        if folder is not None:
            self.attach(folder)

    def attach(self, folder: Path) -> None:
        """Store in this result folder from now on, and read what is there.

        What was judged before goes there as well.
        """
        if self.subject is None:
            return
        take_along: list[Job] = []
        if self.folder is not None and self.folder != folder:
            book = self._book
            take_along = [jobs.take_verdict(verdict) for verdict in book.mine.values()]
            take_along += [jobs.take_marks(*entry, self.rater) for entry in book.corrected.items()]
            self._leave()
        waiting = self._journal.pending > 0
        self._journal.attach(folder, self._load, self._on_loaded)
        for job in take_along:
            self._submit(None, job)
        if waiting or take_along:
            self._reload()

    def set_rater(self, rater: str) -> None:
        """Judge as somebody else; an empty name changes nothing."""
        rater = rater.strip()
        if not rater or rater == self.rater:
            return
        self.rater = rater
        self._book = self._book.for_rater(rater)
        self.verdicts_changed.emit()
        self.marks_changed.emit(None)
        if self.folder is not None:
            self._reload()

    def set_order(self, order: Order) -> None:
        """List the cells in another order."""
        self.order = order
        self.listing_changed.emit()

    def set_filter(self, kinds: Iterable[VerdictKind | None]) -> None:
        """List cells with these verdicts only; None stands for cells without one."""
        self.kinds = tuple(kinds)
        self.listing_changed.emit()

    def set_threshold(self, threshold: float) -> None:
        """Paint pixels as cracks from this probability on; nothing is measured again."""
        self.threshold = threshold
        self.threshold_changed.emit(threshold)

    # What is said

    def give(self, cell: Cell, kind: VerdictKind) -> None:
        """Judge a cell; the note that waits for it goes with it."""
        known, note = self.verdict(cell), self.note(cell)
        if known is None or (known.kind, known.note) != (kind, note):
            self._give(cell, kind, note, f"Verdict {kind.label}")

    def write_note(self, cell: Cell, text: str) -> None:
        """Note something about a cell; without a verdict it waits for that."""
        verdict = self.verdict(cell)
        if text == self.note(cell):
            return
        if verdict is None:
            self._book.notes[cell] = text
        else:
            self._give(cell, verdict.kind, text, "Note")

    def withdraw(self, cell: Cell) -> None:
        """Take a verdict back: the cell is not judged any more."""
        if self.verdict(cell) is not None:
            self._say(cell, None, "Withdraw a verdict")

    def correct(self, cell: Cell, mask: Mask | None) -> None:
        """Correct the marks of a cell; None goes back to what the detector found."""
        subject = self.subject
        if subject is None or subject.cracks is None:
            self.failed.emit("The cracks are still looked for: correct their marks afterwards.")
            return
        drawn = None if mask is None else Corrected(mask.copy(), self.features(cell))
        mask = None if drawn is None else drawn.mask
        before = self._book.corrected.get(cell)

        def first(edit: Edit) -> None:
            book, stroke = self._book, self._book.strokes[cell] + 1  # `show` follows

            def measured(found: Corrected | None) -> None:
                if stroke == book.strokes[cell]:
                    self._put_marks(cell, found)

            self._submit(cell, lambda store: jobs.store_marks(store, subject, edit, mask), measured)

        def show(done: bool) -> None:
            self._book.strokes[cell] += 1
            self._put_marks(cell, drawn if done else before)

        text = "Reset marks" if mask is None else "Correct crack marks"
        self._perform(cell, text, first, show)

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

    def undo_stored(self) -> None:
        """Take back the rater's last edit of an earlier session."""
        subject, rater = self.subject, self.rater
        if self.folder is not None:
            self._submit(None, lambda store: jobs.step_back(store, subject, rater), self._on_step)

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

    def _give(self, cell: Cell, kind: VerdictKind, note: str, text: str) -> None:
        if self.subject is None:
            return
        made_with = fingerprint(self.subject.settings)
        self._say(cell, Verdict(*cell, kind, self.rater, note, made_with), text)

    def _say(self, cell: Cell, verdict: Verdict | None, text: str) -> None:
        before = self.verdict(cell)

        def first(edit: Edit) -> None:
            self._book.notes.pop(cell, None)
            self._submit(cell, lambda store: jobs.store_verdict(store, edit, verdict))

        self._perform(
            cell, text, first, lambda done: self._put_verdict(cell, verdict if done else before)
        )

    def _perform(
        self, cell: Cell, text: str, first: Callable[[Edit], None], show: Callable[[bool], None]
    ) -> None:
        """Make an edit that can be taken back; what is shown never waits for the store."""
        edit = Edit(self.rater, cell)
        is_new = True

        def do() -> None:
            nonlocal is_new
            if is_new:
                is_new = False
                first(edit)
                show(True)
            else:
                step("redo")

        def step(way: str) -> None:
            self._step(way, edit)
            if edit.rater == self.rater:
                show(way == "redo")

        self._history.perform(Action(f"{text}, {_place(cell)}", do, lambda: step("undo")))
        self._need_folder()

    def _step(self, way: str, edit: Edit) -> None:
        subject = self.subject

        def took(found: Stepped | None) -> None:
            if found is None or edit.rater != self.rater:
                self._reload()
            else:
                self._on_step(found)

        self._submit(edit.cell, lambda store: jobs.step(store, way, subject, edit), took)

    def _on_step(self, found: Stepped | None) -> None:
        """Take over what the store made of an undo, unless more was said about the cell since."""
        if found is None:
            return
        change = found.change
        if change.superseded:
            self.failed.emit(
                f"{_place(change.cell).capitalize()} was changed in another window meanwhile: "
                "what was said there stays."
            )
        if self._book.unstored[change.cell]:
            if change.superseded:
                self._reload()
            return
        self._put_verdict(change.cell, change.verdict)
        if change.mask_changed or change.superseded:
            self._book.strokes[change.cell] += 1
            self._put_marks(change.cell, found.corrected)

    def _submit(self, cell: Cell | None, job: Job, done: Done | None = None) -> None:
        """Have something stored; ``done`` is not called if another book is open by then."""
        book = self._book
        if cell is not None:
            book.unstored[cell] += 1

        def stored(value: Any) -> None:
            if cell is not None:
                book.unstored[cell] -= 1
            if done is not None and book is self._book:
                done(value)
            self.verdicts_changed.emit()

        self._journal.submit(job, stored)

    def _put_verdict(self, cell: Cell, verdict: Verdict | None) -> None:
        self._book.put_verdict(cell, verdict)
        self.verdicts_changed.emit()

    def _put_marks(self, cell: Cell, corrected: Corrected | None) -> None:
        self._book.put_marks(cell, corrected)
        self.marks_changed.emit(cell)

    def _reload(self) -> None:
        self._journal.submit(self._load, self._on_loaded)

    def _load(self, store: ReviewStore) -> Loaded:
        return jobs.load(store, self.rater)

    def _on_loaded(self, found: Loaded) -> None:
        if found.rater != self.rater:
            return
        for cell in self._book.take_masks(found.masks):
            self._measure(cell, found.masks[cell])
        self._on_verdicts(found.verdicts)
        self.marks_changed.emit(None)
        if self.module_data == ModuleData():
            self.module_data = found.module_data
            self.module_data_changed.emit(found.module_data)
        if found.state is not None:
            self.remembered.emit((found.state.row, found.state.col))

    def _measure(self, cell: Cell, mask: Mask) -> None:
        """Measure stored marks when there is time; verdicts are shown without it."""
        book, subject, stroke = self._book, self.subject, self._book.strokes[cell]

        def measured(found: Corrected | None) -> None:
            if book is self._book and stroke == book.strokes[cell] and not book.unstored[cell]:
                self._put_marks(cell, found)

        self._journal.later(lambda _: Corrected.of(subject, cell, mask), measured)

    def _look(self, store: ReviewStore) -> tuple[Verdict, ...] | None:
        """Verdicts, if another process has stored something; runs in the journal's thread."""
        version = store.data_version()
        changed = version != self._version
        self._version = version
        return store.current() if changed else None

    def _on_verdicts(self, verdicts: Iterable[Verdict]) -> None:
        self._book.sort_out(verdicts, self.rater)
        self.verdicts_changed.emit()

    def _ordered(self) -> tuple[CellFeatures, ...]:
        if self.subject is None:
            return ()
        blank = {at: CellFeatures(*at, 0.0, 0, 0.0, 0.0, 0.0) for at in self.subject.places}
        return ordered({**blank, **self._found}.values(), self._book.mine, self.order)

    def _need_folder(self) -> None:
        if self.folder is None and not self._asked_for_folder:
            self._asked_for_folder = True
            self.folder_wanted.emit(
                "Verdicts are kept in the result folder: save the result, they go there with it."
            )

    def _leave(self) -> None:
        """Begin another review; what is pending is stored all the same."""
        if self.folder is None and self._journal.pending:
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
        self._book = Book()
        self._version = 0
        self.module_data = ModuleData()

    def _new_journal(self) -> Journal:
        return self._make_journal(self.failed.emit, self._look, self._on_verdicts)


def _place(cell: Cell) -> str:
    return f"row {cell[0] + 1}, column {cell[1] + 1}"


def _same_module(a: Subject | None, b: Subject | None) -> bool:
    if a is None or b is None or a.inspection is None or b.inspection is None:
        return False
    return a.inspection.sequence is b.inspection.sequence
