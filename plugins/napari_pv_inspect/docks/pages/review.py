"""The verdict on the selected cell: who judges, what, and how far the review is."""

from __future__ import annotations

from functools import partial

from qtpy.QtCore import QSignalBlocker
from qtpy.QtWidgets import (
    QCheckBox,
    QGridLayout,
    QGroupBox,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QProgressBar,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from napari_pv_inspect.models.history import History
from napari_pv_inspect.models.workbench import WorkbenchModel
from napari_pv_inspect.review.controller import Reviewer
from napari_pv_inspect.review.data import ReviewChange
from napari_pv_inspect.widgets.listen import listen
from pv_inspect.review import Cell, VerdictKind

__all__ = ["ReviewBox"]

STYLE = (
    "QPushButton {{ border-left: 8px solid {colour}; text-align: left; padding: 4px; }}"
    "QPushButton:checked {{ border: 2px solid {colour}; border-left: 8px solid {colour};"
    " font-weight: bold; }}"
)


class ReviewBox(QGroupBox):
    """Buttons of the verdicts, note, undo, progress."""

    def __init__(
        self,
        model: WorkbenchModel,
        reviewer: Reviewer,
        history: History,
        parent: QWidget | None = None,
    ) -> None:
        super().__init__("Verdict", parent)
        self._model, self._reviewer, self._history = model, reviewer, history
        self.rater = QLineEdit(reviewer.state.data.rater)
        self.rater.setToolTip("Name of the person who judges; it is stored with every verdict.")
        self.cell = QLabel()
        self.buttons = {kind: _button(kind) for kind in VerdictKind}
        self.note = QLineEdit()
        self.note.setPlaceholderText("Note about this cell")
        self.note.setToolTip("Stored with the verdict; Enter stores it to one that is given.")
        self.advances = QCheckBox("Then the next cell not judged")
        self.advances.setChecked(reviewer.advances)
        self.advances.setToolTip("After a verdict select the next listed cell without one.")
        self.undo = QPushButton("Undo")
        self.redo = QPushButton("Redo")
        self.withdraw = QPushButton("Withdraw")
        self.withdraw.setToolTip("The cell is not judged any more (Del).")
        self.bar = QProgressBar()
        self.bar.setToolTip("Cells that you have judged, of all cells of the module.")
        self.bar.setTextVisible(False)
        self.bar.setFixedHeight(6)
        self.progress = QLabel()
        self.progress.setWordWrap(True)
        self._lay_out()
        for kind, button in self.buttons.items():
            button.clicked.connect(partial(self._on_verdict, kind))
        self.rater.editingFinished.connect(self._on_rater)
        self.note.editingFinished.connect(self._on_note)
        self.advances.toggled.connect(self._on_advances)
        self.undo.clicked.connect(self._on_undo)
        self.redo.clicked.connect(history.redo)
        self.withdraw.clicked.connect(reviewer.withdraw)
        self._noted: Cell | None = None
        listen(model.cell_selected, self._on_cell)
        listen(reviewer.state.data.subject_changed, self._on_cell)
        listen(reviewer.state.data.changed, self._on_review)
        listen(reviewer.state.storage.flush_wanted, self._flush)
        listen(history.changed, self._on_history)
        self._on_cell()
        self._on_history()

    def _lay_out(self) -> None:
        who = QHBoxLayout()
        who.addWidget(QLabel("Rater"))
        who.addWidget(self.rater, 1)
        grid = QGridLayout()
        grid.setSpacing(3)
        for k, button in enumerate(self.buttons.values()):
            grid.addWidget(button, k // 2, k % 2)
        back = QHBoxLayout()
        for widget in (self.undo, self.redo, self.withdraw):
            back.addWidget(widget)
        layout = QVBoxLayout(self)
        layout.addLayout(who)
        layout.addWidget(self.cell)
        layout.addLayout(grid)
        layout.addWidget(self.note)
        layout.addWidget(self.advances)
        layout.addLayout(back)
        layout.addWidget(self.bar)
        layout.addWidget(self.progress)

    def _on_verdict(self, kind: VerdictKind, _: object = None) -> None:
        self._on_note()
        self._reviewer.judge(kind)
        self._on_verdicts()

    def _on_rater(self) -> None:
        self._reviewer.set_rater(self.rater.text())
        self.rater.setText(self._reviewer.state.data.rater)
        self._on_cell()

    def _on_note(self) -> None:
        # What is in the line is about the cell that was selected when it was shown.
        if self._noted is not None:
            self._reviewer.state.commands.write_note(self._noted, self.note.text())
            self.note.setModified(False)

    def _flush(self) -> None:
        if self.note.isModified():
            self._on_note()

    def _on_advances(self, advances: bool) -> None:
        self._reviewer.advances = advances

    def _on_undo(self) -> None:
        self._history.commit()
        if self._history.undo_text is None:
            self._reviewer.state.commands.undo_stored()
        else:
            self._history.undo()

    def _on_cell(self, _: object = None) -> None:
        self._flush()
        state, cell = self._reviewer.state, self._model.selected_cell
        subject = state.data.subject
        known = cell is not None and subject is not None and cell in subject.places
        self._noted = cell if known else None
        self.note.setText("" if self._noted is None else state.cells.note(self._noted))
        self.cell.setText(
            "No cell is selected."
            if self._noted is None
            else f"Row {self._noted[0] + 1}, column {self._noted[1] + 1}"
        )
        for widget in (*self.buttons.values(), self.note, self.withdraw):
            widget.setEnabled(known)
        self._on_verdicts()

    def _on_review(self, change: ReviewChange) -> None:
        if change.verdicts:
            self._on_verdicts()

    def _on_verdicts(self) -> None:
        state = self._reviewer.state
        verdict = None if self._noted is None else state.cells.verdict(self._noted)
        for kind, button in self.buttons.items():
            with QSignalBlocker(button):
                button.setChecked(verdict is not None and verdict.kind is kind)
        if not self.note.isModified() and self._noted is not None:
            self.note.setText(state.cells.note(self._noted))
        done = state.cells.progress
        self.bar.setRange(0, 1 if done is None else done.total)
        self.bar.setValue(0 if done is None else done.judged)
        text = "Nothing to judge yet." if done is None else done.text
        if state.storage.pending:
            text += f"; {state.storage.pending} not stored yet"
            if state.storage.folder is None:
                text += ": save the result"
            elif state.storage.is_failing:
                text += ", tried again every 2 s"
        if text != self.progress.text():
            self.progress.setText(text)
        if done is None:
            self.progress.setToolTip(state.data.why_empty)
        else:
            counts = (f"{kind.label}: {n}" for kind, n in done.counts.items() if n)
            self.progress.setToolTip("\n".join(counts) or "Cells that you have judged.")

    def _on_history(self) -> None:
        undo, redo = self._history.undo_text, self._history.redo_text
        self.undo.setToolTip(
            f"Undo: {undo} (Ctrl+Z)"
            if undo
            else "Take back your last stored edit, also one of an earlier session."
        )
        self.redo.setToolTip(f"Redo: {redo} (Ctrl+Shift+Z)" if redo else "Nothing to do again.")
        self.redo.setEnabled(redo is not None)


def _button(kind: VerdictKind) -> QPushButton:
    button = QPushButton(f"{kind.key.upper()}   {kind.label}")
    button.setCheckable(True)
    button.setStyleSheet(STYLE.format(colour=kind.colour))
    button.setToolTip(f"{kind.label} (key {kind.key.upper()}): {kind.meaning}")
    return button
