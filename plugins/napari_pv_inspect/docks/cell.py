"""One cell large, beside its best frame, the bicubic and the support map; also as a dock."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from napari.components import ViewerModel
from qtpy.QtCore import Qt, Signal
from qtpy.QtWidgets import QLabel, QVBoxLayout, QWidget

from napari_pv_inspect.appearance import contrast_limits
from napari_pv_inspect.docks.cell_bar import CellBar
from napari_pv_inspect.docks.gallery_list import cell_text
from napari_pv_inspect.docks.review_keys import bind_review_keys
from napari_pv_inspect.live.single_frame import FramePanels, contours, frame_panels
from napari_pv_inspect.review.data import ReviewChange
from napari_pv_inspect.review.model import ReviewModel
from napari_pv_inspect.review.subject import Mask, Subject
from napari_pv_inspect.tasks.latest import LatestOnly
from napari_pv_inspect.widgets.docking import dock_of
from napari_pv_inspect.widgets.image_panels import Outlines, PaintPanel, Panel, SharedView
from napari_pv_inspect.widgets.listen import listen
from napari_pv_inspect.widgets.panel_grid import PanelGrid
from napari_pv_inspect.widgets.shortcuts import Key
from napari_pv_inspect.widgets.style import ThemedStyle
from napari_pv_inspect.workbench import Workbench
from pv_inspect.errors import InspectionError
from pv_inspect.reports.pictures import grey
from pv_inspect.review import Cell

__all__ = ["CellDock", "focus_gallery"]


GALLERY = "Cells"
NO_FRAMES = "No frames are open: this result folder is looked at without its sequence."


@dataclass
class _Stroke:
    """Marks while they are painted on."""

    cell: Cell
    mask: Mask


class CellDock(QWidget):
    """Four pictures of the selected cell that zoom and move together; its marks are corrected."""

    back_wanted = Signal()
    gallery_wanted = Signal()

    def __init__(self, napari_viewer: ViewerModel) -> None:
        super().__init__()
        self._workbench = Workbench.of(napari_viewer)
        self._style = ThemedStyle(self, self._workbench.viewer)
        self._stroke: _Stroke | None = None
        self._limits = (0.0, 1.0)
        self._found: tuple[object, Outlines] = (None, [])
        self.frame: FramePanels | None = None
        self._best_frame = LatestOnly(self._on_frame, self._on_frame_failure)
        self.shared = SharedView()
        move = (
            "Wheel: zoom; drag: move; double click: the whole cell; click, or its number: large. "
            "All four move together. Orange: marks of the detector; blue: corrected by you, and "
            "dashed what the detector found there."
        )
        self.cell_panel = PaintPanel("Module image", move, self.shared)
        self.frame_panel = Panel("Best frame", move, self.shared, smooth=False)
        self.bicubic_panel = Panel("Bicubic", move, self.shared)
        self.support_panel = Panel(
            "Support",
            f"{move} Dark: the frames determine little here (0); bright: all (1).",
            self.shared,
        )
        self.panels = (
            self.cell_panel,
            self.frame_panel,
            self.bicubic_panel,
            self.support_panel,
        )
        self.bar = CellBar()
        self.grid = PanelGrid(self.panels)
        self.caption = QLabel("No cell is selected.")
        self.caption.setWordWrap(True)
        self.caption.setAlignment(Qt.AlignmentFlag.AlignTop)
        # The pictures keep their size from cell to cell.
        self.caption.setMinimumHeight(2 * self.caption.fontMetrics().lineSpacing() + 2)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(4, 4, 4, 4)
        layout.addWidget(self.bar)
        layout.addWidget(self.grid, 1)
        layout.addWidget(self.caption)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.bar.changed.connect(self._on_bar)
        self.bar.reset_wanted.connect(self._on_reset)
        self.bar.back.clicked.connect(self._back)
        self.bar.gallery.clicked.connect(self.gallery_wanted)
        self.grid.changed.connect(self._on_bar)
        self.cell_panel.stroke_begun.connect(self._on_stroke_begun)
        self.cell_panel.stroked.connect(self._on_stroked)
        self.cell_panel.stroke_ended.connect(self._on_stroke_ended)
        self._bind_keys()
        listen(self._review.data.subject_changed, self._on_subject)
        listen(self._review.data.changed, self._on_review)
        listen(self._review.data.threshold_changed, self._on_threshold)
        listen(self._workbench.model.cell_selected, self._on_cell)
        self.destroyed.connect(partial(_close, self._best_frame))
        self._on_subject(self._review.data.subject)

    @property
    def _review(self) -> ReviewModel:
        return self._workbench.review.state

    @property
    def _cell(self) -> Cell | None:
        cell, subject = self._workbench.model.selected_cell, self._review.data.subject
        return cell if subject is not None and cell in subject.places else None

    @property
    def _why_none(self) -> str:
        return "No cell is selected." if self._review.data.subject else self._review.data.why_empty

    def _bind_keys(self) -> None:
        bind_review_keys(self._workbench, self, "Cell view")
        if (shortcuts := self._workbench.shortcuts) is None:
            return
        review = self._workbench.review
        for sequence, text, slot in (
            ("Left", "Previous cell in the order of the gallery", partial(review.step, -1)),
            ("Right", "Next cell in the order of the gallery", partial(review.step, 1)),
            ("Up", "Cell above", partial(review.move, -1)),
            ("Down", "Cell below", partial(review.move, 1)),
            ("D", "Correct the crack marks with the brush, or stop it", self._toggle_drawing),
            ("E", "Brush or eraser", self.bar.toggle_eraser),
            ("+", "Larger brush", partial(self.bar.grow, 1)),
            ("-", "Smaller brush", partial(self.bar.grow, -1)),
            ("0", "Show the whole cell", self.shared.reset),
            *(
                (str(k + 1), f"{panel.title} large", partial(self.grid.enlarge, k + 1))
                for k, panel in enumerate(self.panels)
            ),
            ("G", "Show or fold the gallery", self.gallery_wanted.emit),
            ("Esc", "Back to the module and the gallery", self._back),
        ):
            shortcuts.add(Key(sequence, text, "Cell view"), slot, within=self)

    def _back(self) -> None:
        self.back_wanted.emit()
        focus_gallery(self._workbench)

    def _toggle_drawing(self) -> None:
        self.bar.toggle_drawing()
        if self.bar.draws:
            self.grid.enlarge(self.cell_panel.number)

    def _on_subject(self, subject: Subject | None) -> None:
        if subject is not None:
            pixels = subject.tiles.pixels
            self._limits = 0.0, float(np.nanmax(pixels)) or 1.0
            low, high = contrast_limits(pixels)
            self.bar.show_contrast(low / self._limits[1], high / self._limits[1])
        self._on_cell(self._cell)

    def _on_cell(self, _: Cell | None) -> None:
        self._stroke = None
        self.frame = None
        self._show_pictures()
        self._show_outlines()
        self._caption()
        self._ask_for_frame()

    def _on_bar(self) -> None:
        # On a small picture a click means: show it large.
        self.cell_panel.editable = self.bar.draws and self.grid.large is self.cell_panel
        self.cell_panel.erasing = self.bar.erases
        self.cell_panel.brush_px = float(self.bar.brush_px)
        self.cell_panel.setCursor(
            Qt.CursorShape.CrossCursor if self.cell_panel.editable else Qt.CursorShape.ArrowCursor
        )
        self._show_pictures()
        self._show_outlines()

    def _on_threshold(self, _: float) -> None:
        self._show_outlines()

    def _on_review(self, change: ReviewChange) -> None:
        if change.marks_of(self._cell):
            self._show_outlines()
        self._caption()

    def _show_pictures(self) -> None:
        subject, cell = self._review.data.subject, self._cell
        if subject is None or cell is None:
            self.frame_panel.title = "Best frame"
            for panel in self.panels:
                panel.show_picture(None, self._why_none)
            return
        height, width = subject.tiles.shape(*cell)
        self.grid.show_aspect(width / height)
        self.cell_panel.show_picture(self._grey(subject.tiles.tile(*cell)))
        support = subject.tiles.support_of(*cell)
        if support is None:
            self.support_panel.show_picture(None, "There is no support map.")
        else:
            self.support_panel.show_picture(_support_colours(support))
        if self.frame is not None:
            self.frame_panel.title = f"Best frame: {self.frame.name}"
            self.frame_panel.show_picture(self._grey(self.frame.nearest))
            self.bicubic_panel.show_picture(self._grey(self.frame.bicubic))
        elif subject.inspection is None:
            self._say_of_frame(NO_FRAMES)

    def _grey(self, image: np.ndarray) -> np.ndarray:
        low, high = (self._limits[1] * share for share in self.bar.contrast)
        return grey(image, low, max(high, low + 1e-6))

    def _say_of_frame(self, sentence: str) -> None:
        self.frame_panel.title = "Best frame"
        self.frame_panel.show_picture(None, sentence)
        self.bicubic_panel.show_picture(None, sentence)

    def _show_outlines(self) -> None:
        cell, opacity = self._cell, self.bar.opacity
        lines: Outlines = []
        replaced: Outlines | None = None
        if cell is not None and opacity > 0:
            drawn = (
                self._review.cells.correction(cell) if self._stroke is None else self._stroke.mask
            )
            found = self._found_lines(cell)
            lines, replaced = (found, None) if drawn is None else (contours(drawn), found)
        for panel in self.panels:
            panel.show_outlines(lines, opacity, replaced)

    def _found_lines(self, cell: Cell) -> Outlines:
        """Outlines of the detector's marks; found once, the brush asks for them all the time."""
        key = self._review.data.subject, cell, self._review.data.threshold
        if key != self._found[0]:
            mask = self._review.cells.found_marks(cell)
            self._found = key, [] if mask is None else contours(mask)
        return self._found[1]

    def _caption(self) -> None:
        cell = self._cell
        if cell is None:
            self.caption.setText(self._why_none)
            return
        text = cell_text(self._review, cell)
        self.caption.setText("  |  ".join(text.splitlines()))
        self.caption.setToolTip(text)

    # The best frame is read and rectified in the background.

    def _ask_for_frame(self) -> None:
        subject, cell = self._review.data.subject, self._cell
        if subject is None or cell is None or subject.inspection is None:
            self._best_frame.cancel()
            return
        self._say_of_frame("Reading the frame...")
        self._best_frame.ask(partial(frame_panels, subject.inspection, cell))

    def _on_frame(self, found: FramePanels) -> None:
        self.frame = found
        self._show_pictures()

    def _on_frame_failure(self, error: InspectionError) -> None:
        self._say_of_frame(str(error))

    # Brush and eraser

    def _on_stroke_begun(self) -> None:
        cell = self._cell
        mask = None if cell is None else self._review.cells.marks(cell)
        self._stroke = None if cell is None or mask is None else _Stroke(cell, mask.copy())

    def _on_stroked(
        self, start: tuple[float, float], end: tuple[float, float], width: float, erases: bool
    ) -> None:
        if self._stroke is None:
            return
        # A pixel of the picture covers [j, j + 1]; OpenCV counts from its centre.
        a, b = ((round(x - 0.5), round(y - 0.5)) for x, y in (start, end))
        painted = self._stroke.mask.astype(np.uint8)
        cv2.line(painted, a, b, 0 if erases else 1, max(round(width), 1))
        self._stroke.mask = painted.astype(bool)
        self._show_outlines()

    def _on_stroke_ended(self) -> None:
        stroke, self._stroke = self._stroke, None
        if stroke is not None:
            self._review.commands.correct(stroke.cell, stroke.mask)

    def _on_reset(self) -> None:
        if (cell := self._cell) is not None and self._review.cells.correction(cell) is not None:
            self._review.commands.correct(cell, None)


def _close(requests: LatestOnly, _: object = None) -> None:
    requests.close()


def _support_colours(support: np.ndarray) -> np.ndarray:
    coloured = cv2.applyColorMap(grey(support, 0.0, 1.0), cv2.COLORMAP_VIRIDIS)
    return cv2.cvtColor(coloured, cv2.COLOR_BGR2RGB)


def focus_gallery(workbench: Workbench) -> None:
    """Bring the gallery to the front with the keyboard, unless it is closed."""
    gallery = workbench.viewer.window.dock_widgets.get(GALLERY)
    dock = dock_of(gallery)
    if gallery is not None and dock is not None and not dock.isHidden():
        dock.raise_()
        getattr(gallery, "view", gallery).setFocus()
