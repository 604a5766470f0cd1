"""State of the review: verdicts, corrected marks, what the gallery lists. No Qt, no napari.

All signals are emitted in the main thread, those about stored things by `collect`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from psygnal import Signal

from napari_pv_inspect.history import Action, History
from napari_pv_inspect.review_journal import Done, Job, Journal, wait_for_all
from napari_pv_inspect.review_subject import Mask, Subject
from pv_inspect.cracks import CellFeatures
from pv_inspect.errors import InspectionError
from pv_inspect.review import (
    Cell,
    Change,
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
    of_rater,
    ordered,
    progress,
)

__all__ = ["EVERY", "ReviewModel"]

EVERY: tuple[VerdictKind | None, ...] = (None, *VerdictKind)
"""Filter that leaves nothing out; None stands for cells without a verdict."""

_Corrected = tuple[Mask, CellFeatures | None] | None


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
        self.subject: Subject | None = None
        self.rater = rater
        self.order = Order.POSITION
        self.kinds = EVERY
        self.threshold = 0.5
        self._found: dict[Cell, CellFeatures] = {}
        self._forget()

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
        return self._unstored[cell] > 0

    def verdict(self, cell: Cell) -> Verdict | None:
        """Verdict of the rater."""
        return self._mine.get(cell)

    def others(self, cell: Cell) -> list[Verdict]:
        """Verdicts of the other raters."""
        return self._others.get(cell, [])

    def features(self, cell: Cell) -> CellFeatures | None:
        """Features of a cell, those of the corrected marks if there are any."""
        return self._measured.get(cell) or self._found.get(cell)

    def correction(self, cell: Cell) -> Mask | None:
        """Marks as the rater corrected them; None if they are the detector's."""
        return self._masks.get(cell)

    def marks(self, cell: Cell) -> Mask | None:
        """Marks that are shown, (h, w) bool."""
        if self.subject is None:
            return None
        mask = self._masks.get(cell)
        if mask is not None and mask.shape == self.subject.tiles.images.shape[2:]:
            return mask
        return self.subject.marks(cell, self.threshold)

    def note(self, cell: Cell) -> str:
        """Note about a cell, also one that waits for its verdict."""
        verdict = self._mine.get(cell)
        return self._notes.get(cell, "" if verdict is None else verdict.note)

    @property
    def listed(self) -> tuple[Cell, ...]:
        """Cells that pass the filter, in order."""
        return tuple((f.row, f.col) for f in filtered(self._ordered(), self._mine, self.kinds))

    @property
    def progress(self) -> Progress | None:
        """How many cells the rater has judged."""
        if self.subject is None:
            return None
        return progress(self._mine.values(), self.subject.tiles.grid.layout)

    def next_unjudged(self, after: Cell | None) -> Cell | None:
        """Next cell without a verdict among those that are listed; None if there is none."""
        listed = set(self.listed)
        cells = [f for f in self._ordered() if (f.row, f.col) in listed or (f.row, f.col) == after]
        return next_unjudged(cells, self._mine, after)

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
        else:
            self._measured = {}
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
        said: tuple[Job, ...] = ()
        if self.folder is not None and self.folder != folder:
            said = self._all_said()
            self._leave()
        self._journal.attach(folder, self._load, self._on_loaded)
        for job in said:
            self._submit(None, job)
        if said:
            self._journal.submit(self._load, self._on_loaded)

    def set_rater(self, rater: str) -> None:
        """Judge as somebody else; an empty name changes nothing."""
        rater = rater.strip()
        if not rater or rater == self.rater:
            return
        self.rater = rater
        self._masks, self._measured, self._notes = {}, {}, {}
        self._sort_out(self._all)
        if self.folder is not None:
            self._journal.submit(self._load, self._on_loaded)

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
        known = self.verdict(cell)
        if known is not None and known.kind is kind and self.note(cell) == known.note:
            return
        self._give(cell, kind, self.note(cell), f"Verdict {kind.label}")

    def write_note(self, cell: Cell, text: str) -> None:
        """Note something about a cell; without a verdict it waits for that."""
        verdict = self.verdict(cell)
        if text == self.note(cell):
            return
        if verdict is None:
            self._notes[cell] = text
        else:
            self._give(cell, verdict.kind, text, "Note")

    def withdraw(self, cell: Cell) -> None:
        """Take a verdict back: the cell is not judged any more."""
        if self.verdict(cell) is None:
            return
        rater = self.rater

        def first() -> None:
            self._submit(cell, lambda store: store.withdraw(cell, rater))
            self._put_verdict(cell, None)

        self._perform(cell, "Withdraw a verdict", first)

    def correct(self, cell: Cell, mask: Mask | None) -> None:
        """Correct the marks of a cell; None goes back to what the detector found."""
        subject, rater = self.subject, self.rater
        if subject is None:
            return
        mask = None if mask is None else mask.copy()

        def store_it(store: ReviewStore) -> _Corrected:
            if mask is None:
                store.correct(cell, rater, None)
                return None
            features = subject.measured(cell, mask)
            length = features.crack_length_cells
            store.correct(cell, rater, mask, length, _isolated(features))
            return mask, features

        def first() -> None:
            self._strokes[cell] += 1
            stroke = self._strokes[cell]
            self._put_marks(cell, None if mask is None else (mask, self._measured.get(cell)))

            def stored(found: _Corrected) -> None:
                if rater == self.rater and stroke == self._strokes[cell]:
                    self._put_marks(cell, found)

            self._submit(cell, store_it, stored)

        self._perform(cell, "Correct crack marks" if mask is not None else "Reset marks", first)

    def describe(self, data: ModuleData) -> None:
        """Store what is known about the module."""
        if data == self.module_data:
            return
        self.module_data = data
        self._journal.submit(lambda store: store.describe(data), _nothing)
        self._need_folder()

    def remember(self, cell: Cell) -> None:
        """Store where the rater is, if there is a folder."""
        if self.folder is not None:
            state = ReviewState(self.rater, *cell)
            self._journal.submit(lambda store: store.remember(state), _nothing)

    def after_storing(self, call: Callable[[], None]) -> None:
        """Call something as soon as all that was said so far is stored."""
        self._journal.submit(_nothing, lambda _: call())
        self._need_folder()

    def undo_stored(self) -> None:
        """Take back the rater's last edit of an earlier session."""
        self._step("undo", None)

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
        verdict = Verdict(*cell, kind, self.rater, note, made_with)

        def first() -> None:
            self._submit(cell, lambda store: store.give(verdict))
            self._notes.pop(cell, None)
            self._put_verdict(cell, verdict)

        self._perform(cell, text, first)

    def _perform(self, cell: Cell, text: str, first: Callable[[], None]) -> None:
        """Do something that the store can take back: the first time, then as its redo."""
        done = False

        def do() -> None:
            nonlocal done
            if done:
                self._step("redo", cell)
            else:
                first()
                done = True

        place = f"row {cell[0] + 1}, column {cell[1] + 1}"
        self._history.perform(Action(f"{text}, {place}", do, lambda: self._step("undo", cell)))
        self._need_folder()

    def _step(self, way: str, cell: Cell | None) -> None:
        subject, rater = self.subject, self.rater

        def step(store: ReviewStore) -> tuple[Change, _Corrected] | None:
            change = store.undo(rater) if way == "undo" else store.redo(rater)
            if change is None:
                return None
            mask = store.mask(change.cell, rater)
            return change, _measured(subject, change.cell, mask)

        def done(found: tuple[Change, _Corrected] | None) -> None:
            if found is not None and rater == self.rater:
                change, corrected = found
                self._put_verdict(change.cell, change.verdict)
                if change.mask_changed:
                    self._put_marks(change.cell, corrected)

        self._submit(cell, step, done)

    def _submit(self, cell: Cell | None, job: Job, done: Done | None = None) -> None:
        unstored = self._unstored
        if cell is not None:
            unstored[cell] += 1

        def stored(value: Any) -> None:
            if cell is not None:
                unstored[cell] -= 1
            if done is not None and unstored is self._unstored:
                done(value)
            self.verdicts_changed.emit()

        self._journal.submit(job, stored)

    def _put_verdict(self, cell: Cell, verdict: Verdict | None) -> None:
        self._mine.pop(cell, None)
        if verdict is not None:
            self._mine[cell] = verdict
        self.verdicts_changed.emit()

    def _put_marks(self, cell: Cell, corrected: _Corrected) -> None:
        self._masks.pop(cell, None)
        self._measured.pop(cell, None)
        if corrected is not None:
            self._masks[cell], features = corrected
            if features is not None:
                self._measured[cell] = features
        self.marks_changed.emit(cell)

    def _load(self, store: ReviewStore) -> Any:
        subject, rater = self.subject, self.rater
        masks = store.masks(rater)
        corrected = {cell: _measured(subject, cell, mask) for cell, mask in masks.items()}
        return rater, store.current(), corrected, store.module_data(), store.remembered(rater)

    def _on_loaded(self, found: Any) -> None:
        rater, verdicts, corrected, data, state = found
        if rater != self.rater:
            return
        for cell, (mask, features) in corrected.items():
            if not self.is_pending(cell):
                self._masks[cell] = mask
                if features is not None:
                    self._measured[cell] = features
        self._sort_out(verdicts)
        self.marks_changed.emit(None)
        if self.module_data == ModuleData():
            self.module_data = data
            self.module_data_changed.emit(data)
        if state is not None:
            self.remembered.emit((state.row, state.col))

    def _look(self, store: ReviewStore) -> tuple[Verdict, ...] | None:
        """Verdicts, if another process has stored something; runs in the journal's thread."""
        version = store.data_version()
        changed = version != self._version
        self._version = version
        return store.current() if changed else None

    def _sort_out(self, verdicts: Iterable[Verdict]) -> None:
        """Take over the stored verdicts; what is pending is newer."""
        self._all = tuple(verdicts)
        stored = of_rater(self._all, self.rater)
        pending = {cell: v for cell, v in self._mine.items() if self.is_pending(cell)}
        kept = {cell: v for cell, v in stored.items() if not self.is_pending(cell)}
        self._mine = {**kept, **pending}
        self._others = {}
        for verdict in self._all:
            if verdict.rater != self.rater:
                self._others.setdefault(verdict.cell, []).append(verdict)
        self.verdicts_changed.emit()

    def _ordered(self) -> tuple[CellFeatures, ...]:
        if self.subject is None:
            return ()
        blank = {
            place: CellFeatures(*place, 0.0, 0, 0.0, 0.0, 0.0) for place in self.subject.places
        }
        return ordered({**blank, **self._found}.values(), self._mine, self.order)

    def _need_folder(self) -> None:
        if self.folder is None and not self._asked_for_folder:
            self._asked_for_folder = True
            self.folder_wanted.emit(
                "Verdicts are kept in the result folder: save the result, they go there with it."
            )

    def _leave(self) -> None:
        """Begin another review; what is pending is stored all the same."""
        if self.folder is not None or self.pending:
            if self.folder is None:
                self.failed.emit(
                    f"{self._journal.pending} entries of the review were not stored, because the "
                    "result was never saved."
                )
            else:
                self._earlier.append(self._journal)
            self._journal.close(give_up=False)
            self._journal = self._new_journal()
            self._history.clear()
        self._asked_for_folder = False
        self._forget()

    def _all_said(self) -> tuple[Job, ...]:
        """Jobs that say all of this review to another store, unless it knows better."""
        rater = self.rater

        def say(verdict: Verdict) -> Job:
            def give(store: ReviewStore) -> None:
                if verdict.cell not in of_rater(store.current(), rater):
                    store.give(verdict)

            return give

        def correct(cell: Cell, mask: Mask) -> Job:
            features = self._measured.get(cell)
            length = None if features is None else features.crack_length_cells

            def give(store: ReviewStore) -> None:
                if store.mask(cell, rater) is None:
                    store.correct(cell, rater, mask, length, _isolated(features))

            return give

        corrections = (correct(cell, mask) for cell, mask in self._masks.items())
        return (*(say(verdict) for verdict in self._mine.values()), *corrections)

    def _forget(self) -> None:
        self._all: tuple[Verdict, ...] = ()
        self._mine: dict[Cell, Verdict] = {}
        self._others: dict[Cell, list[Verdict]] = {}
        self._notes: dict[Cell, str] = {}
        self._masks: dict[Cell, Mask] = {}
        self._measured: dict[Cell, CellFeatures] = {}
        self._unstored: Counter[Cell] = Counter()
        self._strokes: Counter[Cell] = Counter()
        self._version = 0
        self.module_data = ModuleData()

    def _new_journal(self) -> Journal:
        return self._make_journal(self.failed.emit, self._look, self._sort_out)


def _measured(subject: Subject | None, cell: Cell, mask: Mask | None) -> _Corrected:
    if mask is None or subject is None:
        return None
    try:
        return mask, subject.measured(cell, mask)
    except InspectionError:  # drawn on a result of another size
        return mask, None


def _isolated(features: CellFeatures | None) -> float | None:
    """Area that is cut off; None if it is not known."""
    if features is None or math.isnan(features.isolated_area_share):
        return None
    return features.isolated_area_share


def _same_module(a: Subject | None, b: Subject | None) -> bool:
    if a is None or b is None or a.inspection is None or b.inspection is None:
        return False
    return a.inspection.sequence is b.inspection.sequence


def _nothing(_: Any = None) -> None:
    """Nothing to store, or nothing to do about it."""
