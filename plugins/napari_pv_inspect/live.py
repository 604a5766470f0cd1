"""The grid bends under the hand: the shown frame refitted for edited points or another kappa."""

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
from napari_pv_inspect.model import RunState, WorkbenchModel
from napari_pv_inspect.overlays import frame_grid
from napari_pv_inspect.point_editor import PointEditor
from pv_inspect.calibration import Calibration, calibrate
from pv_inspect.crossings import Crossings
from pv_inspect.errors import InspectionError
from pv_inspect.pipeline import Inspection
from pv_inspect.settings import Settings

__all__ = ["BentFrame", "LiveKappa", "bend_frame"]

# A repaint costs up to 100 ms without a graphics card.
THROTTLE_MS = 80


@dataclass(frozen=True)
class BentFrame:
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


def bend_frame(
    crossings: Crossings,
    calibration: Calibration | None,
    frame: int,
    image_shape: tuple[int, int],
    settings: Settings,
) -> BentFrame:
    """Fit the pose of one frame with the lens of ``settings`` to its measured crossing points.

    Parameters
    ----------
    crossings : Crossings
    calibration : Calibration or None
        Gives the focal length that kappa belongs to.
    frame : int
    image_shape : (height, width)
    settings : Settings
        kappa, or a calibration file.

    Raises
    ------
    InspectionError
        If the frame has no usable crossing points, or the calibration file is of no use.
    """
    if crossings.frames[frame].why:
        raise InspectionError("This frame has no crossing points to fit: go to another one.")
    free = settings.focal_length_px is None and settings.calibration_file is None
    if calibration is not None and free:
        # kappa has a meaning for one focal length only: stay with that of the fit.
        settings = settings.changed(focal_length_px=float(calibration.camera.K[0, 0]))
    alone = replace(crossings, frames=(crossings.frames[frame],))
    fit = calibrate(alone, image_shape, settings)
    if not fit.used[0]:
        raise InspectionError(f"This frame can't be fitted: {fit.why[0]}")
    segments = frame_grid(crossings.layout, fit.camera, fit.homographies[0], frame)
    return BentFrame(segments, float(fit.rms_px[0]))


class LiveKappa:
    """Bends the grid of the shown frame while its points or its lens differ from the fit."""

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
        self._throttled = qthrottled(self.update, timeout=THROTTLE_MS)
        # After an edit the window may answer between the points and the grid.
        self._soon = QTimer()
        self._soon.setSingleShot(True)
        self._soon.timeout.connect(self._throttled)
        model.settings_changed.connect(self._on_settings)
        model.inspection_changed.connect(self._on_inspection)
        viewer.dims.events.current_step.connect(self._on_step)

    def close(self) -> None:
        """Let go of the viewer."""
        self._soon.stop()
        self._throttled.cancel()
        self._viewer.dims.events.current_step.disconnect(self._on_step)

    @property
    def fitted_kappa(self) -> float | None:
        """Kappa of the newest fit, None if there is none."""
        fit = self._editor.calibration
        return None if fit is None else float(fit.camera.kappa)

    def update(self) -> None:
        """Bend the grid of the shown frame, or show the fitted one."""
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
        error = f"can't be fitted: {why}" if why else f"{fit.rms_px[frame]:.2f} px"
        own_kappa = settings.kappa is not None and abs(settings.kappa - kappa) >= 1e-9
        own_file = settings.calibration_file != inspection.settings.calibration_file
        if not own_kappa and not own_file:
            if self._editor.provisional and fit.used[frame]:
                segments = frame_grid(fit.layout, fit.camera, fit.homographies[frame], frame)
                self._geometry.bend(frame, segments)
            else:
                self._geometry.straighten()
            state = "edited, all frames follow" if self._editor.provisional else "fit"
            self.residual_changed.emit(f"This frame, {state}: kappa {kappa:+.4f}, {error}")
            return
        crossings = self._editor.crossings
        try:
            if crossings is None:
                raise InspectionError("There are no crossing points to fit: detect the grid.")
            bent = bend_frame(crossings, fit, frame, inspection.sequence.shape, settings)
        except InspectionError as problem:
            self._geometry.straighten()
            self.residual_changed.emit(str(problem))
            return
        self._geometry.bend(frame, bent.segments)
        self.residual_changed.emit(
            f"This frame {bent.rms_px:.2f} px (fit: kappa {kappa:+.4f}, {error})"
        )

    def _on_settings(self, _: Settings) -> None:
        self._throttled()

    def _on_inspection(self, _: Inspection | None) -> None:
        self._soon.start(0)

    def _on_step(self, _: object = None) -> None:
        # Not within the event: it comes too while napari adds a layer, and it adds one at a time.
        self._soon.start(0)
