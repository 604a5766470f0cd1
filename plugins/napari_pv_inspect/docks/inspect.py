"""The dock *Inspect module*: open, then a page for each task; run and save below."""

from __future__ import annotations

from pathlib import Path

from napari.components import ViewerModel
from qtpy.QtCore import Qt, QTimer
from qtpy.QtWidgets import (
    QFileDialog,
    QFrame,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QScrollArea,
    QTabWidget,
    QVBoxLayout,
    QWidget,
)

from napari_pv_inspect.docks.cells import CellsDock
from napari_pv_inspect.docks.export_box import ExportBox
from napari_pv_inspect.docks.image_box import ImageBox
from napari_pv_inspect.docks.lens_box import LensBox
from napari_pv_inspect.docks.listen import listen
from napari_pv_inspect.docks.module_box import ModuleBox
from napari_pv_inspect.docks.result_box import ResultBox
from napari_pv_inspect.docks.review_box import ReviewBox
from napari_pv_inspect.docks.run_box import RunBox
from napari_pv_inspect.sample import sample_folder
from napari_pv_inspect.workbench import Workbench
from pv_inspect.errors import InspectionError
from pv_inspect.pipeline import Inspection
from pv_inspect.results import write_result
from pv_inspect.sequence import Sequence
from pv_inspect.settings import Stage

__all__ = ["InspectDock"]

WIDTH = 330


class InspectDock(QWidget):
    """Controls of one inspection, from the frames to the result folder."""

    def __init__(self, napari_viewer: ViewerModel) -> None:
        super().__init__()
        self.bench = bench = Workbench.of(napari_viewer)
        self.open_folder = QPushButton("Open folder...")
        self.open_folder.setToolTip("A folder of 8 or 16 bit TIFF or PNG frames of one module.")
        self.open_sample = QPushButton("Sample")
        self.open_sample.setToolTip("Open the sample module.")
        self.headline = QLabel()
        self.headline.setWordWrap(True)
        self.module = ModuleBox(bench.model)
        self.lens = LensBox(bench.model, bench.live)
        self.image = ImageBox(bench.model)
        self.verdict = ReviewBox(bench.model, bench.review, bench.history)
        self.export = ExportBox(bench.model, bench.review.state)
        self.run = RunBox(bench.model)
        self.result = ResultBox(bench.model, bench.navigator)
        self.setMinimumWidth(WIDTH)
        sources = QHBoxLayout()
        sources.addWidget(self.open_folder, 2)
        sources.addWidget(self.open_sample, 1)
        layout = QVBoxLayout(self)
        layout.addLayout(sources)
        layout.addWidget(self.headline)
        self.pages = QTabWidget()
        self.add_page(
            "Grid", "Which module it is, and where its cells are.", self.module, self.lens
        )
        self.add_page("Image", "How the module image is made.", self.image)
        self.add_page("Review", "What you say about the cells.", self.verdict, self.export)
        layout.addWidget(self.pages, 1)
        layout.addWidget(self.run)
        layout.addWidget(self.result)
        self.open_folder.clicked.connect(self._on_open_folder)
        self.open_sample.clicked.connect(self._on_open_sample)
        self.module.detect_wanted.connect(self._on_detect)
        self.run.run_wanted.connect(self._on_run)
        self.run.cancel_wanted.connect(self._on_cancel)
        self.result.save_wanted.connect(self._on_save)
        listen(bench.review.state.folder_wanted, self._on_folder_wanted)
        listen(bench.model.sequence_changed, self._on_sequence)
        listen(bench.model.inspection_changed, self._on_inspection)
        self._on_sequence(bench.model.sequence)

    def add_page(self, title: str, tip: str, *boxes: QWidget) -> None:
        """Add a page of boxes, one below the other; it scrolls where the screen is small."""
        content = QWidget()
        column = QVBoxLayout(content)
        column.setContentsMargins(2, 4, 2, 2)
        for box in boxes:
            column.addWidget(box)
        column.addStretch(1)
        page = QScrollArea()
        page.setFrameShape(QFrame.Shape.NoFrame)
        page.setWidgetResizable(True)
        page.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        page.setWidget(content)
        self.pages.setTabToolTip(self.pages.addTab(page, title), tip)

    def show_page(self, title: str) -> None:
        """Bring a page to the front."""
        for k in range(self.pages.count()):
            if self.pages.tabText(k) == title:
                self.pages.setCurrentIndex(k)

    def save(self, folder: Path) -> None:
        """Write the result folder; what is wrong becomes a notice."""
        inspection = self.bench.model.inspection
        if inspection is None:
            return
        try:
            write_result(inspection, folder)
        except InspectionError as error:
            self.bench.model.notice(str(error), is_error=True)
        else:
            self.bench.review.saved(folder)
            self.bench.model.notice(f"Saved to {folder}.")

    def _on_sequence(self, sequence: Sequence | None) -> None:
        if sequence is None:
            self.headline.setText("No sequence yet.")
            return
        height, width = sequence.shape
        self.headline.setText(
            f"<b>{sequence.source.name}</b>: {len(sequence)} frames, {width} x {height} px, "
            f"{sequence.bit_depth} bit"
        )
        self.headline.setToolTip(str(sequence.source))

    def _on_inspection(self, inspection: Inspection | None) -> None:
        if self.bench.has_gallery or inspection is None or inspection.tiles is None:
            return
        gallery = CellsDock(self.bench.viewer)
        self.bench.viewer.window.add_dock_widget(gallery, name="Cells", area="bottom")
        self.bench.fit_view()

    def _on_open_folder(self) -> None:
        folder = QFileDialog.getExistingDirectory(self, "Folder of frames")
        if folder:
            self.bench.open(folder)

    def _on_open_sample(self) -> None:
        self.bench.open(sample_folder())

    def _on_detect(self) -> None:
        self.bench.runs.start(until=Stage.CALIBRATE)

    def _on_run(self) -> None:
        self.bench.runs.start()

    def _on_cancel(self) -> None:
        self.bench.runs.cancel()

    def _on_folder_wanted(self, _: str) -> None:
        # Not within the key press that asked for it.
        QTimer.singleShot(0, self, self._on_save)

    def _on_save(self) -> None:
        folder = QFileDialog.getSaveFileName(self, "Folder for the result", "result")[0]
        if folder:
            self.save(Path(folder))
