"""The optical blur out of the borders of cells, which are sharp and whose place is known.

Every frame and axis has its own second moment of blur: that of the optics and that of its motion
along the axis, which is never negative. The optics are what the sharpest of them have in common.
What blur is left in the module image is measured by `pv_inspect.reconstruction.image_blur`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pv_inspect.observation.psf import footprint_variance_lr_px2
from pv_inspect.reconstruction.border_fit import BorderFit, Shape, fit_borders
from pv_inspect.reconstruction.border_profiles import (
    BINS,
    BorderProfiles,
    border_profiles,
    clean_reach,
)
from pv_inspect.reconstruction.border_samples import REACH_LR_PX, BorderSamples
from pv_inspect.reconstruction.optics_and_motion import common_moment, contradicted_frames

__all__ = ["BorderBlur", "blur_of_borders"]

Array = NDArray[np.float64]

# Distance from the line at which the level of a cell begins, LR px: at first, and the limits; in
# standard deviations of what one pixel sees.
_LEVEL_FROM, _LEVEL_LIMITS, _LEVEL_SIGMAS = 2.1, (1.7, 2.9), 2.6
# The level is read over this length, and over no less, LR px.
_LEVEL_LENGTH, _LEAST_LENGTH = 2.2, 0.9
# Profiles with a second moment of this much more than the sharpest are blurred by motion, LR px^2.
_BLURRED = 0.12
_LEAST_SAMPLES, _LEAST_PAIRS = 400, 3
# Difference of the costs by which one shape is told from the other.
_TELLING = 10.0
# Floor of the error: softness of the borders themselves [LR px^2], and a share of sigma. From the
# training seeds of `benchmarks/psf_truth.py`.
_SOFTNESS_ERROR, _RELATIVE_ERROR = 0.008, 0.02


@dataclass(frozen=True)
class BorderBlur:
    """What the borders of cells say of the optics.

    Parameters
    ----------
    sigma : float
        Standard deviation per axis, LR px.
    error : float
        Of sigma, one standard deviation, LR px.
    shape : {"gaussian", "disc"}
    told : float
        How much better the shape fits than the other, -2 log likelihood.
    still : tuple of int
        Places in the list of frames of those that did not move, though a motion was found.
    """

    sigma: float
    error: float
    shape: Shape
    told: float
    still: tuple[int, ...] = ()


def blur_of_borders(samples: BorderSamples, lengths: Array) -> BorderBlur | None:
    """Estimate the optical blur.

    Parameters
    ----------
    samples : BorderSamples
    lengths : (n_frames,) float64
        Path of every frame during its exposure, LR px; 0 where no motion was found.

    Returns
    -------
    BorderBlur, or None if the borders can't be read: too few of them, or busbars too close to them.
    """
    if len(samples) < _LEAST_SAMPLES:
        return None
    profiles = _readable(samples, _LEVEL_FROM)
    if profiles is None:
        return None
    first = fit_borders(profiles, "gaussian")
    still = contradicted_frames(
        first.pairs, first.moments, first.covariance, _motion_of(profiles), lengths
    )
    samples = samples.still(still)
    profiles = _sharp(samples, first)
    if profiles is None:
        return None
    fits: dict[Shape, BorderFit] = {
        "gaussian": fit_borders(profiles, "gaussian", first),
        "disc": fit_borders(profiles, "disc", first),
    }
    motion = _motion_of(profiles)
    told = fits["gaussian"].cost - fits["disc"].cost
    share = 1.0 / (1.0 + np.exp(-np.clip(told / _TELLING, -50.0, 50.0)))
    shape: Shape = "disc" if share > 0.5 else "gaussian"
    found = {s: common_moment(f.moments, f.covariance, motion) for s, f in fits.items()}
    (round_moment, round_error), (disc_moment, disc_error) = found["gaussian"], found["disc"]
    moment = (1.0 - share) * round_moment + share * disc_moment
    between = share * (1.0 - share) * (round_moment - disc_moment) ** 2
    variance = (1.0 - share) * round_error**2 + share * disc_error**2 + between
    misfit = max(fits[shape].misfit, 1.0)
    variance += _SOFTNESS_ERROR**2 + (2.0 * _RELATIVE_ERROR * misfit * moment) ** 2
    sigma = float(np.sqrt(moment))
    error = float(np.sqrt(variance)) / (2.0 * sigma)
    return BorderBlur(sigma, error, shape, float(abs(told)), tuple(still.tolist()))


def _readable(samples: BorderSamples, start: float) -> BorderProfiles | None:
    """Profiles that can be read; None if there are too few."""
    reach = clean_reach(samples, start, min(start + _LEVEL_LENGTH, REACH_LR_PX))
    ends = tuple(end if end - start >= _LEAST_LENGTH else 0.0 for end in reach)
    profiles = border_profiles(samples, start, (ends[0], ends[1]))
    seen = (profiles.count >= 3).sum(axis=1)
    keep = (profiles.count.sum(axis=1) > _LEAST_SAMPLES) & (seen > 0.7 * BINS)
    if len(np.unique(profiles.pair[keep])) < _LEAST_PAIRS:
        return None
    return profiles.picked(keep)


def _sharp(samples: BorderSamples, first: BorderFit) -> BorderProfiles | None:
    """Profiles of the frames and axes that motion has not blurred, with their levels read anew.

    How far from a border its blur reaches is known only now.
    """
    least = float(np.partition(first.moments, _LEAST_PAIRS - 1)[_LEAST_PAIRS - 1])
    sharp = first.pairs[first.moments <= least + _BLURRED]
    spread = np.sqrt(footprint_variance_lr_px2(np.sqrt(least)))
    start = float(np.clip(first.gap / 2 + _LEVEL_SIGMAS * spread, *_LEVEL_LIMITS))
    for level_from in (start, _LEVEL_FROM):
        profiles = _readable(samples, level_from)
        if profiles is not None:
            profiles = profiles.picked(np.isin(profiles.pair, sharp))
            if len(np.unique(profiles.pair)) >= _LEAST_PAIRS:
                return profiles
    return None


def _motion_of(profiles: BorderProfiles) -> Array:
    """Motion of every frame and axis, (n_pairs,) LR px."""
    pairs, at = np.unique(profiles.pair, return_inverse=True)
    return np.asarray(np.bincount(at, profiles.motion) / np.bincount(at, minlength=len(pairs)))
