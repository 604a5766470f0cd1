"""The focal length: what perspective says of it, and the convention where it says nothing."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from pv_inspect.calibration.bundle_adjustment import Fit
from pv_inspect.geometry.camera import Camera
from pv_inspect.settings import Settings

__all__ = [
    "ASPECT_STD",
    "FOCAL_CONVENTION",
    "FOCAL_TOLERANCE",
    "conventional_focal_length",
    "focal_length",
    "focal_length_source",
    "usual_camera",
]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


# Relative standard deviation of the cell aspect that a user states: gaps are not quite equal.
ASPECT_STD = 0.003


def focal_length(fit: Fit) -> tuple[float, float] | None:
    """Focal length that makes every homography the image of a metric plane.

    Returns
    -------
    tuple of float, or None
        Focal length (LR px) and its relative standard deviation; None if the homographies do not
        determine it at all (all frames seen head-on).

    Notes
    -----
    Zhang 2000 (ref. [38]), Eqs. 3 and 4 for square pixels: with H = [h1 h2 h3] and
    omega = diag(l, l, 1), l = (focal of the fit / f)^2, the two equations h1^T omega h2 = 0 and
    h1^T omega h1 = h2^T omega h2 hold for every frame. Their left sides are weighted with their
    full covariance, with the errors common to all frames: kappa, centre, and the cell aspect,
    which would otherwise pass for tilt.
    """
    equations = fit.normal_equations()
    h = np.array([H.ravel()[:8] for H in fit.homographies.values()])
    h11, h12, _, h21, h22, _, h31, h32 = h.T
    zero = np.zeros_like(h11)
    slope = np.stack([h11 * h12 + h21 * h22, h11**2 + h21**2 - h12**2 - h22**2], axis=1)
    offset = np.stack([h31 * h32, h31**2 - h32**2], axis=1)
    d_slope = np.array(
        [
            [h12, h11, zero, h22, h21, zero, zero, zero],
            [2 * h11, -2 * h12, zero, 2 * h21, -2 * h22, zero, zero, zero],
        ]
    ).transpose(2, 0, 1)
    d_offset = np.array([[*[zero] * 6, h32, h31], [*[zero] * 6, 2 * h31, -2 * h32]])
    d_offset = d_offset.transpose(2, 0, 1)
    inverse = np.linalg.pinv(equations.A)
    common = equations.common_covariance()
    n = len(h)

    def misfit(log_f: float) -> float:
        ratio = (fit.bundle.focal / np.exp(log_f)) ** 2
        error = (ratio * slope + offset).ravel()
        J = ratio * d_slope + d_offset
        covariance = np.zeros((n, 2, n, 2))
        covariance[range(n), :, range(n), :] = J @ inverse @ J.transpose(0, 2, 1)
        G = (J @ inverse @ equations.B).reshape(2 * n, -1)
        stretch = np.zeros((n, 2))
        stretch[:, 1] = 2.0 * ASPECT_STD * (ratio * (h12**2 + h22**2) + h32**2)
        full = covariance.reshape(2 * n, 2 * n) + G @ common @ G.T
        full += np.outer(stretch, stretch)
        return float(error @ np.linalg.solve(full, error))

    grid = np.log(fit.bundle.focal) + np.linspace(np.log(0.25), np.log(6.0), 40)
    try:
        best = int(np.argmin([misfit(x) for x in grid]))
        if best in (0, len(grid) - 1):
            return None
        found = minimize_scalar(misfit, bounds=(grid[best - 1], grid[best + 1]), method="bounded")
        step = 0.01
        curvature = (misfit(found.x + step) - 2 * found.fun + misfit(found.x - step)) / step**2
    except np.linalg.LinAlgError:
        return None
    if not curvature > 0:
        return None
    excess = max(found.fun / max(2 * n - 1, 1), 1.0)
    return float(np.exp(found.x)), float(np.sqrt(2.0 / curvature * excess * fit.repetition))


# Focal length by convention, in units of the larger image side: a field of view of 45 degrees.
FOCAL_CONVENTION = 1.2


# The focal length is taken from the homographies if its relative standard deviation is below this.
FOCAL_TOLERANCE = 0.03


def conventional_focal_length(image_shape: tuple[int, int]) -> float:
    """Focal length in LR px where nothing tells it: a field of view of 45 degrees."""
    return FOCAL_CONVENTION * float(max(image_shape))


def usual_camera(image_shape: tuple[int, int], settings: Settings) -> Camera:
    """Return the camera that a fit starts with: the given focal length, or else the convention.

    Parameters
    ----------
    image_shape : tuple of int
        (height, width) of a frame.
    settings : Settings
        ``focal_length_px`` counts here.
    """
    focal = settings.focal_length_px or conventional_focal_length(image_shape)
    return Camera.centred(focal, image_shape)


def focal_length_source(
    camera: Camera, image_shape: tuple[int, int], settings: Settings
) -> Literal["given", "identified", "convention"]:
    """Say where the focal length of a fitted camera comes from.

    Parameters
    ----------
    camera : Camera
    image_shape : tuple of int
        (height, width) of a frame.
    settings : Settings
        Those that the camera was fitted with.

    Returns
    -------
    str
        "given" by the user, "identified" from the frames, or "convention": then only
        kappa / f^2 has a meaning.
    """
    fixed = settings.focal_length_px is not None or settings.calibration_file is not None
    if fixed and settings.registration_model == "camera":
        return "given"
    if camera.K[0, 0] == conventional_focal_length(image_shape):
        return "convention"
    return "identified"
