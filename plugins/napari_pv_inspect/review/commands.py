"""Edits of a review: verdicts, notes and corrected marks, undoable. No Qt, no napari."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from napari_pv_inspect.models.history import Action, History
from napari_pv_inspect.review import jobs as jobs
from napari_pv_inspect.review.data import VERDICTS, ReviewData
from napari_pv_inspect.review.jobs import Corrected, Edit, Stepped
from napari_pv_inspect.review.persistence import ReviewStorage
from napari_pv_inspect.review.queries import ReviewQueries
from napari_pv_inspect.review.subject import Mask
from pv_inspect.review import Cell, Verdict, VerdictKind, fingerprint

__all__ = ["ReviewCommands"]


class ReviewCommands:
    """Changes what is said about cells.

    Every edit is an action of the history; what is shown never waits for the store.
    """

    def __init__(
        self, data: ReviewData, queries: ReviewQueries, storage: ReviewStorage, history: History
    ) -> None:
        self._data, self._queries, self._storage = data, queries, storage
        self._history = history

    def give(self, cell: Cell, kind: VerdictKind) -> None:
        """Judge a cell; the note that waits for it goes with it."""
        known, note = self._queries.verdict(cell), self._queries.note(cell)
        if known is None or known.kind is not kind:
            self._give(cell, kind, note, f"Verdict {kind.label}")

    def write_note(self, cell: Cell, text: str) -> None:
        """Note something about a cell; without a verdict it waits for that."""
        verdict = self._queries.verdict(cell)
        if self._data.subject is None or text == self._queries.note(cell):
            return
        if verdict is None:
            self._put(cell, None, text, "Note")
        else:
            self._give(cell, verdict.kind, text, "Note")
            self._storage.ask_for_folder()

    def withdraw(self, cell: Cell) -> None:
        """Take a verdict back: the cell is not judged any more; its note waits again."""
        if self._data.subject is not None and self._queries.verdict(cell) is not None:
            self._put(cell, None, self._queries.note(cell), "Withdraw a verdict")

    def correct(self, cell: Cell, mask: Mask | None) -> None:
        """Correct the marks of a cell; None goes back to what the detector found."""
        subject = self._data.subject
        if subject is None or subject.cracks is None:
            self._storage.failed.emit(
                "The cracks are still looked for: correct their marks afterwards."
            )
            return
        rater, own = self._data.rater, self._data.rater_review
        drawn = None if mask is None else Corrected(mask.copy(), self._queries.features(cell))
        mask = None if drawn is None else drawn.mask
        before = own.corrected.get(cell)

        def first(edit: Edit) -> None:
            revision = own.revisions[cell] + 1  # `show` follows

            def measured(found: Corrected | None) -> None:
                if revision == own.revisions[cell]:
                    self._storage.put_marks(rater, cell, found)

            self._storage.submit(
                cell, lambda store: jobs.store_marks(store, subject, edit, mask), measured
            )

        def show(done: bool) -> None:
            shown = drawn if done else before
            own.revisions[cell] += 1
            self._storage.put_marks(rater, cell, shown)
            # Storing measures too, but has to wait for a folder.
            if self._storage.folder is None and shown is not None:
                self._storage.measure(rater, cell, shown.mask)

        text = "Reset marks" if mask is None else "Correct crack marks"
        self._perform(cell, text, first, show)
        self._storage.ask_for_folder()

    def undo_stored(self) -> None:
        """Take back the rater's last edit of an earlier session."""
        subject, rater = self._data.subject, self._data.rater
        if self._storage.folder is not None:
            self._storage.submit(
                None, lambda store: jobs.step_back(store, subject, rater), self._on_step
            )

    def _give(self, cell: Cell, kind: VerdictKind, note: str, text: str) -> None:
        if self._data.subject is not None:
            made_with = fingerprint(self._data.subject.settings)
            self._put(cell, Verdict(*cell, kind, self._data.rater, note, made_with), note, text)
            self._storage.ask_for_folder()

    def _put(self, cell: Cell, verdict: Verdict | None, note: str, text: str) -> None:
        rater, after = self._data.rater, (verdict, note)
        before = self._queries.verdict(cell), self._queries.note(cell)

        def first(edit: Edit) -> None:
            self._storage.submit(cell, lambda store: jobs.store_verdict(store, edit, *after))

        def show(done: bool) -> None:
            self._show_verdict(rater, cell, *(after if done else before))

        self._perform(cell, text, first, show)

    def _perform(
        self, cell: Cell, text: str, first: Callable[[Edit], None], show: Callable[[bool], None]
    ) -> None:
        """Make an edit that can be taken back."""
        edit = Edit(self._data.rater, cell)
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
            show(way == "redo")

        self._history.perform(Action(f"{text}, {_place(cell)}", do, lambda: step("undo")))

    def _step(self, way: str, edit: Edit) -> None:
        subject = self._data.subject

        def on_stored(found: Stepped | None) -> None:
            if found is None or edit.rater != self._data.rater:
                self._storage.reload()
            else:
                self._on_step(found)

        job = partial(jobs.step, way=way, subject=subject, edit=edit)
        self._storage.submit(edit.cell, job, on_stored, edit.rater)

    def _on_step(self, found: Stepped | None) -> None:
        """Take over what the store made of an undo, unless more was said about the cell since."""
        if found is None:
            return
        change = found.change
        if change.superseded:
            self._storage.failed.emit(
                f"{_place(change.cell).capitalize()} was changed in another window meanwhile: "
                "what was said there stays."
            )
        if self._queries.is_pending(change.cell):
            if change.superseded:
                self._storage.reload()
            return
        rater = self._data.rater
        with self._data.one_change():
            self._show_verdict(rater, change.cell, change.verdict, change.note)
            if change.mask_changed or change.superseded:
                self._data.rater_review.revisions[change.cell] += 1
                self._storage.put_marks(rater, change.cell, found.corrected)

    def _show_verdict(self, rater: str, cell: Cell, verdict: Verdict | None, note: str) -> None:
        self._data.module_review.rater_review(rater).put_verdict(cell, verdict, note)
        self._data.tell(VERDICTS)


def _place(cell: Cell) -> str:
    return f"row {cell[0] + 1}, column {cell[1] + 1}"
