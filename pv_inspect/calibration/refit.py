"""A calibration once more for one frame, or for other values of kappa.

Two questions, two answers on purpose: `residual_over_kappa` goes from one kappa to the next over
the same inliers, which compares; `refit_frame` starts from the points alone, as they may have been
edited. Both fit measured points. Where the frames are registered already, nothing is measured
again: there `pv_inspect.geometry.pose.Pose.under` gives the poses under another camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pv_inspect.calibration.bundle_adjustment import Fit
from pv_inspect.calibration.calibrate import Calibration
from pv_inspect.calibration.frame_fits import (
    FrameReasons,
    bundle_of,
    fit_without_outlier_frames,
    starting_homographies,
    unit_transform,
    views_of,
)
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.camera import Camera

if TYPE_CHECKING:
    from pv_inspect.detection.crossings import Crossings

__all__ = ["refit_frame", "residual_over_kappa"]

Array = NDArray[np.float64]


def refit_frame(
    calibration: Calibration, crossings: Crossings, i: int, kappa: float | None = None
) -> Calibration:
    """Fit the pose of one frame to its crossing points, under the camera that is known.

    Parameters
    ----------
    calibration : Calibration
        Its camera is held, its other frames stay.
    crossings : Crossings
        Those of frame i may have changed since.
    i : int
    kappa : float, optional
        Held instead of that of the calibration.

    Returns
    -------
    Calibration
        With frame i not used, and the reason, if its points do not determine a pose.
    """
    camera = calibration.camera
    if kappa is not None:
        camera = Camera(camera.K, kappa)
    to_unit, frames = unit_transform(crossings.layout), FrameReasons(1)
    alone = replace(crossings, frames=(crossings.frames[i],))
    homography, rms = np.full((3, 3), np.nan), np.nan
    with suppress(InspectionError):
        views = views_of(alone, to_unit, frames)
        starts = starting_homographies(views, Camera(camera.K, 0.0), frames)
        bundle = bundle_of(camera, views, 0.0, camera.kappa)
        cell = min(1.0, 1.0 / crossings.layout.cell_aspect) * float(to_unit[0, 0])
        fit = fit_without_outlier_frames(bundle, starts, cell, frames)
        homography, rms = fit.homographies[0] @ to_unit, fit.rms_px(0)
    homographies, rms_px = calibration.homographies.copy(), calibration.rms_px.copy()
    used = calibration.used.copy()
    homographies[i], rms_px[i], used[i] = homography, rms, not frames.why[0]
    return replace(
        calibration,
        camera=camera,
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
    to_unit, frames = unit_transform(crossings.layout), FrameReasons(len(crossings.frames))
    views = views_of(crossings, to_unit, frames)
    used = [i for i in views if calibration.used[i]]
    chosen = [used[k] for k in np.unique(np.linspace(0, len(used) - 1, n_frames).astype(int))]
    camera = calibration.camera
    bundle = bundle_of(camera, {i: views[i] for i in chosen}, 0.0, camera.kappa)
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
