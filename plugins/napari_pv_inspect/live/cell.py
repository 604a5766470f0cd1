"""The selected cell follows the sliders: rendered in the background, the newest setting first."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from enum import Enum
from functools import partial

from qtpy.QtCore import QObject, Qt, QTimer, Signal
from qtpy.QtWidgets import QApplication

from napari_pv_inspect.live.cell_renderer import (
    CellRenderer,
    basis_of,
    bicubic_cell,
    default_cell,
    run_cell,
    same_basis,
)
from napari_pv_inspect.models.cell_picture import CellPicture
from napari_pv_inspect.models.trials import LIVE_FIELDS, Trial, Tuning
from napari_pv_inspect.models.workbench import WorkbenchModel
from napari_pv_inspect.tasks.latest import BackgroundThread, LatestOnly, Work
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.settings import Settings

__all__ = ["LiveCell", "Source"]


# A slider that was not moved for so long is at rest.
REST_MS = 400
CLOSE_S = 2.0
KEPT = 64


class Source(Enum):
    """Pictures of a cell that are no trials."""

    LIVE = "live"
    BICUBIC = "bicubic, best frame"
    PREVIOUS = "previous setting"
    RUN = "last whole run"
    NOTHING = "nothing"


Key = tuple[object, ...]


class LiveCell(QObject):
    """Renders pictures of the selected cell while its dock is visible.

    Parameters
    ----------
    model : WorkbenchModel
    tuning : Tuning
    """

    pictured = Signal(object)
    """CellPicture of the selected cell with the settings of the controls."""
    reference_ready = Signal()
    failed = Signal(str)

    def __init__(self, model: WorkbenchModel, tuning: Tuning) -> None:
        super().__init__()
        self._model = model
        self.tuning = tuning
        # The live picture goes before what it is compared with.
        thread, failure = BackgroundThread("live cell"), "This cell can't be shown"
        self._live = LatestOnly(
            self._on_picture, self._on_failure, failure=failure, thread=thread, older_count=True
        )
        self._reference = LatestOnly(
            self._on_reference, self._on_reference_failure, failure=failure, thread=thread
        )
        self._renderer, self._reference_renderer = CellRenderer(), CellRenderer()
        self.active = self._closed = False
        self._asked: Key = ()
        self._asked_reference: Key | None = None
        self._basis: Key = ()
        self._references: dict[Key, CellPicture] = {}
        self._rest = QTimer(self)
        self._rest.setSingleShot(True)
        self._rest.setInterval(REST_MS)
        self._rest.timeout.connect(self._on_rest)
        model.settings_changed.connect(self._on_settings)
        model.inspection_changed.connect(self._on_inspection)
        model.cell_selected.connect(self._on_cell)

    @property
    def cell(self) -> tuple[int, int] | None:
        """The selected cell, a suspicious one if none is selected; None without a geometry."""
        inspection = self._inspection
        if inspection is None:
            return None
        layout, chosen = inspection.layout, self._model.selected_cell
        if chosen is not None and chosen[0] < layout.rows and chosen[1] < layout.cols:
            return chosen
        return default_cell(inspection)

    def set_active(self, active: bool) -> None:
        """Say whether the dock is visible; else nothing is computed."""
        self.active = active
        if active:
            self._ask()
        else:
            self._forget_requests()

    def close(self) -> None:
        """Stop for good."""
        self._closed = True
        self._rest.stop()
        self._reference.close()
        self._live.close(CLOSE_S)

    def commit(self) -> None:
        """Take the settings as final now, as if the controls had rested."""
        self._rest.stop()
        self.tuning.commit()

    def reference(self, what: Source | Trial) -> CellPicture | None:
        """Return what to compare with if it is known; else ask for it (`reference_ready`)."""
        inspection, cell = self._inspection, self.cell
        if inspection is None or cell is None or what in (Source.NOTHING, Source.LIVE):
            return None
        if what is Source.RUN:
            return run_cell(inspection, cell)
        if what is Source.BICUBIC:
            magnification = inspection.settings.magnification
            key: Key = ("bicubic", cell)
            return self._known_or_asked(key, partial(bicubic_cell, inspection, cell, magnification))
        trial = what if isinstance(what, Trial) else self.tuning.before
        if trial is None:
            return None
        if trial.picture.cell == cell:
            return trial.picture
        key = (trial.number, cell)
        pictures = partial(self._reference_renderer.pictures, inspection, cell, trial.settings)
        return self._known_or_asked(key, partial(_finished, pictures))

    @property
    def _inspection(self) -> Inspection | None:
        inspection = self._model.inspection
        return None if inspection is None or inspection.registration is None else inspection

    def _known_or_asked(self, key: Key, work: Work) -> CellPicture | None:
        # One at a time: whoever waits asks again when it is ready.
        if key not in self._references and self._asked_reference is None and not self._closed:
            self._asked_reference = key
            self._reference.ask(work)
        return self._references.get(key)

    def _ask(self) -> None:
        inspection, cell = self._inspection, self.cell
        if not self.active or self._closed or inspection is None or cell is None:
            return
        settings = self._model.settings
        fields = tuple(getattr(settings, name) for name in LIVE_FIELDS)
        key = (cell, fields)
        if self._asked != key:
            self._asked = key
            hurry = self._live.superseded
            self._live.ask(partial(self._renderer.pictures, inspection, cell, settings, hurry))

    def _forget_requests(self) -> None:
        self._asked, self._asked_reference = (), None
        self._live.cancel()
        self._reference.cancel()

    def _on_picture(self, picture: CellPicture) -> None:
        if picture.cell == self.cell:
            self.pictured.emit(picture)
            self.tuning.pictured(picture)

    def _on_failure(self, error: InspectionError) -> None:
        self.failed.emit(str(error))

    def _on_reference(self, picture: CellPicture) -> None:
        key, self._asked_reference = self._asked_reference, None
        if key is not None:
            self._references[key] = picture
            for old in list(self._references)[:-KEPT]:
                del self._references[old]
        self.reference_ready.emit()

    def _on_reference_failure(self, error: InspectionError) -> None:
        self._asked_reference = None
        self.failed.emit(str(error))

    def _on_settings(self, _: Settings) -> None:
        self._rest.start()
        self._ask()

    def _on_cell(self, _: object) -> None:
        self._ask()

    def _on_inspection(self, _: Inspection | None) -> None:
        basis = basis_of(self._model.inspection)
        if not same_basis(basis, self._basis):
            self._basis = basis
            self._references.clear()
            self._forget_requests()
            self._ask()

    def _on_rest(self) -> None:
        if QApplication.mouseButtons() != Qt.MouseButton.NoButton:
            # The slider is still being dragged.
            self._rest.start()
        else:
            self.commit()


def _finished(pictures: Callable[[], Iterator[CellPicture | None]]) -> Iterator[CellPicture | None]:
    """Leave out the pictures that are not finished; None where the work can be given up."""
    for picture in pictures():
        yield picture if picture is not None and picture.finished else None
