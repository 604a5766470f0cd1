"""Connects the review to the workbench: what is reviewed, when it is stored, the end."""

from __future__ import annotations

import getpass
from pathlib import Path

from qtpy.QtCore import QObject, QTimer
from qtpy.QtWidgets import QMessageBox, QWidget

from napari_pv_inspect.models.history import History
from napari_pv_inspect.models.workbench import RunState, WorkbenchModel
from napari_pv_inspect.review.model import ReviewModel
from napari_pv_inspect.review.subject import Subject
from napari_pv_inspect.user_state import UserState, read_user_state, write_user_state
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.review import Cell, VerdictKind
from pv_inspect.settings import Settings

__all__ = ["Reviewer"]

OTHER_LAYOUT = (
    "The earlier cells had other rows or columns (saved verdicts stay in that result): press Run "
    "for the cells of the new grid."
)
OTHER_GRID = "The grid was changed since the cells were cut: press Run for new ones."
COLLECT_MS = 40
REMEMBER_MS = 1500
PATIENCE_S = 5.0
# For one more attempt, where storing is known to fail.
LITTLE_PATIENCE_S = 0.3


class Reviewer(QObject):
    """Controls the review of the cells that the workbench shows.

    Attributes
    ----------
    state : ReviewModel
    advances : bool
        Whether a verdict is followed by the next cell without one.
    """

    def __init__(self, model: WorkbenchModel, history: History) -> None:
        super().__init__()
        self._model = model
        self.state = ReviewModel(history, read_user_state().rater or _user())
        self.advances = True
        self._close_anyway = False
        self._collecting = QTimer(self)
        self._collecting.setInterval(COLLECT_MS)
        self._collecting.timeout.connect(self.state.storage.collect)
        self._remembering = QTimer(self)
        self._remembering.setSingleShot(True)
        self._remembering.setInterval(REMEMBER_MS)
        self._remembering.timeout.connect(self._remember)
        self._signals = (
            (model.inspection_changed, self._on_inspection),
            (model.result_opened, self._on_inspection),
            (model.run_changed, self._on_run),
            (model.settings_changed, self._on_settings),
            (model.cell_selected, self._on_cell),
        )
        for signal, slot in self._signals:
            signal.connect(slot)
        self.state.storage.failed.connect(self._on_failure)
        self.state.storage.folder_wanted.connect(self._on_folder_wanted)
        self.state.storage.remembered.connect(self._on_remembered)

    def judge(self, kind: VerdictKind) -> None:
        """Give the selected cell a verdict, and go to the next one."""
        cell = self._model.selected_cell
        if self.state.data.subject is None:
            self._model.notice(self.state.data.why_empty)
            return
        if cell is None:
            self._model.notice("No cell is selected: click one in the gallery first.")
            return
        self.state.commands.give(cell, kind)
        if self.advances:
            self.to_next()

    def withdraw(self) -> None:
        """Take the verdict on the selected cell back."""
        if self._model.selected_cell is not None:
            self.state.commands.withdraw(self._model.selected_cell)

    def to_next(self) -> None:
        """Go to the next cell without a verdict; stay if there is none."""
        following = self.state.listing.next_unjudged(self._model.selected_cell)
        if following is not None:
            self._model.select_cell(following)

    def step(self, by: int) -> None:
        """Go ``by`` cells on in the order of the gallery."""
        listed = self.state.listing.cells
        if not listed:
            return
        cell = self._model.selected_cell
        at = listed.index(cell) + by if cell in listed else 0
        self._model.select_cell(listed[min(max(at, 0), len(listed) - 1)])

    def move(self, rows: int) -> None:
        """Go to a cell further down in the same column of the module."""
        cell, subject = self._model.selected_cell, self.state.data.subject
        if cell is not None and subject is not None:
            other = cell[0] + rows, cell[1]
            if other in subject.places:
                self._model.select_cell(other)

    def set_rater(self, rater: str) -> None:
        """Judge as somebody else, also in the next session."""
        self.state.set_rater(rater)
        try:
            write_user_state(UserState(rater=self.state.data.rater))
        except InspectionError as error:
            self._model.notice(str(error), is_error=True)

    def saved(self, folder: Path) -> None:
        """Store verdicts in the folder that the inspection was saved to."""
        self.state.storage.attach(Path(folder).resolve())

    def may_leave(self, window: QWidget | None) -> bool:
        """Whether another module may come; the user decides if something can't be stored yet."""
        self.state.storage.flush_wanted.emit()
        if self.state.storage.folder is not None or not self.state.storage.pending:
            return True
        self._try_again(window)
        self.state.storage.given_up = self.state.storage.pending if self._close_anyway else 0
        return self._close_anyway

    def may_close(self, window: QWidget | None) -> bool:
        """Wait until everything is stored; if that can't be, the user decides."""
        self._remembering.stop()
        self.state.storage.flush_wanted.emit()
        patience_s = LITTLE_PATIENCE_S if self.state.storage.is_failing else PATIENCE_S
        while self.state.storage.pending and not self.state.storage.wait(patience_s):
            if not self._try_again(window):
                break
            patience_s = PATIENCE_S
        return not self.state.storage.pending or self._close_anyway

    def close(self) -> None:
        """Disconnect from the model."""
        self._collecting.stop()
        self._remembering.stop()
        for signal, slot in self._signals:
            signal.disconnect(slot, missing_ok=True)
        self.state.storage.close()

    def _try_again(self, window: QWidget | None) -> bool:
        buttons = QMessageBox.StandardButton
        unsaved = self.state.storage.folder is None
        where = "the result was not saved yet" if unsaved else "storing fails"
        retry = buttons.NoButton if unsaved else buttons.Retry
        answer = QMessageBox.question(
            window,
            "Review",
            f"{self.state.storage.pending} entries of the review are not stored, because {where}. "
            "Discard them?",
            buttons.Discard | retry | buttons.Cancel,
            buttons.Cancel,
        )
        self._close_anyway = answer == buttons.Discard
        return answer == buttons.Retry

    def _on_inspection(self, _: Inspection | None) -> None:
        shown = self._model.shown or self._model.result
        if self._model.why_hidden:
            if self.state.data.reviewed is not None:
                self.state.empty(self._model.why_hidden)
            return
        subject = None if shown is None else Subject.of_inspection(shown)
        if shown is not None and subject is None:
            self._empty(shown)
            return
        stored = None if shown is None else shown.stored
        self._show(subject, None if stored is None else stored.folder.resolve())

    def _empty(self, shown: Inspection) -> None:
        """Show no cells of an earlier grid."""
        before = self.state.data.reviewed
        if before is None:
            return
        if before.tiles.grid.layout != shown.layout:
            self.state.empty(OTHER_LAYOUT)
        elif self._model.run_state is RunState.IDLE:
            self.state.empty(OTHER_GRID)
        # else the old cells stay while a run works on new ones

    def _show(self, subject: Subject | None, folder: Path | None) -> None:
        state = self.state
        if subject is None and state.data.reviewed is None:
            return
        if subject is not None and subject.shows_the_same(state.data.subject):
            return
        state.show(subject, folder)
        if subject is not None and self._model.selected_cell not in (None, *subject.places):
            self._model.select_cell(None)
        if subject is None:
            self._collecting.stop()
        else:
            self._collecting.start()

    def _on_run(self, _: RunState) -> None:
        self._on_inspection(self._model.shown)

    def _on_settings(self, _: Settings) -> None:
        # Hidden cells come back with their rows and columns.
        if self._model.why_hidden or self.state.data.subject is None:
            self._on_inspection(self._model.shown)

    def _on_cell(self, cell: Cell | None) -> None:
        if cell is not None and self.state.storage.folder is not None:
            self._remembering.start()

    def _remember(self) -> None:
        if self._model.selected_cell is not None:
            self.state.storage.remember(self._model.selected_cell)

    def _on_remembered(self, cell: Cell) -> None:
        subject = self.state.data.subject
        if self._model.selected_cell is None and subject is not None and cell in subject.places:
            self._model.select_cell(cell)

    def _on_folder_wanted(self, sentence: str) -> None:
        self._model.notice(sentence)

    def _on_failure(self, sentence: str) -> None:
        self._model.notice(sentence, is_error=True)


def _user() -> str:
    """Name of the account, as a first guess of who judges."""
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return "rater"
