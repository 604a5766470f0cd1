"""Crossing points -> one camera and a homography per frame (paper, Sec. III-A and ref. [38]).

Every frame gets a free homography (8 parameters) to normalised image coordinates; kappa and the
centre of distortion are common to all frames. Robust bundle adjustment with the analytic Jacobian
of `Camera.derivatives`, frames eliminated by the Schur complement.

With free homographies the focal length is a pure gauge: only kappa / f^2 acts on pixels. It is
given, or read off the homographies as in Zhang's method where they determine it, or a convention.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.calibration.bundle_adjustment import Bundle, Fit, View, focal_length
from pv_inspect.calibration.camera_file import KnownCamera, read_camera
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.settings import Settings

if TYPE_CHECKING:
    from pv_inspect.detection.crossings import Crossings, FrameCrossings

__all__ = [
    "Calibration",
    "calibrate",
    "conventional_focal_length",
    "focal_length_source",
    "refit_frame",
    "residual_over_kappa",
]

Array = NDArray[np.float64]

# Focal length by convention, in units of the larger image side: a field of view of 45 degrees.
FOCAL_CONVENTION = 1.2
# The focal length is taken from the homographies if its relative standard deviation is below this.
FOCAL_TOLERANCE = 0.03
# Prior standard deviation of the principal point around the image centre, larger image side = 1.
CENTRE_STD = 1.0 / 128.0
MIN_POINTS = 8


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
        the whole K and, unless ``kappa`` is given, its own kappa.
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
    K = _usual_matrix(image_shape, settings) if known is None else known.K
    to_unit = _to_unit(crossings.layout)
    frames = _Frames(len(crossings.frames))
    views = _views(crossings, to_unit, frames)
    starts = _starting_homographies(views, Camera(K, 0.0), frames)
    bundle = _bundle_of(
        Camera(K, 0.0),
        {i: views[i] for i in starts},
        std if known is None else 0.0,
        settings.kappa if known is None else known.kappa,
    )
    cell = min(1.0, 1.0 / crossings.layout.cell_aspect) * float(to_unit[0, 0])
    fit = _fit_without_strangers(bundle, starts, cell, frames)

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
    predicted = fit.predicted_sigma_px(_in_unit(crossings.layout, to_unit))
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


def refit_frame(calibration: Calibration, crossings: Crossings, i: int) -> Calibration:
    """Fit the pose of one frame to its crossing points, under the camera that is known.

    Parameters
    ----------
    calibration : Calibration
        Its camera is held, its other frames stay.
    crossings : Crossings
        Those of frame i may have changed since.
    i : int

    Returns
    -------
    Calibration
        With frame i not used, and the reason, if its points do not determine a pose.
    """
    to_unit, frames = _to_unit(crossings.layout), _Frames(1)
    alone = replace(crossings, frames=(crossings.frames[i],))
    homography, rms = np.full((3, 3), np.nan), np.nan
    with suppress(InspectionError):
        views = _views(alone, to_unit, frames)
        starts = _starting_homographies(views, Camera(calibration.camera.K, 0.0), frames)
        bundle = _bundle_of(calibration.camera, views, 0.0, calibration.camera.kappa)
        cell = min(1.0, 1.0 / crossings.layout.cell_aspect) * float(to_unit[0, 0])
        fit = _fit_without_strangers(bundle, starts, cell, frames)
        homography, rms = fit.homographies[0] @ to_unit, fit.rms_px(0)
    homographies, rms_px = calibration.homographies.copy(), calibration.rms_px.copy()
    used = calibration.used.copy()
    homographies[i], rms_px[i], used[i] = homography, rms, not frames.why[0]
    return replace(
        calibration,
        homographies=homographies,
        used=used,
        why=(*calibration.why[:i], frames.why[0], *calibration.why[i + 1 :]),
        rms_px=rms_px,
        crossing_sigma_px=None,
    )


def residual_over_kappa(
    crossings: Crossings,
    calibration: Calibration,
    kappas: Sequence[float],
    *,
    n_frames: int = 8,
) -> Array:
    """RMS distance of the crossing points from the model for other values of kappa.

    Parameters
    ----------
    crossings, calibration
        What was measured and what was fitted to it. Points that are outliers of the fit stay out.
    kappas : sequence of float
        For the focal length of the calibration.
    n_frames : int
        So many used frames, spread over the sequence, are looked at.

    Returns
    -------
    (n_kappas,) float64
        LR px; NaN where a point has no image.

    Notes
    -----
    Poses are fitted for every kappa, each starting from those of its neighbour towards the fit;
    the principal point stays where the calibration has it.
    """
    to_unit, frames = _to_unit(crossings.layout), _Frames(len(crossings.frames))
    views = _views(crossings, to_unit, frames)
    used = [i for i in views if calibration.used[i]]
    chosen = [used[k] for k in np.unique(np.linspace(0, len(used) - 1, n_frames).astype(int))]
    camera = calibration.camera
    bundle = _bundle_of(camera, {i: views[i] for i in chosen}, 0.0, camera.kappa)
    from_unit = np.linalg.inv(to_unit)
    poses = {i: calibration.homographies[i] @ from_unit for i in chosen}
    start = Fit(
        bundle,
        {i: H / H[2, 2] for i, H in poses.items()},
        np.array([camera.kappa, *bundle.centre]),
        {i: np.ones(len(view.px), dtype=bool) for i, view in bundle.views.items()},
        scale=1.0,
    )
    start = replace(start, scale=start.robust_scale()).refined()
    order = np.argsort(kappas)
    below = [k for k in order[::-1] if kappas[k] <= camera.kappa]
    above = [k for k in order if kappas[k] > camera.kappa]
    residuals = np.full(len(kappas), np.nan)
    for way in (below, above):
        fit = start
        for k in way:
            fit = fit.at_kappa(float(kappas[k]))
            errors = [fit.rms_px(i) ** 2 for i in chosen]
            residuals[k] = np.sqrt(np.mean(errors))
    return residuals


def _bundle_of(
    camera: Camera, views: dict[int, View], centre_std: float, kappa: float | None
) -> Bundle:
    K = camera.K
    return Bundle(
        views=views,
        focal=float(K[0, 0]),
        centre=(float(K[0, 2]), float(K[1, 2])),
        centre_std=centre_std,
        kappa=kappa,
        pixel_shape=K[:2, :2] / K[0, 0],
    )


def conventional_focal_length(image_shape: tuple[int, int]) -> float:
    """Focal length in LR px where nothing tells it: a field of view of 45 degrees."""
    return FOCAL_CONVENTION * float(max(image_shape))


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


def _usual_matrix(image_shape: tuple[int, int], settings: Settings) -> Array:
    """K with square pixels and the principal point in the middle of the image."""
    focal = settings.focal_length_px or conventional_focal_length(image_shape)
    x, y = (image_shape[1] - 1) / 2.0, (image_shape[0] - 1) / 2.0
    return np.array([[focal, 0.0, x], [0.0, focal, y], [0.0, 0.0, 1.0]])


class _Frames:
    """What becomes of each frame while the calibration runs."""

    def __init__(self, n: int) -> None:
        self.n = n
        self.why = [""] * n
        self.rms = np.full(n, np.nan)

    def reject(self, i: int, reason: str) -> None:
        self.why[i] = reason

    def require_some(self) -> None:
        """Raise the most common reason if no frame is left."""
        if not all(self.why):
            return
        if not self.why:
            raise InspectionError(
                "There is no frame to calibrate from: give a sequence of at least one."
            )
        reason, count = Counter(self.why).most_common(1)[0]
        raise InspectionError(
            f"The module could not be located in any of the {self.n} frames ({reason} in {count}): "
            "check rows, cols, cell_aspect, a kappa or focal length that is given, and that the "
            "whole module is in view."
        )


def _to_unit(layout: ModuleLayout) -> Array:
    """Similarity from the module plane to about [-1, 1]^2, for the condition of the equations."""
    width, height = layout.size
    s = 2.0 / max(width, height)
    return np.array([[s, 0, -s * width / 2], [0, s, -s * height / 2], [0, 0, 1.0]])


def _in_unit(layout: ModuleLayout, to_unit: Array) -> Array:
    """Crossing points of the layout, (n_crossings, 2), in the plane of the fit."""
    return np.asarray(layout.crossings() @ to_unit[:2, :2].T + to_unit[:2, 2])


def _views(crossings: Crossings, to_unit: Array, frames: _Frames) -> dict[int, View]:
    points = _in_unit(crossings.layout, to_unit)
    needed = max(4, min(MIN_POINTS, len(points)))
    views = {}
    for i, frame in enumerate(crossings.frames):
        if frame.why:
            frames.reject(i, frame.why)
            continue
        good = np.asarray(frame.measured, dtype=bool) & np.isfinite(frame.points_px).all(axis=1)
        n = int(good.sum())
        if n < needed:
            text = f"only {n} of {len(points)} crossing points were measured" if n else None
            frames.reject(i, text or "crossing points not found")
            continue
        views[i] = View(
            np.flatnonzero(good),
            points[good],
            np.asarray(frame.points_px)[good],
            _sigma(frame)[good],
            None if frame.edited is None else frame.edited[good],
        )
    frames.require_some()
    return views


def _sigma(frame: FrameCrossings) -> Array:
    """Standard deviations of the points; where they are unknown, the usual one of the frame."""
    sigma = np.asarray(frame.sigma_px, dtype=np.float64)
    known = np.isfinite(sigma) & (sigma > 0)
    usual = float(np.median(sigma[known])) if known.any() else 0.2
    return np.maximum(np.where(known, sigma, usual), 0.01)


def _starting_homographies(
    views: dict[int, View], ideal: Camera, frames: _Frames
) -> dict[int, Array]:
    """Homographies to normalised coordinates by least median of squares, no distortion yet."""
    starts = {}
    for i, view in views.items():
        normalised = ideal.to_normalised(view.px)
        H = None
        if np.linalg.matrix_rank(np.cov(view.points.T), tol=1e-6) == 2:
            H, _ = cv2.findHomography(view.points, normalised, cv2.LMEDS)
        if H is None or not np.isfinite(H).all() or abs(H[2, 2]) < 1e-6:
            frames.reject(i, "crossings do not fit the module")
            continue
        H = np.asarray(H, dtype=np.float64) / H[2, 2]  # depth 1 at the centre of the module
        if np.linalg.det(H) <= 0:
            frames.reject(i, "crossings are mirrored")
            continue
        starts[i] = H
    frames.require_some()
    return starts


def _fit_without_strangers(
    bundle: Bundle, starts: dict[int, Array], cell: float, frames: _Frames
) -> Fit:
    """Fit all frames; take out those that do not fit and fit the others again."""
    fit = bundle.fit(starts)
    while True:
        strangers = _strangers(fit, cell)
        if not strangers:
            return fit
        for i, reason in strangers.items():
            frames.reject(i, reason)
            error = fit.typical_error_px(i)
            frames.rms[i] = error if np.isfinite(error) else np.nan
        frames.require_some()
        kept = {i: H for i, H in fit.homographies.items() if i not in strangers}
        fit = fit.bundle.without(strangers).fit(kept)


def _strangers(fit: Fit, cell: float) -> dict[int, str]:
    """Frames whose crossing points do not fit the module, with the reason.

    ``cell`` is the shorter side of a cell in units of the plane of the fit.
    """
    errors = {i: fit.typical_error_px(i) for i in fit.homographies}
    usual = float(np.median(list(errors.values())))
    strangers = {}
    for i, error in errors.items():
        limit = min(max(1.0, 6.0 * usual), 0.15 * cell * fit.px_per_unit(i))
        if not error <= limit:
            much = f" (rms {error:.1f} px)" if np.isfinite(error) else ""
            strangers[i] = f"crossings do not fit the module{much}"
        elif np.linalg.det(fit.homographies[i]) <= 0:
            strangers[i] = "crossings are mirrored"
    return strangers
