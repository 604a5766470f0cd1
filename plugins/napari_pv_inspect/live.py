"""The grid bends under the hand: the shown frame refitted for the kappa of the slider."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from napari.components import ViewerModel
from numpy.typing import NDArray
from psygnal import Signal
from superqt.utils import qthrottled

from napari_pv_inspect.layers.frames import FramesLayer
from napari_pv_inspect.layers.geometry import GeometryLayers
from napari_pv_inspect.model import RunState, WorkbenchModel
from napari_pv_inspect.overlays import frame_grid
from pv_inspect.calibration import calibrate
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


def bend_frame(inspection: Inspection, frame: int, settings: Settings) -> BentFrame:
    """Fit the pose of one frame with the kappa of ``settings`` to its measured crossing points.

    Raises
    ------
    InspectionError
        If the frame has no usable crossing points.
    """
    if inspection.crossings is None or inspection.crossings.frames[frame].why:
        raise InspectionError("This frame has no crossing points to fit: go to another one.")
    if inspection.calibration is not None and settings.focal_length_px is None:
        # kappa has a meaning for one focal length only: stay with that of the fit.
        focal = float(inspection.calibration.camera.K[0, 0])
        settings = settings.changed(focal_length_px=focal)
    alone = replace(inspection.crossings, frames=(inspection.crossings.frames[frame],))
    fit = calibrate(alone, inspection.sequence.shape, settings)
    if not fit.used[0]:
        raise InspectionError(f"This frame can't be fitted: {fit.why[0]}")
    segments = frame_grid(inspection.layout, fit.camera, fit.homographies[0], frame)
    return BentFrame(segments, float(fit.rms_px[0]))


class LiveKappa:
    """Bends the grid of the shown frame while kappa of the settings differs from the fit."""

    residual_changed = Signal(str)

    def __init__(
        self,
        viewer: ViewerModel,
        model: WorkbenchModel,
        frames: FramesLayer,
        geometry: GeometryLayers,
    ) -> None:
        self._viewer = viewer
        self._model = model
        self._frames = frames
        self._geometry = geometry
        self._throttled = qthrottled(self.update, timeout=THROTTLE_MS)
        model.settings_changed.connect(self._on_settings)
        model.inspection_changed.connect(self._on_inspection)
        viewer.dims.events.current_step.connect(self._on_step)

    def close(self) -> None:
        """Let go of the viewer."""
        self._throttled.cancel()
        self._viewer.dims.events.current_step.disconnect(self._on_step)

    @property
    def fitted_kappa(self) -> float | None:
        """Kappa of the geometry that is shown, None if there is none."""
        inspection = self._model.inspection
        if inspection is None or inspection.calibration is None:
            return None
        return float(inspection.calibration.camera.kappa)

    def update(self) -> None:
        """Bend the grid of the shown frame, or show the fitted one."""
        inspection, settings = self._model.inspection, self._model.settings
        fitted = self.fitted_kappa
        if inspection is None or fitted is None or self._model.run_state is not RunState.IDLE:
            return
        frame = self._frames.frame
        calibration = inspection.calibration
        assert calibration is not None
        at_fit = f"fit: kappa {fitted:+.4f}, {calibration.rms_px[frame]:.2f} px"
        if settings.kappa is None or abs(settings.kappa - fitted) < 1e-9:
            self._geometry.straighten()
            self.residual_changed.emit(f"This frame, {at_fit}")
            return
        try:
            bent = bend_frame(inspection, frame, settings)
        except InspectionError as error:
            self._geometry.straighten()
            self.residual_changed.emit(str(error))
            return
        self._geometry.bend(frame, bent.segments)
        self.residual_changed.emit(f"This frame {bent.rms_px:.2f} px ({at_fit})")

    def _on_settings(self, _: Settings) -> None:
        self._throttled()

    def _on_inspection(self, _: Inspection | None) -> None:
        self._throttled()

    def _on_step(self, _: object = None) -> None:
        self._throttled()
