"""The optical blur from all evidence that a sequence holds, with its uncertainty.

The borders of cells and their place are known, not how sharp they are themselves: they tell the
largest blur of the optics, and the least within some tenths of a pixel. In between, pixels that
were held out decide.
"""

from __future__ import annotations

from collections.abc import Generator

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.work import Progress, forwarded
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.photometry.photometry import Photometry, observed
from pv_inspect.reconstruction.border_blur import EdgeBlur, blur_of_edges
from pv_inspect.reconstruction.edge_samples import edge_samples
from pv_inspect.reconstruction.held_out import cut_view
from pv_inspect.reconstruction.psf_estimate import PsfEstimate
from pv_inspect.reconstruction.psf_estimation import (
    SEARCHED_LR_PX,
    TYPICAL_SIGMA_LR_PX,
    TYPICAL_SPREAD_LR_PX,
    estimate_psf_sigma,
    window_of,
)
from pv_inspect.reconstruction.single_frame import bicubic
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["HELD_OUT_ERROR", "TYPICAL", "between_which", "combined", "estimate_psf"]

Array = NDArray[np.float64]

HELD_OUT_ERROR = 0.22
"""Relative error of what held-out pixels say: their spread on the seeds 0 to 29 of
`benchmarks/psf_truth.py`."""

# The softest borders, module units, standard deviation. Photographs of cells that scenes were made
# from have up to this: it was chosen with the eight development sequences in view.
_SOFTEST = 0.0055
# Where the largest sigma is less than this times the least, no other evidence is needed.
_SURE = 1.12
# Frames that the PSF is estimated from.
_FRAMES = 20
# The lens does not depend on the magnification that is wanted: its blur is looked for at this one.
_MAGNIFICATION = 4.0
# Nearer to the limits of the search nothing was found, LR px.
_NEAR_LIMIT = 0.03


TYPICAL = PsfEstimate(TYPICAL_SIGMA_LR_PX, TYPICAL_SPREAD_LR_PX, "typical")
"""What is assumed where the frames don't tell it."""


def between_which(borders: EdgeBlur, lr_px_per_unit: float) -> tuple[float, float]:
    """Least and largest sigma [LR px] that the borders of cells allow.

    Parameters
    ----------
    borders : EdgeBlur
    lr_px_per_unit : float

    Notes
    -----
    Borders are at most as sharp as what the optics show of them: a border that is soft itself makes
    the optics look too wide, never too sharp.
    """
    soft = _SOFTEST * lr_px_per_unit
    least = float(np.sqrt(max(borders.sigma**2 - soft**2, 0.0)))
    low, high = SEARCHED_LR_PX
    return max(least - borders.error, low), min(borders.sigma + borders.error, high)


def combined(borders: EdgeBlur | None, pixels: float | None, lr_px_per_unit: float) -> PsfEstimate:
    """Combine what borders and held-out pixels say.

    Parameters
    ----------
    borders : EdgeBlur or None
    pixels : float or None
        Sigma that predicts held-out pixels best, LR px. At a limit of the search it says nothing.
    lr_px_per_unit : float

    Returns
    -------
    PsfEstimate
        What the held-out pixels say, as far as the borders allow it; the middle of what they allow
        if the pixels say nothing; the typical blur if nothing is known.
    """
    low, high = SEARCHED_LR_PX
    if pixels is not None and not low + _NEAR_LIMIT < pixels < high - _NEAR_LIMIT:
        pixels = None
    if borders is None:
        if pixels is None:
            return TYPICAL
        return PsfEstimate(pixels, HELD_OUT_ERROR * pixels, "pixels")
    least, largest = between_which(borders, lr_px_per_unit)
    # Standard deviation of an even distribution.
    error = (largest - least) / np.sqrt(12.0)
    if pixels is None:
        sigma = float(np.sqrt((least**2 + largest**2) / 2.0))
        return PsfEstimate(sigma, float(error), "borders", borders.shape)
    sigma = float(np.clip(pixels, least, largest))
    error = min(error, HELD_OUT_ERROR * sigma)
    return PsfEstimate(sigma, float(error), "borders and pixels", borders.shape)


def estimate_psf(
    sequence: FrameSequence,
    registration: Registration,
    photometry: Photometry | None,
    rays: SensorRays,
    motion: Array,
) -> Generator[Progress, None, PsfEstimate]:
    """Estimate the optical blur.

    Parameters
    ----------
    sequence : FrameSequence
    registration : Registration
    photometry : Photometry or None
    rays : SensorRays
    motion : (n_frames, 2) float64

    Yields
    ------
    Progress
        From 0.25 to 0.4.

    Returns
    -------
    PsfEstimate
    """
    yield Progress(0.25, "estimating the PSF")
    used = np.flatnonzero(registration.used)
    if used.size > _FRAMES:
        used = used[np.linspace(0, used.size - 1, _FRAMES).round().astype(int)]
    samples = edge_samples(sequence, registration, used, photometry, rays, motion)
    yield Progress(0.28, "estimating the PSF")
    borders = blur_of_edges(samples)
    del samples
    per_unit = registration.lr_px_per_unit
    if borders is not None:
        least, largest = between_which(borders, per_unit)
        if largest < _SURE * least:
            return combined(borders, None, per_unit)
    steps = _held_out_sigma(sequence, registration, used, photometry, rays, motion)
    told = "estimating the PSF"
    pixels = yield from forwarded(steps, lambda share: Progress(0.3 + 0.1 * share, told))
    return combined(borders, pixels, per_unit)


def _held_out_sigma(
    sequence: FrameSequence,
    registration: Registration,
    used: NDArray[np.intp],
    photometry: Photometry | None,
    rays: SensorRays,
    motion: Array,
) -> Generator[float, None, float | None]:
    """Sigma that predicts held-out pixels best, on the part of the module with most detail."""
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
    return (yield from estimate_psf_sigma(camera, window, views))
