"""The dock *Inspect module*: what is open, what comes next, a page for each task, the result."""

from __future__ import annotations

from pathlib import Path

from napari.components import ViewerModel
from qtpy.QtCore import Qt, QTimer
from qtpy.QtWidgets import (
    QFileDialog,
    QFrame,
    QGridLayout,
    QGroupBox,
    QLabel,
    QPushButton,
    QScrollArea,
    QSizePolicy,
    QTabWidget,
    QVBoxLayout,
    QWidget,
)

from napari_pv_inspect.docks.gallery import CellsDock
from napari_pv_inspect.docks.pages.cracks import CracksBox
from napari_pv_inspect.docks.pages.export import ExportBox
from napari_pv_inspect.docks.pages.form import FormBox
from napari_pv_inspect.docks.pages.frames import FramesBox
from napari_pv_inspect.docks.pages.image import ImageBox
from napari_pv_inspect.docks.pages.lens import LensBox
from napari_pv_inspect.docks.pages.module import ModuleBox
from napari_pv_inspect.docks.pages.points import PointsBox
from napari_pv_inspect.docks.pages.result import ResultBox
from napari_pv_inspect.docks.pages.review import ReviewBox
from napari_pv_inspect.docks.pages.run import RunBox
from napari_pv_inspect.docks.pages.workflow import StepsBox
from napari_pv_inspect.docks.placing import show_live_cell
from napari_pv_inspect.models.workflow import REVIEW, StepAction
from napari_pv_inspect.sample import sample_folder
from napari_pv_inspect.widgets.docking import dock_of
from napari_pv_inspect.widgets.elided import ElidedLabel
from napari_pv_inspect.widgets.listen import listen
from napari_pv_inspect.widgets.style import ThemedStyle, WheelNeedsFocus, finish_typing
from napari_pv_inspect.workbench import Workbench
from pv_inspect.image_files.endings import PATTERNS
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Group, Stage

__all__ = ["InspectDock"]

WIDTH = 312
PAGE_OF_STEP = {
    "load": "Frames",
    "detect": "Grid",
    "calibrate": "Grid",
    "register": "Frames",
    "reconstruct": "Image",
    "cells": "Image",
    "cracks": "Image",
}


