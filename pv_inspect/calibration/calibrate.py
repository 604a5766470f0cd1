"""Crossing points -> one camera and a homography per frame (paper, Sec. III-A and ref. [38]).

Every frame gets a free homography (8 parameters) to normalised image coordinates; kappa and the
centre of distortion are common to all frames. Robust bundle adjustment with the analytic Jacobian
of `Camera.derivatives`, frames eliminated by the Schur complement.

With free homographies the focal length is a pure gauge: only kappa / f^2 acts on pixels. It is
given, or read off the homographies as in Zhang's method where they determine it, or a convention.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pv_inspect.calibration.bundle_adjustment import Bundle
from pv_inspect.calibration.camera_file import KnownCamera, read_camera
from pv_inspect.calibration.camera_profile import CameraProfile, read_profile
from pv_inspect.calibration.focal_length import (
    FOCAL_TOLERANCE,
    focal_length,
    usual_camera,
)
from pv_inspect.calibration.frame_fits import (
    FrameReasons,
    bundle_of,
    fit_without_outlier_frames,
    in_unit,
    starting_homographies,
    unit_transform,
    views_of,
)
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.settings import Settings

if TYPE_CHECKING:
    from pv_inspect.detection.crossings import Crossings

__all__ = ["Calibration", "calibrate"]

Array = NDArray[np.float64]

# Prior standard deviation of the principal point around the image centre, larger image side = 1.
CENTRE_STD = 1.0 / 128.0


@dataclass(frozen=True, eq=False)
class Calibration:
    """One camera for all frames and where the module lies in each of them.

    Parameters
    ----------
    layout : ModuleLayout
    camera : Camera
    homographies : (n_frames, 3, 3) float64
        Module plane to normalised image coordinates, third component positive in front of the
        camera; NaN for frames that are not used.
    used : (n_frames,) bool
    why : tuple of str
        Reason why a frame is not used, "" for those that are.
    rms_px : (n_frames,) float64
        RMS distance of measured crossing points from the model, LR px; wrong points (outliers) are
        left out for used frames. NaN where no model could be fitted.
    focal_convention : bool
        True if the focal length is a convention: then only kappa / f^2 has a meaning.
    kappa_std : float
        Standard deviation of kappa, errors that repeat themselves in all frames included; 0 if it
        was given.
    crossing_sigma_px : (n_frames, n_crossings) float64 or None
        Standard deviation of a coordinate of `crossings_px`, LR px, from the covariance of the
        fit; NaN for frames that are not used. None if the poses come from elsewhere.
    """

    layout: ModuleLayout
    camera: Camera
    homographies: Array
    used: NDArray[np.bool_]
    why: tuple[str, ...]
    rms_px: Array
    focal_convention: bool
    kappa_std: float
    crossing_sigma_px: Array | None = None

    def crossings_px(self, i: int) -> Array:
        """Return the fitted crossing points of frame i.

        Returns
        -------
        (n_crossings, 2) float64
            Pixels (x, y), row-major, also outside of the frame; NaN without an image or if the
            frame is not used.
        """
        return self.camera.project(self.homographies[i], self.layout.crossings())


def calibrate(
    crossings: Crossings,
    image_shape: tuple[int, int],
    settings: Settings,
    *,
    principal_point_std_px: float | None = None,
) -> Calibration:
    """Fit camera and homographies to the measured crossing points of all frames.

    Parameters
    ----------
    crossings : Crossings
        Crossing points of every frame; only measured ones count, weighted with 1 / sigma_px.
    image_shape : tuple of int
        (height, width) of a frame.
    settings : Settings
        ``kappa`` and ``focal_length_px`` are fixed if given. A kappa that is given without a
        focal length belongs to the focal length that `calibrate` finds. ``calibration_file`` fixes
        the whole K and, unless ``kappa`` is given, its own kappa. What ``camera_profile`` says of
        kappa and the principal point acts as a prior where they are not fixed.
    principal_point_std_px : float, optional
        How far the principal point, the centre of distortion, may lie off the image centre: the
        standard deviation of a prior, default 1/128 of the larger image side. 0 fixes it.

    Raises
    ------
    InspectionError
        If no frame has crossing points that fit the module, or the calibration file is of no use.
    """
    std = (
        CENTRE_STD * max(image_shape) if principal_point_std_px is None else principal_point_std_px
    )
    known = _known_camera(image_shape, settings)
    K = usual_camera(image_shape, settings).K if known is None else known.K
    to_unit = unit_transform(crossings.layout)
    frames = FrameReasons(len(crossings.frames))
    views = views_of(crossings, to_unit, frames)
    starts = starting_homographies(views, Camera(K, 0.0), frames)
    bundle = bundle_of(
        Camera(K, 0.0),
        {i: views[i] for i in starts},
        std if known is None else 0.0,
        settings.kappa if known is None else known.kappa,
    )
    if settings.camera_profile is not None and known is None:
        bundle = with_profile(bundle, read_profile(settings.camera_profile, image_shape))
    cell = min(1.0, 1.0 / crossings.layout.cell_aspect) * float(to_unit[0, 0])
    fit = fit_without_outlier_frames(bundle, starts, cell, frames)

    convention = settings.focal_length_px is None and known is None
    if convention:
        # A kappa that was given moves with the focal length that it belongs to: fit again.
        for _ in range(1 if settings.kappa is None else 4):
            found = focal_length(fit)
            if found is None or found[1] > FOCAL_TOLERANCE:
                break
            convention = False
            if settings.kappa is None:
                fit = fit.with_focal_length(found[0])
            elif abs(found[0] / fit.bundle.focal - 1.0) > 1e-6:
                fit = fit.with_focal_length(found[0]).with_kappa(settings.kappa).refined()

    homographies = np.full((frames.n, 3, 3), np.nan)
    sigma = np.full((frames.n, crossings.layout.n_crossings), np.nan)
    predicted = fit.predicted_sigma_px(in_unit(crossings.layout, to_unit))
    for i, H in fit.homographies.items():
        homographies[i] = H @ to_unit
        frames.rms[i] = fit.rms_px(i)
        sigma[i] = predicted[i]
    return Calibration(
        layout=crossings.layout,
        camera=fit.camera,
        homographies=homographies,
        used=np.array([not reason for reason in frames.why]),
        why=tuple(frames.why),
        rms_px=frames.rms,
        focal_convention=convention,
        kappa_std=fit.kappa_std,
        crossing_sigma_px=sigma,
    )


def with_profile(bundle: Bundle, profile: CameraProfile) -> Bundle:
    """Return the problem with what a camera profile says of lens and principal point as a prior."""
    kappa, point = profile.kappa_at(bundle.focal), profile.principal_point
    if kappa is not None and bundle.kappa is None:
        bundle = replace(bundle, known_kappa=(kappa.value, kappa.error))
    if point is not None and bundle.centre_std > 0:
        bundle = replace(bundle, centre=point[0], centre_std=point[1])
    return bundle


def _known_camera(image_shape: tuple[int, int], settings: Settings) -> KnownCamera | None:
    """Return the camera of the user's calibration file; a kappa in the settings wins over its."""
    if settings.calibration_file is None:
        return None
    if settings.focal_length_px is not None:
        raise InspectionError(
            f"Both a focal length ({settings.focal_length_px:g} px) and a calibration file "
            f"({settings.calibration_file}) are given: give only one of them."
        )
    known = read_camera(settings.calibration_file, image_shape)
    return known if settings.kappa is None else KnownCamera(known.K, settings.kappa)
