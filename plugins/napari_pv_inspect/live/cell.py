"""The selected cell follows the sliders: rendered in the background, the newest setting first."""

from __future__ import annotations

from collections.abc import Callable
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
from napari_pv_inspect.tasks.guard import attempt
from napari_pv_inspect.tasks.newest_request import Job, NewestWins
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.settings import Settings

__all__ = ["LiveCell", "Source"]


# A slider that rests so long has settled.
SETTLE_MS = 400
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
    _arrived = Signal(object, object, object)

    def __init__(self, model: WorkbenchModel, tuning: Tuning) -> None:
        super().__init__()
        self._model = model
        self.tuning = tuning
        self._worker = NewestWins("live", "beside")
        self._live, self._beside = CellRenderer(), CellRenderer()
        self.active = self._closed = False
        self._asked: Key = ()
        self._asked_beside: Key | None = None
        self._basis: Key = ()
        self._references: dict[Key, CellPicture] = {}
        self._settle = QTimer(self)
        self._settle.setSingleShot(True)
        self._settle.setInterval(SETTLE_MS)
        self._settle.timeout.connect(self._on_rest)
        self._arrived.connect(self._on_arrival, Qt.ConnectionType.QueuedConnection)
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
            self._asked, self._asked_beside = (), None
            self._worker.clear()

    def close(self) -> None:
        """Stop for good."""
        self._closed = True
        self._settle.stop()
        self._worker.close()

    def settle(self) -> None:
        """Take the settings as settled now."""
        self._settle.stop()
        self.tuning.settle()

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
            return self._known_or_asked(
                key, partial(self._rectify, key, inspection, cell, magnification)
            )
        trial = what if isinstance(what, Trial) else self.tuning.before
        if trial is None:
            return None
        if trial.picture.cell == cell:
            return trial.picture
        key = (trial.number, cell)
        return self._known_or_asked(
            key, partial(self._render_beside, key, inspection, cell, trial.settings)
        )

    @property
    def _inspection(self) -> Inspection | None:
        inspection = self._model.inspection
        return None if inspection is None or inspection.registration is None else inspection

    def _known_or_asked(self, key: Key, job: Job) -> CellPicture | None:
        # One at a time: whoever waits asks again when it is ready.
        if key not in self._references and self._asked_beside is None and not self._closed:
            self._asked_beside = key
            self._worker.submit("beside", job)
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
            self._worker.submit("live", partial(self._render, inspection, cell, settings))

    # The following run in the thread of the worker.

    def _render(
        self,
        inspection: Inspection,
        cell: tuple[int, int],
        settings: Settings,
        superseded: Callable[[], bool],
    ) -> bool:
        def work() -> None:
            shown = False
            for picture in self._live.pictures(inspection, cell, settings, superseded):
                if picture is not None:
                    self._tell(inspection, None, picture)
                    shown = True
                # Not before the first picture, or a moving slider would never show one.
                if self._closed or (shown and superseded()):
                    return

        self._attempt(inspection, work)
        return True

    def _render_beside(
        self,
        key: Key,
        inspection: Inspection,
        cell: tuple[int, int],
        settings: Settings,
        superseded: Callable[[], bool],
    ) -> bool:
        done = True

        def work() -> None:
            nonlocal done
            for picture in self._beside.pictures(inspection, cell, settings):
                if picture is not None and picture.finished:
                    self._tell(inspection, key, picture)
                elif superseded():
                    done = False
                    return

        self._attempt(inspection, work)
        return done

    def _rectify(
        self,
        key: Key,
        inspection: Inspection,
        cell: tuple[int, int],
        magnification: float,
        _: Callable[[], bool],
    ) -> bool:
        def work() -> None:
            self._tell(inspection, key, bicubic_cell(inspection, cell, magnification))

        self._attempt(inspection, work)
        return True

    def _attempt(self, inspection: Inspection, work: Callable[[], None]) -> None:
        failure = attempt(work, "This cell can't be shown")
        if failure is not None:
            self._tell(inspection, None, str(failure))

    def _tell(self, inspection: Inspection, key: Key | None, what: CellPicture | str) -> None:
        if not self._closed:
            self._arrived.emit(inspection, key, what)

    # And these in the main thread again.

    def _on_arrival(self, inspection: Inspection, key: Key | None, what: CellPicture | str) -> None:
        # Of another sequence or geometry, by now: what was under way then could not be called back.
        if self._closed or not same_basis(basis_of(inspection), self._basis):
            return
        if isinstance(what, str):
            self._asked_beside = None
            self.failed.emit(what)
        elif key is not None:
            self._references[key] = what
            self._asked_beside = None
            for old in list(self._references)[:-KEPT]:
                del self._references[old]
            self.reference_ready.emit()
        elif what.cell == self.cell:
            self.pictured.emit(what)
            self.tuning.pictured(what)

    def _on_settings(self, _: Settings) -> None:
        self._settle.start()
        self._ask()

    def _on_cell(self, _: object) -> None:
        self._ask()

    def _on_inspection(self, _: Inspection | None) -> None:
        basis = basis_of(self._model.inspection)
        if not same_basis(basis, self._basis):
            self._basis = basis
            self._asked, self._asked_beside = (), None
            self._references.clear()
            self._worker.clear()
            self._ask()

    def _on_rest(self) -> None:
        if QApplication.mouseButtons() != Qt.MouseButton.NoButton:
            # The slider is still being dragged.
            self._settle.start()
        else:
            self.settle()