class InspectDock(QWidget):
    """Controls of one inspection, from the frames to the result folder."""

    def __init__(self, napari_viewer: ViewerModel) -> None:
        super().__init__()
        self.workbench = workbench = Workbench.of(napari_viewer)
        self.open_folder = QPushButton("Open")
        self.open_folder.setToolTip("Open a folder: frames of one module, or a result.")
        self.open_files = QPushButton("File")
        self.open_files.setToolTip("Open a file that holds several frames, or some frames.")
        self.open_sample = QPushButton("Sample")
        self.open_sample.setToolTip("Open the sample module.")
        self.name, self.headline = ElidedLabel(), QLabel()
        self.name.setStyleSheet("font-weight: bold")
        self.run = RunBox(workbench.model)
        self.steps = StepsBox(workbench.model, self.run.run)
        self.frames = FramesBox(workbench)
        self.reading = FormBox(workbench.model, Group.FRAMES)
        self.module = ModuleBox(workbench.model)
        self.points = PointsBox(workbench)
        self.lens = LensBox(
            workbench.model,
            workbench.live,
            workbench.kappa_curve,
            lambda: workbench.session.folder,
        )
        self.image = ImageBox(workbench.model, workbench.live_cell)
        self.cracks = CracksBox(workbench.model)
        self.verdict = ReviewBox(workbench.model, workbench.review, workbench.history)
        self.export = ExportBox(workbench.model, workbench.review.state)
        self.result = ResultBox(workbench.model, workbench.navigator)
        self.setMinimumWidth(WIDTH)
        sources = QGridLayout()
        sources.setVerticalSpacing(0)
        sources.setHorizontalSpacing(3)
        sources.addWidget(self.name, 0, 0)
        sources.addWidget(self.headline, 1, 0)
        sources.addWidget(self.open_folder, 0, 1, 2, 1)
        sources.addWidget(self.open_files, 0, 2, 2, 1)
        sources.addWidget(self.open_sample, 0, 3, 2, 1)
        sources.setColumnStretch(0, 1)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(6, 2, 6, 2)
        layout.setSpacing(4)
        layout.addLayout(sources)
        layout.addWidget(self.steps)
        layout.addWidget(self.run)
        self.pages = QTabWidget()
        self.add_page(
            "Frames", "Which frames are used, and how they were read.", self.frames, self.reading
        )
        self.add_page(
            "Grid",
            "Which module it is, and where its cells are.",
            self.module,
            self.points,
            self.lens,
        )
        self.add_page(
            "Image",
            "How the module image is made, and cracks found in it.",
            self.image,
            self.cracks,
        )
        self.add_page("Review", "What you say about the cells.", self.verdict, self.export)
        self.show_page("Grid")
        layout.addWidget(self.pages, 1)
        layout.addWidget(self.result)
        self._style = ThemedStyle(self, workbench.viewer)
        self._wheel_filter = WheelNeedsFocus(self)
        self.open_folder.clicked.connect(self._on_open_folder)
        self.open_files.clicked.connect(self._on_open_files)
        self.open_sample.clicked.connect(self._on_open_sample)
        self.module.detect_wanted.connect(self._on_detect)
        self.image.live_wanted.connect(self._on_live)
        self.run.run_wanted.connect(self._on_run)
        self.run.cancel_wanted.connect(self._on_cancel)
        self.result.save_wanted.connect(self._on_save)
        listen(workbench.review.state.storage.folder_wanted, self._on_folder_wanted)
        self.steps.wanted.connect(self._on_action)
        self.steps.step_clicked.connect(self._on_step)
        self.pages.currentChanged.connect(self._on_page)
        workbench.closing.connect(self.lens.close_maker)
        listen(workbench.session.page_restored, self.show_page)
        listen(workbench.model.result_opened, self._on_result)
        listen(workbench.model.sequence_changed, self._on_sequence)
        listen(workbench.model.inspection_changed, self._on_inspection)
        self._on_sequence(workbench.model.sequence)

    def add_page(self, title: str, tip: str, *boxes: QWidget) -> None:
        """Add a page of boxes, one below the other; it scrolls where the screen is small."""
        content = QWidget()
        column = QVBoxLayout(content)
        column.setContentsMargins(0, 4, 0, 0)
        column.setSpacing(4)
        for box in boxes:
            if isinstance(box, QGroupBox) and (inside := box.layout()) is not None:
                inside.setContentsMargins(6, 2, 6, 4)
                inside.setSpacing(4)
            expands = box.sizePolicy().verticalPolicy() == QSizePolicy.Policy.Expanding
            column.addWidget(box, 100 if expands else 0)
        column.addStretch(1)
        page = QScrollArea()
        page.setFrameShape(QFrame.Shape.NoFrame)
        page.setWidgetResizable(True)
        page.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        page.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        page.setWidget(content)
        self.pages.setTabToolTip(self.pages.addTab(page, title), tip)

    def show_page(self, title: str) -> None:
        """Bring a page to the front."""
        for k in range(self.pages.count()):
            if self.pages.tabText(k) == title:
                self.pages.setCurrentIndex(k)

    def save(self, folder: Path) -> None:
        """Write the result folder in the background; what is wrong becomes a notice."""
        if self.workbench.model.inspection is not None:
            self.workbench.saver.save(self.workbench.model.inspection, folder)

    def _on_sequence(self, sequence: FrameSequence | None) -> None:
        if sequence is None:
            self.show_name("Nothing is open.", "", "")
            return
        height, width = sequence.shape
        # Without the unit there is room for it beside the buttons of the narrowest dock.
        facts = f"{len(sequence)} frames, {width} x {height}"
        depth = sequence.bit_depth
        values = "computed values" if depth is None else f"{depth} bit"
        self.show_name(sequence.source.name, facts, f"{sequence.source}: {facts} px, {values}")

    def _on_result(self, result: Inspection) -> None:
        self.show_name(result.source.name, "a result without its frames", str(result.source))

    def show_name(self, name: str, facts: str, tip: str) -> None:
        """Say what is open."""
        self.name.setText(name)
        self.headline.setText(facts)
        for label in (self.name, self.headline):
            label.setToolTip(tip)

    def _on_action(self, action: StepAction) -> None:
        """Do the next step; a run, and its end, have buttons of their own."""
        if action is StepAction.OPEN:
            self._on_open_folder()
        elif action is StepAction.CONFIRM:
            self.workbench.model.confirm_layout()
        elif action is StepAction.DETECT:
            self._on_detect()
        elif action is StepAction.GIVE_LAYOUT:
            self.show_page("Grid")
            self.module.form["rows"].setFocus()
        elif action is StepAction.REVIEW:
            self._review()

    def _on_step(self, name: str) -> None:
        if name == REVIEW:
            self._review()
        else:
            self.show_page(PAGE_OF_STEP[name])

    def _on_page(self, page: int) -> None:
        self.workbench.session.turn_to(self.pages.tabText(page))

    def _review(self) -> None:
        """Show the gallery, with a cell to begin with."""
        model, review = self.workbench.model, self.workbench.review.state
        if review.data.subject is None:
            model.notice(review.data.why_empty)
            return
        dock = dock_of(self.workbench.viewer.window.dock_widgets.get("Cells"))
        if dock is not None:
            dock.show()
            dock.raise_()
        self.show_page("Review")
        if model.selected_cell is None:
            model.select_cell((0, 0))

    def _on_inspection(self, inspection: Inspection | None) -> None:
        if self.workbench.has_gallery or inspection is None or inspection.tiles is None:
            return
        gallery = CellsDock(self.workbench.viewer)
        self.workbench.viewer.window.add_dock_widget(gallery, name="Cells", area="bottom")
        self.workbench.fit_view()

    def _on_open_folder(self) -> None:
        folder = QFileDialog.getExistingDirectory(self, "Folder of frames")
        if folder:
            self.workbench.open(folder)

    def _on_open_files(self) -> None:
        files, _ = QFileDialog.getOpenFileNames(self, "Frames", "", f"Frames ({PATTERNS})")
        if files:
            self.workbench.open(files[0] if len(files) == 1 else files)

    def _on_open_sample(self) -> None:
        self.workbench.open(sample_folder())

    def _commit(self) -> None:
        """Finish edits that are under way, before a run reads the settings."""
        finish_typing()
        self.workbench.history.commit()

    def _on_detect(self) -> None:
        self._commit()
        self.workbench.runs.start(until=Stage.CALIBRATE)

    def _on_live(self) -> None:
        show_live_cell(self.workbench, self)

    def _on_run(self) -> None:
        self._commit()
        self.workbench.runs.start()

    def _on_cancel(self) -> None:
        self.workbench.runs.cancel()

    def _on_folder_wanted(self, _: str) -> None:
        # Not within the key press that asked for it.
        QTimer.singleShot(0, self, self._on_save)

    def _on_save(self) -> None:
        folder = QFileDialog.getSaveFileName(self, "Folder for the result", "result")[0]
        if folder:
            self.save(Path(folder))
