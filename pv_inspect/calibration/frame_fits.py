"""Crossing points as views for the bundle adjustment, and its fit without misleading frames."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.calibration.bundle_adjustment import Bundle, Fit, View
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.layout import ModuleLayout

if TYPE_CHECKING:
    from pv_inspect.detection.crossings import Crossings, FrameCrossings

__all__ = [
    "MIN_POINTS",
    "FrameReasons",
    "bundle_of",
    "fit_without_outlier_frames",
    "in_unit",
    "starting_homographies",
    "unit_transform",
    "views_of",
]

Array = NDArray[np.float64]


MIN_POINTS = 8


def bundle_of(
    camera: Camera, views: dict[int, View], centre_std: float, kappa: float | None
) -> Bundle:
    """Return the bundle of views that one camera took; kappa is fitted if None."""
    K = camera.K
    return Bundle(
        views=views,
        focal=float(K[0, 0]),
        centre=(float(K[0, 2]), float(K[1, 2])),
        centre_std=centre_std,
        kappa=kappa,
        pixel_shape=K[:2, :2] / K[0, 0],
    )


class FrameReasons:
    """What becomes of each frame while the calibration runs."""

    def __init__(self, n: int) -> None:
        self.n = n
        self.why = [""] * n
        self.rms = np.full(n, np.nan)

    def reject(self, i: int, reason: str) -> None:
        """Leave a frame out."""
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


def unit_transform(layout: ModuleLayout) -> Array:
    """Similarity from the module plane to about [-1, 1]^2, for the condition of the equations."""
    width, height = layout.size
    s = 2.0 / max(width, height)
    return np.array([[s, 0, -s * width / 2], [0, s, -s * height / 2], [0, 0, 1.0]])


def in_unit(layout: ModuleLayout, to_unit: Array) -> Array:
    """Crossing points of the layout, (n_crossings, 2), in the plane of the fit."""
    return np.asarray(layout.crossings() @ to_unit[:2, :2].T + to_unit[:2, 2])


def views_of(crossings: Crossings, to_unit: Array, frames: FrameReasons) -> dict[int, View]:
    """Return the measured crossing points of every frame that shows enough of them."""
    points = in_unit(crossings.layout, to_unit)
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


def starting_homographies(
    views: dict[int, View], ideal: Camera, frames: FrameReasons
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


def fit_without_outlier_frames(
    bundle: Bundle, starts: dict[int, Array], cell: float, frames: FrameReasons
) -> Fit:
    """Fit all frames; take out those that do not fit and fit the others again."""
    fit = bundle.fit(starts)
    while True:
        strangers = _outlier_frames(fit, cell)
        if not strangers:
            return fit
        for i, reason in strangers.items():
            frames.reject(i, reason)
            error = fit.typical_error_px(i)
            frames.rms[i] = error if np.isfinite(error) else np.nan
        frames.require_some()
        kept = {i: H for i, H in fit.homographies.items() if i not in strangers}
        fit = fit.bundle.without(strangers).fit(kept)


def _outlier_frames(fit: Fit, cell: float) -> dict[int, str]:
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
