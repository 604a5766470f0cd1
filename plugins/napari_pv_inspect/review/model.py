"""The review: verdicts, notes and corrected marks of the cells, undoable. No Qt, no napari.

All signals are emitted in the main thread, those about stored things by `collect`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from napari_pv_inspect.models.history import Action
from napari_pv_inspect.review import jobs as jobs
from napari_pv_inspect.review.jobs import Corrected, Edit, Stepped
from napari_pv_inspect.review.persistence import StoredReview
from napari_pv_inspect.review.queries import EVERY
from napari_pv_inspect.review.subject import Mask
from pv_inspect.review import Cell, Verdict, VerdictKind, fingerprint

__all__ = ["EVERY", "ReviewModel"]


class ReviewModel(StoredReview):
    """The reviewed module with its verdicts, notes and corrected marks.

    Every edit is an action of the history; what is shown never waits for the store.
    """

    def give(self, cell: Cell, kind: VerdictKind) -> None:
        """Judge a cell; the note that waits for it goes with it."""
        known, note = self.verdict(cell), self.note(cell)
        if known is None or known.kind is not kind:
            self._give(cell, kind, note, f"Verdict {kind.label}")

    def write_note(self, cell: Cell, text: str) -> None:
        """Note something about a cell; without a verdict it waits for that."""
        verdict = self.verdict(cell)
        if self.subject is None or text == self.note(cell):
            return
        if verdict is None:
            self._say(cell, None, text, "Note")
        else:
            self._give(cell, verdict.kind, text, "Note")
            self._need_folder()

    def withdraw(self, cell: Cell) -> None:
        """Take a verdict back: the cell is not judged any more; its note waits again."""
        if self.subject is not None and self.verdict(cell) is not None:
            self._say(cell, None, self.note(cell), "Withdraw a verdict")

    def correct(self, cell: Cell, mask: Mask | None) -> None:
        """Correct the marks of a cell; None goes back to what the detector found."""
        subject = self.subject
        if subject is None or subject.cracks is None:
            self.failed.emit("The cracks are still looked for: correct their marks afterwards.")
            return
        rater, own = self.rater, self._rater_review
        drawn = None if mask is None else Corrected(mask.copy(), self.features(cell))
        mask = None if drawn is None else drawn.mask
        before = own.corrected.get(cell)

        def first(edit: Edit) -> None:
            stroke = own.strokes[cell] + 1  # `show` follows

            def measured(found: Corrected | None) -> None:
                if stroke == own.strokes[cell]:
                    self._put_marks(rater, cell, found)

            self._submit(cell, lambda store: jobs.store_marks(store, subject, edit, mask), measured)

        def show(done: bool) -> None:
            shown = drawn if done else before
            own.strokes[cell] += 1
            self._put_marks(rater, cell, shown)
            if self.folder is None and shown is not None:
                self._measure(rater, cell, shown.mask)  # storing measures too, but has to wait

        text = "Reset marks" if mask is None else "Correct crack marks"
        self._perform(cell, text, first, show)
        self._need_folder()

    def undo_stored(self) -> None:
        """Take back the rater's last edit of an earlier session."""
        subject, rater = self.subject, self.rater
        if self.folder is not None:
            self._submit(None, lambda store: jobs.step_back(store, subject, rater), self._on_step)

    def _give(self, cell: Cell, kind: VerdictKind, note: str, text: str) -> None:
        if self.subject is not None:
            made_with = fingerprint(self.subject.settings)
            self._say(cell, Verdict(*cell, kind, self.rater, note, made_with), note, text)
            self._need_folder()

    def _say(self, cell: Cell, verdict: Verdict | None, note: str, text: str) -> None:
        rater, after = self.rater, (verdict, note)
        before = self.verdict(cell), self.note(cell)

        def first(edit: Edit) -> None:
            self._submit(cell, lambda store: jobs.store_verdict(store, edit, *after))

        def show(done: bool) -> None:
            self._put_saying(rater, cell, *(after if done else before))

        self._perform(cell, text, first, show)

    def _perform(
        self, cell: Cell, text: str, first: Callable[[Edit], None], show: Callable[[bool], None]
    ) -> None:
        """Make an edit that can be taken back."""
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
            show(way == "redo")

        self._history.perform(Action(f"{text}, {_place(cell)}", do, lambda: step("undo")))

    def _step(self, way: str, edit: Edit) -> None:
        subject = self.subject

        def took(found: Stepped | None) -> None:
            if found is None or edit.rater != self.rater:
                self._reload()
            else:
                self._on_step(found)

        job = partial(jobs.step, way=way, subject=subject, edit=edit)
        self._submit(edit.cell, job, took, edit.rater)

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
        if self.is_pending(change.cell):
            if change.superseded:
                self._reload()
            return
        self._put_saying(self.rater, change.cell, change.verdict, change.note)
        if change.mask_changed or change.superseded:
            self._rater_review.strokes[change.cell] += 1
            self._put_marks(self.rater, change.cell, found.corrected)

    def _put_saying(self, rater: str, cell: Cell, verdict: Verdict | None, note: str) -> None:
        self._module_review.rater_review(rater).put_verdict(cell, verdict, note)
        self.verdicts_changed.emit()


def _place(cell: Cell) -> str:
    return f"row {cell[0] + 1}, column {cell[1] + 1}"
