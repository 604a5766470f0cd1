"""Refits the grid of the shown frame while its points are dragged or kappa is changed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from napari.components import ViewerModel
from numpy.typing import NDArray
from psygnal import Signal
from qtpy.QtCore import QTimer
from superqt.utils import qthrottled

from napari_pv_inspect.layers.frames import FramesLayer
from napari_pv_inspect.layers.geometry import GeometryLayers
from napari_pv_inspect.layers.overlays import frame_grid
from napari_pv_inspect.models.point_editor import PointEditor
from napari_pv_inspect.models.point_edits import Point
from napari_pv_inspect.models.workbench import RunState, WorkbenchModel
from pv_inspect.calibration.calibrate import Calibration, calibrate
from pv_inspect.calibration.refit import refit_frame
from pv_inspect.detection.crossings import Crossings
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.settings import Settings

__all__ = ["FrameGrid", "LiveKappa", "fit_frame_grid"]

# A fit of one frame and its repaint cost up to 50 ms without a graphics card.
THROTTLE_MS = 50


@dataclass(frozen=True)
class FrameGrid:
    """Grid of one frame at a chosen kappa.

    Attributes
    ----------
    segments : (n, 2, 3) float64
        As `overlays.frame_grid` makes them.
    rms_px : float
        Distance of the measured crossing points from that grid.
    """

    segments: NDArray[np.float64]
    rms_px: float


def fit_frame_grid(
    crossings: Crossings,
    calibration: Calibration,
    frame: int,
    image_shape: tuple[int, int],
    settings: Settings,
) -> FrameGrid:
    """Fit the pose of one frame with the lens of ``settings`` to its measured crossing points.

    Parameters
    ----------
    crossings : Crossings
    calibration : Calibration
        Gives K, which a kappa alone belongs to, and a start.
    frame : int
    image_shape : (height, width)
    settings : Settings
        kappa, a focal length or a calibration file; what they leave open is that of the
        calibration.

    Raises
    ------
    InspectionError
        If the frame has no usable crossing points, or the calibration file is of no use.
    """
    if crossings.frames[frame].why:
        raise InspectionError("This frame has no crossing points to fit: go to another one.")
    if settings.focal_length_px is None and settings.calibration_file is None:
        fit, k = refit_frame(calibration, crossings, frame, settings.kappa), frame
    else:
        alone = replace(crossings, frames=(crossings.frames[frame],))
        fit, k = calibrate(alone, image_shape, settings), 0
    if not fit.used[k]:
        raise InspectionError(f"This frame can't be fitted: {fit.why[k]}")
    segments = frame_grid(crossings.layout, fit.camera, fit.homographies[k], frame)
    return FrameGrid(segments, float(fit.rms_px[k]))


class LiveKappa:
    """Shows the refitted grid of a frame while its points or its lens differ from the fit.

    Attributes
    ----------
    dragged_rms_px : float or None
        Distance of the crossing points from the grid while some are being dragged.
    """

    residual_changed = Signal(str)

    def __init__(
        self,
        viewer: ViewerModel,
        model: WorkbenchModel,
        frames: FramesLayer,
        geometry: GeometryLayers,
        editor: PointEditor,
    ) -> None:
        self._viewer = viewer
        self._model = model
        self._frames = frames
        self._geometry = geometry
        self._editor = editor
        self._dragged: dict[int, Point] = {}
        self.dragged_rms_px: float | None = None
        self._throttled = qthrottled(self.update, timeout=THROTTLE_MS)
        self._soon = QTimer()
        self._soon.setSingleShot(True)
        self._soon.timeout.connect(self._throttled)
        self._lens = _lens(model.settings)
        model.settings_changed.connect(self._on_settings)
        model.inspection_changed.connect(self._on_inspection)
        viewer.dims.events.current_step.connect(self._on_step)

    def close(self) -> None:
        """Disconnect from the viewer."""
        self._soon.stop()
        self._throttled.cancel()
        self._viewer.dims.events.current_step.disconnect(self._on_step)

    @property
    def fitted_kappa(self) -> float | None:
        """Kappa of the newest fit, that of the registration if it still holds; None: no fit."""
        final, fit = self._final_kappa, self._editor.calibration
        return final if final is not None or fit is None else float(fit.camera.kappa)

    @property
    def _final_kappa(self) -> float | None:
        """Kappa that the registration has refined; None before it and after an edit."""
        inspection = self._model.inspection
        if inspection is None or inspection.registration is None or self._editor.provisional:
            return None
        return float(inspection.registration.camera.kappa)

    def drag(self, frame: int, points: dict[int, Point]) -> None:
        """Refit the grid while crossings are dragged; {}: the drag has ended.

        Parameters
        ----------
        frame : int
            The shown one.
        points : {number of the crossing: (x, y) px}
        """
        self._dragged = points if frame == self._frames.frame else {}
        if self._dragged:
            self._throttled()
        else:
            # An edit that follows comes before that, with a grid of its own.
            self.dragged_rms_px = None
            self._soon.start(0)

    def update(self) -> None:
        """Refit the grid of the shown frame, or show the fitted one."""
        inspection, settings, fit = (
            self._model.inspection,
            self._model.settings,
            self._editor.calibration,
        )
        frame = self._frames.frame
        idle = self._model.run_state is RunState.IDLE
        if inspection is None or fit is None or not idle or frame >= len(fit.used):
            return
        kappa = float(fit.camera.kappa)
        why = fit.why[frame].rstrip(".")
        error = f"can't be fitted: {why}" if why else f"{fit.rms_px[frame]:.2f} px from the grid"
        final = self._final_kappa
        named = f"preliminary kappa {kappa:+.4f}" if final is None else f"kappa {final:+.4f}"
        own_kappa = settings.kappa is not None and abs(settings.kappa - kappa) >= 1e-9
        own_file = settings.calibration_file != inspection.settings.calibration_file
        if not own_kappa and not own_file and not self._dragged:
            if self._editor.provisional and fit.used[frame]:
                segments = frame_grid(fit.layout, fit.camera, fit.homographies[frame], frame)
                self._geometry.replace_frame(frame, segments)
            else:
                self._geometry.show_fitted()
            state = "edited, all frames follow" if self._editor.provisional else "fit"
            self.residual_changed.emit(f"This frame, {state}: {named}, crossings {error}")
            return
        crossings = self._editor.with_points(frame, self._dragged)
        if self._dragged and not own_kappa and not own_file:
            settings = inspection.settings.changed(
                kappa=None, focal_length_px=None, calibration_file=None
            )
        try:
            if crossings is None:
                raise InspectionError("There are no crossing points to fit: detect the grid.")
            fitted = fit_frame_grid(crossings, fit, frame, inspection.frames.shape, settings)
        except InspectionError as problem:
            self._geometry.show_fitted()
            self.residual_changed.emit(str(problem))
            return
        self._geometry.replace_frame(frame, fitted.segments)
        self.dragged_rms_px = fitted.rms_px if self._dragged else None
        what = "This frame, dragged" if self._dragged else "This frame"
        self.residual_changed.emit(
            f"{what}: crossings {fitted.rms_px:.2f} px from the grid (fit: {named}, {error})"
        )

    def _on_settings(self, settings: Settings) -> None:
        lens = _lens(settings)
        if lens != self._lens:
            self._lens = lens
            # The live cell may begin meanwhile.
            self._soon.start(0)

    def _on_inspection(self, _: Inspection | None) -> None:
        # At once: points and grid share one repaint.
        self._throttled.cancel()
        self._soon.stop()
        self.update()

    def _on_step(self, _: object = None) -> None:
        # Not within the event: it comes too while napari adds a layer, and it adds one at a time.
        self._soon.start(0)


def _lens(settings: Settings) -> tuple[object, ...]:
    return settings.kappa, settings.focal_length_px, settings.calibration_file
