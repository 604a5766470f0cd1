"""What came out, where to look, and *Save*."""

from __future__ import annotations

from qtpy.QtCore import Signal
from qtpy.QtWidgets import QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from napari_pv_inspect.appearance import DOUBT_COLOUR, WARNING_COLOUR
from napari_pv_inspect.layers.navigation import Navigator
from napari_pv_inspect.models.footer import capitalised, facts_of
from napari_pv_inspect.models.workbench import WorkbenchModel
from napari_pv_inspect.widgets.listen import listen
from napari_pv_inspect.widgets.wrapped_text import SentenceList

__all__ = ["ResultBox"]


class ResultBox(QWidget):
    """Numbers of the shown inspection, views of it, and the way to disk."""

    save_wanted = Signal()

    def __init__(
        self, model: WorkbenchModel, navigator: Navigator, parent: QWidget | None = None
    ) -> None:
        super().__init__(parent)
        self._model = model
        self.doubts = SentenceList(DOUBT_COLOUR)
        self.summary = QLabel()
        self.summary.setWordWrap(True)
        self.warnings = SentenceList(WARNING_COLOUR, most_lines=4)
        self.save = QPushButton("Save result...")
        self.save.setToolTip("Write module image, cells, crack map and report into a folder.")
        row = QHBoxLayout()
        row.setSpacing(3)
        for text, tip, slot in (
            ("Frames", "Fill the canvas with the frames.", navigator.to_frames),
            ("Module", "Fill the canvas with the module image.", navigator.to_module),
            (
                "Both",
                "Frames and module image side by side; deleted layers come back.",
                navigator.to_all,
            ),
        ):
            button = QPushButton(text)
            button.setToolTip(tip)
            button.clicked.connect(slot)
            row.addWidget(button)
        row.addSpacing(9)
        row.addWidget(self.save, 1)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(2)
        layout.addWidget(self.doubts)
        layout.addWidget(self.summary)
        layout.addWidget(self.warnings)
        layout.addLayout(row)
        self.save.clicked.connect(self.save_wanted)
        listen(model.changed, self._on_change)
        self._on_change()

    def _on_change(self) -> None:
        model = self._model
        facts = facts_of(model)
        self.doubts.show_sentences(tuple(f"In doubt: {doubt}" for doubt in facts.doubts))
        self.summary.setText("\n".join(filter(None, (capitalised(facts.cells), facts.numbers))))
        self.summary.setToolTip(facts.details)
        self.warnings.show_sentences(facts.warnings)
        whole = model.inspection is not None and model.inspection.complete
        self.save.setEnabled(whole and not model.why_hidden)
