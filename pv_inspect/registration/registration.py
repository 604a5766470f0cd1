"""The poses of all frames after the photometric registration."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pv_inspect.calibration.calibrate import Calibration
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose

__all__ = ["Registration", "mean_scale", "normalised", "unregistered"]

Array = NDArray[np.float64]
Image = NDArray[np.float32]


@dataclass(frozen=True)
class Registration:
    """Where every LR pixel of every frame lies on the module.

    Frame i, in full-scale units, is g_i = gain_i * (W_i f) + offset_i + noise.

    Parameters
    ----------
    layout : ModuleLayout
    camera : Camera
    homographies : (n_frames, 3, 3) float64
        Module plane to normalised image coordinates.
    used : (n_frames,) bool
    why : tuple of str
        Why a frame is not used; empty for those that are.
    gain, offset : (n_frames,) float64
        Photometry; the geometric mean of the gains is 1.
    rms : (n_frames,) float64
        Registration residual (see `figures`): robust, in units of the noise; NaN if not used.
    comparable : bool
        Whether frames of another module would have been noticed; False where nothing tells the
        cells apart.
    misfit : str
        A sentence on what of the layout the image of all frames contradicts; empty if nothing.
    camera_errors : tuple of float, optional
        Standard deviations of kappa and of the principal point per axis, LR px, where the gaps of
        the module image told them.
    """

    layout: ModuleLayout
    camera: Camera
    homographies: Array
    used: NDArray[np.bool_]
    why: tuple[str, ...]
    gain: Array
    offset: Array
    rms: Array
    comparable: bool = True
    misfit: str = ""
    camera_errors: tuple[float, float] | None = None

    def crossings_px(self, frame: int) -> Array:
        """Crossing points of the layout in one frame: (n_crossings, 2), LR pixels."""
        return self.camera.project(self.homographies[frame], self.layout.crossings())

    def with_kappa(self, kappa: float) -> Registration:
        """Return the registration with another kappa, every crossing point as near as it can be.

        Parameters
        ----------
        kappa : float

        Raises
        ------
        InspectionError
            If a camera with that kappa can't see the module where it is.

        See Also
        --------
        pv_inspect.calibration.refit : What the measured crossing points say of another kappa.
        """
        camera, points = Camera(self.camera.K, kappa), self.layout.crossings()
        homographies = self.homographies.copy()
        for i in np.flatnonzero(self.used):
            pose = Pose(self.camera, self.homographies[i]).under(camera, points)
            if pose is None:
                raise InspectionError(
                    f"With kappa {kappa:.3f} the lens can't show the module where it is: choose a "
                    "kappa nearer to the fitted one."
                )
            homographies[i] = pose.homography
        return replace(self, camera=camera, homographies=homographies)

    @property
    def lr_px_per_unit(self) -> float:
        """Mean scale of the module in the frames that are used, LR pixels per module unit."""
        return mean_scale(self.camera, self.homographies[self.used], self.layout)


def unregistered(calibration: Calibration) -> Registration:
    """Take the poses of the calibration as they are, with gain 1 and offset 0."""
    count = len(calibration.used)
    return Registration(
        calibration.layout,
        calibration.camera,
        calibration.homographies,
        calibration.used,
        calibration.why,
        np.ones(count),
        np.zeros(count),
        np.full(count, np.nan),
    )


def mean_scale(camera: Camera, homographies: Array, layout: ModuleLayout) -> float:
    """LR pixels per module unit: the root of the mean area of a unit square at the crossings."""
    points = layout.crossings()
    jacobians = np.concatenate(
        [np.empty((0, 2, 2)), *(camera.jacobian(H, points) for H in homographies)]
    )
    seen = jacobians[np.isfinite(jacobians).all(axis=(1, 2))]
    return float(np.sqrt(np.abs(np.linalg.det(seen)).mean())) if seen.size else float("nan")


def normalised(
    state: Registration, homographies: Array, gain: Array, offset: Array, rms: Array
) -> Registration:
    """Fix what the frames leave open: the mean gain is 1, the mean offset 0."""
    used = state.used
    if not used.any():
        return state
    factor = float(np.exp(np.log(gain[used]).mean()))
    gain = np.where(used, gain / factor, 1.0)
    # g = gain f + offset stays the same when f + c and offset - gain c are taken instead.
    shift = float((offset[used] / gain[used]).mean())
    offset = np.where(used, offset - gain * shift, 0.0)
    return replace(state, homographies=homographies, gain=gain, offset=offset, rms=rms)
