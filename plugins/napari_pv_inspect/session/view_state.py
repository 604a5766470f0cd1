"""Remembers what a person looked at in a result folder, and shows it again."""

from __future__ import annotations

from pathlib import Path

from napari.components import ViewerModel
from psygnal import Signal
from qtpy.QtCore import QObject, QTimer

from napari_pv_inspect.layers.frames import FramesLayer
from napari_pv_inspect.models.workbench import WorkbenchModel
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.results.session import Session, read_session, write_session

__all__ = ["SessionStore"]

DELAY_MS = 500


class SessionStore(QObject):
    """Writes `Session` beside the open result soon after each change.

    Attributes
    ----------
    folder : Path or None
        The result folder that belongs to what is open; None: it was not saved yet.
    page : str
        Open page of the controls.
    """

    page_restored = Signal(str)
    page_turned = Signal(str)

    def __init__(self, viewer: ViewerModel, model: WorkbenchModel, frames: FramesLayer) -> None:
        super().__init__()
        self._viewer = viewer
        self._model = model
        self._frames = frames
        self._cell: tuple[int, int] | None = None
        self._frame = 0
        self._aim: Session | None = None
        self.folder: Path | None = None
        self.page = ""
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._timer.setInterval(DELAY_MS)
        self._timer.timeout.connect(self.write)
        model.sequence_changed.connect(self._on_sequence)
        model.cell_selected.connect(self._on_cell)
        frames.frame_shown.connect(self._on_frame)

    def attach(self, folder: Path) -> None:
        """Keep the state of the view beside a result that was just saved."""
        self.folder = folder
        self._later()

    def resume(self, result: Inspection) -> None:
        """Show what was looked at when this result was last open."""
        assert result.stored is not None
        folder = result.stored.folder
        try:
            session = read_session(folder)
        except InspectionError as error:
            session = Session()
            self._model.notice(str(error), is_error=True)
        self.folder = folder
        layout = result.layout
        if session.cell is not None:
            row, col = session.cell
            if 0 <= row < layout.rows and 0 <= col < layout.cols:
                self._model.select_cell(session.cell)
        if self._model.sequence is not None and session.frame < len(self._model.sequence):
            self._frames.show(session.frame)
        if session.page:
            self.page_restored.emit(session.page)
        self._aim = session if session.centre is not None and session.zoom else None

    def aim(self) -> bool:
        """Point the camera as it was when the result was last open, once.

        Returns
        -------
        bool
            False if there is nothing to restore.
        """
        session, self._aim = self._aim, None
        if session is None or session.centre is None or session.zoom is None:
            return False
        camera = self._viewer.scene.camera
        camera.center = (0.0, *session.centre)
        camera.zoom = session.zoom
        return True

    def turn_to(self, page: str) -> None:
        """Note which page of the controls is open."""
        self.page = page
        self._later()
        self.page_turned.emit(page)

    def write(self) -> None:
        """Write now."""
        self._timer.stop()
        if self.folder is None:
            return
        camera = self._viewer.scene.camera
        row, col = (float(v) for v in camera.center[-2:])
        write_session(
            Session(self._cell, self._frame, self.page, (row, col), float(camera.zoom)),
            self.folder,
        )

    def close(self) -> None:
        """Write what is not written yet, and store nothing more."""
        self.write()
        self.folder = None

    def _later(self, _: object = None) -> None:
        if self.folder is not None:
            self._timer.start()

    def _on_frame(self, frame: int) -> None:
        # napari takes the layers away before it closes: then no frame is shown.
        self._frame = frame
        self._later()

    def _on_cell(self, cell: tuple[int, int] | None) -> None:
        # Nothing is selected while another sequence comes: that is not worth to be remembered.
        if cell is not None:
            self._cell = cell
            self._later()

    def _on_sequence(self, _: object) -> None:
        if self._timer.isActive():
            self.write()
        self.folder = self._cell = self._aim = None
