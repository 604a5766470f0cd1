"""The dock *Live cell*: the selected cell follows the sliders, beside what it is compared with."""

from __future__ import annotations

from functools import partial

from napari.components import ViewerModel
from qtpy.QtCore import Qt
from qtpy.QtGui import QHideEvent, QShowEvent
from qtpy.QtWidgets import (
    QCheckBox,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QSizePolicy,
    QSplitter,
    QVBoxLayout,
    QWidget,
)

from napari_pv_inspect.appearance import contrast_limits
from napari_pv_inspect.docks.side_box import SideBox
from napari_pv_inspect.docks.trial_list import TrialList
from napari_pv_inspect.live.cell import Source
from napari_pv_inspect.models.cell_picture import CellPicture
from napari_pv_inspect.widgets.listen import listen
from napari_pv_inspect.widgets.shortcuts import Key
from napari_pv_inspect.widgets.style import ThemedStyle
from napari_pv_inspect.widgets.swipe_view import SwipeView, grey_image
from napari_pv_inspect.workbench import Workbench
from pv_inspect.inspection.inspection import Inspection

__all__ = ["LiveDock"]

NEED_A_RUN = "Run once first: the live cell needs to know where the frames lie on the module."


class LiveDock(QWidget):
    """Live view, comparison and the trials."""

    def __init__(self, napari_viewer: ViewerModel) -> None:
        super().__init__()
        self.workbench = workbench = Workbench.of(napari_viewer)
        self._style = ThemedStyle(self, workbench.viewer)
        self._live = workbench.live_cell
        self.picture: CellPicture | None = None
        self._limits: tuple[float, float] | None = None
        self.view = SwipeView()
        self.shown = SideBox(Source.LIVE)
        self.shown.setToolTip(
            "What is shown right of the divider: the cell with the settings of the controls, or a "
            "trial. A control that is moved brings the live cell back."
        )
        self.against = SideBox(Source.BICUBIC, Source.PREVIOUS, Source.RUN, Source.NOTHING)
        self.against.setToolTip("What is shown left of the divider: any of these, or a trial.")
        self.flicker = QCheckBox("Flicker")
        self.flicker.setToolTip(
            "Alternate both pictures twice a second: differences stand out (F)."
        )
        self.contrast = QPushButton("Contrast")
        self.contrast.setToolTip("Fit black and white to this cell; both pictures share them.")
        self.caption = QLabel()
        self.caption.setWordWrap(True)
        self.caption.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        self.trials = TrialList(workbench.tuning)
        sides, below = QFormLayout(), QHBoxLayout()
        sides.setVerticalSpacing(2)
        sides.addRow("Show", self.shown)
        sides.addRow("Against", self.against)
        below.addWidget(self.flicker, 1)
        below.addWidget(self.contrast)
        top = QWidget()
        column = QVBoxLayout(top)
        column.setContentsMargins(0, 0, 0, 0)
        column.addLayout(sides)
        column.addWidget(self.view, 1)
        column.addLayout(below)
        column.addWidget(self.caption)
        parts = QSplitter(Qt.Orientation.Vertical)
        parts.addWidget(top)
        parts.addWidget(self.trials)
        parts.setStretchFactor(0, 3)
        parts.setStretchFactor(1, 2)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(4, 4, 4, 4)
        layout.addWidget(parts)
        self.setMinimumWidth(300)
        self.shown.activated.connect(self._on_change)
        self.against.activated.connect(self._on_change)
        self.flicker.toggled.connect(self.view.set_flicker)
        self.contrast.clicked.connect(self._on_contrast)
        self.trials.chosen.connect(self._on_chosen)
        self._live.pictured.connect(self._on_picture)
        self._live.reference_ready.connect(self._on_change)
        self._live.failed.connect(self._on_failure)
        listen(workbench.model.inspection_changed, self._on_inspection)
        listen(workbench.model.result_opened, self._on_inspection)
        listen(workbench.model.cell_selected, self._on_cell)
        listen(workbench.model.settings_changed, self._on_settings)
        listen(workbench.tuning.changed, self._on_trials)
        if workbench.shortcuts is not None:
            for sequence, text, slot in (
                ("F", "Flicker: both pictures alternate", self.flicker.toggle),
                ("Left", "Move the divider to the left", partial(self.view.step, -1)),
                ("Right", "Move the divider to the right", partial(self.view.step, 1)),
                ("Home", "Show only what stands right", partial(self.view.move_divider, 0.0)),
                ("End", "Show only what stands left", partial(self.view.move_divider, 1.0)),
            ):
                within = self if sequence == "F" else self.view
                workbench.shortcuts.add(Key(sequence, text, "Live cell"), slot, within=within)
        self._on_trials()
        self._on_inspection(workbench.model.inspection)

    def showEvent(self, event: QShowEvent) -> None:  # noqa: N802 (Qt's name)
        """Compute while it is seen."""
        super().showEvent(event)
        self._live.set_active(True)

    def hideEvent(self, event: QHideEvent) -> None:  # noqa: N802 (Qt's name)
        """Compute nothing while it is not seen."""
        super().hideEvent(event)
        self._live.set_active(False)

    def compare(self, against: Source | int, shown: Source | int = Source.LIVE) -> None:
        """Choose both sides: sources, or numbers of trials."""
        self.against.choose(against)
        self.shown.choose(shown)
        self._on_change()

    def _on_picture(self, picture: CellPicture) -> None:
        if self.picture is None or self.picture.cell != picture.cell:
            self._limits = None
        self.picture = picture
        if self._limits is None:
            self._limits = contrast_limits(picture.image)
        self.view.show_message("")
        row, col = picture.cell
        self.caption.setText(f"Row {row + 1}, column {col + 1}: {picture.caption}.{self._note()}")
        self._on_change()

    def _on_change(self, _: object = None) -> None:
        """Show what there is now, on both sides."""
        if self.picture is None or self._limits is None:
            return
        before, before_text = self._side(self.against.choice)
        after, after_text = self._side(self.shown.choice)
        if after is None:
            after, after_text = self.picture, Source.LIVE.value
        image = None if before is None else grey_image(before.image, self._limits)
        self.view.show_before(image, before_text)
        self.view.show_after(grey_image(after.image, self._limits), after_text)

    def _side(self, choice: Source | int) -> tuple[CellPicture | None, str]:
        """Picture and text of one side; None if there is none, or none yet."""
        if isinstance(choice, int):
            trials = self.workbench.tuning.trials
            trial = next((one for one in trials if one.number == choice), None)
            if trial is None:
                return None, ""
            return self._live.reference(trial), trial.title
        picture = self._live.reference(choice)
        if choice is Source.BICUBIC and picture is not None:
            return picture, f"bicubic, {picture.caption}"
        return picture, choice.value

    def _on_chosen(self) -> None:
        chosen = [trial.number for trial in self.trials.selected]
        if chosen:
            self.compare(*chosen)

    def _on_trials(self) -> None:
        for box in (self.against, self.shown):
            box.refill(self.workbench.tuning.trials, self.trials.trials.icon)
        self._on_change()

    def _on_settings(self, _: object) -> None:
        if self.shown.choice is not Source.LIVE:
            self.compare(self.against.choice)

    def _on_contrast(self) -> None:
        if self.picture is not None:
            self._limits = contrast_limits(self.picture.image)
            self._on_change()

    def _on_cell(self, _: object) -> None:
        self.view.show_message("")

    def _on_failure(self, text: str) -> None:
        self.caption.setText(text)

    def _on_inspection(self, _: Inspection | None) -> None:
        if self._live.cell is None:
            self.picture = None
            self.view.show_before(None, "")
            self.view.show_after(None, "")
            self.view.show_message(self.workbench.model.frames_gone or NEED_A_RUN)
            self.caption.clear()

    def _note(self) -> str:
        """What the live cell leaves out, in a sentence."""
        model = self.workbench.model
        inspection, settings = model.inspection, model.settings
        if inspection is None:
            return ""
        notes = []
        if inspection.reconstruction is None:
            notes.append("Before the first whole run PSF and lambda are typical values.")
        kappa, registration = settings.kappa, inspection.registration
        if (
            kappa is not None
            and registration is not None
            and abs(kappa - registration.camera.kappa) > 1e-9
        ):
            notes.append("Poses refitted to the grid for this kappa, not registered again.")
        stopped = inspection.settings.motion_blur == "none" and settings.motion_blur == "auto"
        if stopped:
            notes.append("Motion blur is estimated by the next run only.")
        return "".join(f" {note}" for note in notes)
