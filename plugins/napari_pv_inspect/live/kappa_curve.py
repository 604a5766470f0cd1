"""How the residual depends on kappa, computed in the background whenever the fit changes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from psygnal import Signal

from napari_pv_inspect.models.workbench import RunState, WorkbenchModel
from napari_pv_inspect.tasks.latest import LatestOnly
from pv_inspect.calibration.calibrate import Calibration
from pv_inspect.calibration.refit import residual_over_kappa
from pv_inspect.detection.crossings import Crossings
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.settings import Settings

__all__ = ["Curve", "KappaCurve"]

N_KAPPAS = 25
REST_MS = 300


@dataclass(frozen=True)
class Curve:
    """Residual over kappa.

    Attributes
    ----------
    kappas, rms_px : (n,) float64
        Rising; NaN where a crossing point has no image.
    best : float
        Kappa of the fit.
    """

    kappas: NDArray[np.float64]
    rms_px: NDArray[np.float64]
    best: float

    def at(self, kappa: float) -> float:
        """Residual between the computed values, px."""
        known = np.isfinite(self.rms_px)
        if not known.any():
            return float("nan")
        return float(np.interp(kappa, self.kappas[known], self.rms_px[known]))


class KappaCurve:
    """Keeps the curve of the fit that is shown; ``curve`` is None while there is none."""

    changed = Signal(object)

    def __init__(self, model: WorkbenchModel) -> None:
        self._model = model
        self.curve: Curve | None = None
        self._of: Calibration | None = None
        self._latest = LatestOnly(self._set, self._on_failure, delay_ms=REST_MS)
        model.sequence_changed.connect(self._forget)
        model.inspection_changed.connect(self._on_inspection)

    @property
    def busy(self) -> bool:
        """Whether a curve is still to come."""
        return self._latest.busy

    def close(self) -> None:
        """Compute no more curves."""
        self._latest.close()

    def _on_inspection(self, inspection: Inspection | None) -> None:
        if inspection is None:
            self._forget()
            return
        fit, crossings = inspection.calibration, inspection.crossings
        idle = self._model.run_state is RunState.IDLE
        if fit is None or crossings is None or not idle or fit is self._of:
            return
        self._of = fit
        kappa = float(fit.camera.kappa)
        kappas = np.unique(np.append(np.linspace(*Settings.slider_of("kappa"), N_KAPPAS), kappa))
        self._latest.ask(partial(_curve, crossings, fit, kappas))

    def _forget(self, _: object = None) -> None:
        self._of = None
        self._latest.cancel()
        self._set(None)

    def _on_failure(self, _: InspectionError) -> None:
        # A curve is an extra: without it nothing is lost.
        self._set(None)

    def _set(self, curve: Curve | None) -> None:
        if curve is not self.curve:
            self.curve = curve
            self.changed.emit(curve)


def _curve(crossings: Crossings, fit: Calibration, kappas: NDArray[np.float64]) -> Curve:
    residuals = residual_over_kappa(crossings, fit, [float(k) for k in kappas])
    return Curve(kappas, residuals, float(fit.camera.kappa))
