"""The optical blur from all evidence that a sequence holds, with its uncertainty.

The borders of cells and their place are known, not how sharp they are themselves: they tell the
largest blur of the optics, and the least within some tenths of a pixel. They also tell whether the
frames moved.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.work import Progress, forwarded
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.photometry.photometry import Photometry, observed
from pv_inspect.reconstruction.border_blur import BorderBlur, blur_of_borders
from pv_inspect.reconstruction.border_samples import border_samples
from pv_inspect.reconstruction.held_out import cut_view
from pv_inspect.reconstruction.psf_combination import Evidence, combined, possible
from pv_inspect.reconstruction.psf_estimate import PsfEstimate
from pv_inspect.reconstruction.psf_estimation import SEARCHED_LR_PX, estimate_psf_sigma, window_of
from pv_inspect.reconstruction.single_frame import bicubic
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["estimate_psf", "read_borders", "without_contradicted"]

Array = NDArray[np.float64]

# Frames that the PSF is estimated from.
_FRAMES = 20
# The lens does not depend on the magnification that is wanted: its blur is looked for at this one.
_MAGNIFICATION = 4.0
# Relative error below which held-out pixels are not asked: they are not better.
_SURE = 0.05


def read_borders(
    sequence: FrameSequence,
    registration: Registration,
    photometry: Photometry | None,
    rays: SensorRays,
    motion: Array,
) -> BorderBlur | None:
    """Read the blur of some of the frames off the borders of the cells.

    Parameters
    ----------
    sequence : FrameSequence
    registration : Registration
    photometry : Photometry or None
    rays : SensorRays
    motion : (n_frames, 2) float64
    """
    frames = _some(registration)
    samples = border_samples(sequence, registration, frames, photometry, rays, motion)
    return blur_of_borders(samples, np.hypot(*motion[frames].T))


def without_contradicted(
    motion: Array, registration: Registration, borders: BorderBlur | None
) -> Array:
    """Take back the motions that borders of cells contradict.

    Parameters
    ----------
    motion : (n_frames, 2) float64
    registration : Registration
    borders : BorderBlur or None
        Of `read_borders`.

    Returns
    -------
    (n_frames, 2) float64
        Frames whose borders were not read follow the majority of those that were.
    """
    if borders is None or not borders.still:
        return motion
    read = _some(registration)
    still = read[list(borders.still)]
    others = np.setdiff1d(np.arange(len(motion)), read)
    taken = motion.copy()
    taken[still] = 0.0
    if 2 * len(still) > motion[read].any(axis=1).sum():
        taken[others] = 0.0
    return taken


def estimate_psf(
    sequence: FrameSequence,
    registration: Registration,
    photometry: Photometry | None,
    rays: SensorRays,
    motion: Array,
    borders: BorderBlur | None,
    further: Sequence[Evidence] = (),
) -> Generator[Progress, None, PsfEstimate]:
    """Estimate the optical blur.

    Parameters
    ----------
    sequence : FrameSequence
    registration : Registration
    photometry : Photometry or None
    rays : SensorRays
    motion : (n_frames, 2) float64
    borders : BorderBlur or None
        Of `read_borders`.
    further : sequence of Evidence
        What else is known of the optics.

    Yields
    ------
    Progress
        From 0.3 to 0.4.

    Returns
    -------
    PsfEstimate
    """
    per_unit = registration.lr_px_per_unit
    known = combined(borders, None, per_unit, further)
    if known.evidence != "typical" and known.error < _SURE * known.sigma:
        return known
    within = SEARCHED_LR_PX if borders is None else possible(borders, per_unit)
    steps = _held_out_sigma(sequence, registration, photometry, rays, motion, within)
    told = "estimating the PSF"
    pixels = yield from forwarded(steps, lambda share: Progress(0.3 + 0.1 * share, told))
    return combined(borders, pixels, per_unit, further)


def _some(registration: Registration) -> NDArray[np.intp]:
    """Frames that are looked at."""
    used = np.flatnonzero(registration.used)
    if used.size > _FRAMES:
        used = used[np.linspace(0, used.size - 1, _FRAMES).round().astype(int)]
    return used


def _held_out_sigma(
    sequence: FrameSequence,
    registration: Registration,
    photometry: Photometry | None,
    rays: SensorRays,
    motion: Array,
    within: tuple[float, float],
) -> Generator[float, None, float | None]:
    """Sigma that predicts held-out pixels best, on the part of the module with most detail."""
    used = _some(registration)
    grid = HrGrid.covering(registration.layout, registration.lr_px_per_unit, _MAGNIFICATION)
    camera, homographies = registration.camera, registration.homographies
    # One frame, rectified, shows where detail is.
    draft = bicubic(sequence, registration, grid, int(used[len(used) // 2]))
    smooth = cv2.GaussianBlur(draft, (0, 0), max(grid.magnification / 2, 0.5))
    del draft
    window = window_of(grid, np.asarray(smooth, np.float32))
    del smooth
    views = []
    for i in used:
        g, weights = observed(sequence, registration, int(i), photometry)
        grain = sequence.noise.grain_px
        view = cut_view(camera, homographies[i], rays, window, g, weights, motion[i], grain)
        if view is not None:
            views.append(view)
    if not views:
        return None
    return (yield from estimate_psf_sigma(camera, window, views, within))
