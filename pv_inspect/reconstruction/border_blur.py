"""The optical blur out of the borders of cells, which are sharp and whose place is known.

Every frame and axis has its own second moment of blur: that of the optics and that of its motion
along the axis, which is never negative. The optics are what the sharpest of them have in common.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from pv_inspect.observation.psf import footprint_variance_lr_px2
from pv_inspect.reconstruction.edge_fit import EdgeFit, Shape, fit_edges
from pv_inspect.reconstruction.edge_profiles import (
    BINS,
    EdgeProfiles,
    clean_reach,
    edge_profiles,
)
from pv_inspect.reconstruction.edge_samples import REACH_LR_PX, EdgeSamples

__all__ = ["EdgeBlur", "blur_of_edges", "common_moment"]

Array = NDArray[np.float64]

# Distance from the line at which the level of a cell begins, LR px: at first, and the limits; in
# standard deviations of what one pixel sees.
_LEVEL_FROM, _LEVEL_LIMITS, _LEVEL_SIGMAS = 2.1, (1.7, 2.9), 2.6
# The level is read over this length, and over no less, LR px.
_LEVEL_LENGTH, _LEAST_LENGTH = 2.2, 0.9
# Frames that moved so far along an axis say nothing of the optics, LR px.
_FAR_MOTION = 2.0
# Profiles with a second moment of this much more than the sharpest are blurred by motion, LR px^2.
_BLURRED = 0.12
_LEAST_SAMPLES, _LEAST_PAIRS = 400, 3
# Error of one second moment beyond its statistics, LR px^2, and of an estimated motion, LR px.
_MOMENT_ERROR, _MOTION_ERROR = 0.005, 0.25
# Share of the motions that are none.
_FALSE_MOTION = 0.2
# Difference of the costs by which one shape is told from the other.
_TELLING = 10.0
# Floor of the error: softness of the borders themselves [LR px^2], and a share of sigma. From the
# training seeds of `benchmarks/psf_truth.py`.
_SOFTNESS_ERROR, _RELATIVE_ERROR = 0.008, 0.02
# Candidates: second moment of the optics and mean of that of the motion, LR px^2.
_MOMENTS = np.linspace(0.02, 1.5, 593)
_MOTIONS = np.geomspace(0.001, 0.3, 25)


@dataclass(frozen=True)
class EdgeBlur:
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
    """

    sigma: float
    error: float
    shape: Shape
    told: float


def blur_of_edges(samples: EdgeSamples) -> EdgeBlur | None:
    """Estimate the optical blur.

    Parameters
    ----------
    samples : EdgeSamples

    Returns
    -------
    EdgeBlur, or None if the borders can't be read: too few of them, or busbars too close to them.
    """
    if len(samples) < _LEAST_SAMPLES:
        return None
    start = _LEVEL_FROM
    profiles = _readable(samples, start)
    if profiles is None:
        return None
    first = fit_edges(profiles, "gaussian")
    profiles = _sharp(profiles, first)
    moment = float(np.partition(first.moments, _LEAST_PAIRS - 1)[_LEAST_PAIRS - 1])
    spread = np.sqrt(footprint_variance_lr_px2(np.sqrt(moment)))
    start = float(np.clip(first.gap / 2 + _LEVEL_SIGMAS * spread, *_LEVEL_LIMITS))
    again = _readable(samples, start)
    if again is not None:
        again = again.picked(np.isin(again.pair, profiles.pair))
        profiles = again if len(np.unique(again.pair)) >= _LEAST_PAIRS else profiles
    fits: dict[Shape, EdgeFit] = {
        "gaussian": fit_edges(profiles, "gaussian"),
        "disc": fit_edges(profiles, "disc"),
    }
    motion = np.array(
        [profiles.motion[profiles.pair == pair].mean() for pair in np.unique(profiles.pair)]
    )
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
    return EdgeBlur(sigma, float(np.sqrt(variance)) / (2.0 * sigma), shape, float(abs(told)))


def _readable(samples: EdgeSamples, start: float) -> EdgeProfiles | None:
    """Profiles that can be read; None if there are too few."""
    reach = clean_reach(samples, start, min(start + _LEVEL_LENGTH, REACH_LR_PX))
    ends = tuple(end if end - start >= _LEAST_LENGTH else 0.0 for end in reach)
    profiles = edge_profiles(samples, start, (ends[0], ends[1]))
    seen = (profiles.count >= 3).sum(axis=1)
    keep = (profiles.count.sum(axis=1) > _LEAST_SAMPLES) & (seen > 0.7 * BINS)
    keep &= profiles.motion < _FAR_MOTION
    if len(np.unique(profiles.pair[keep])) < _LEAST_PAIRS:
        return None
    return profiles.picked(keep)


def _sharp(profiles: EdgeProfiles, fit: EdgeFit) -> EdgeProfiles:
    """Profiles of the frames and axes that motion has not blurred."""
    least = float(np.partition(fit.moments, _LEAST_PAIRS - 1)[_LEAST_PAIRS - 1])
    sharp = fit.pairs[fit.moments <= least + _BLURRED]
    return profiles.picked(np.isin(profiles.pair, sharp))


def common_moment(moments: Array, covariance: Array, motion: Array) -> tuple[float, float]:
    """Second moment of the optics out of those of optics and motion.

    Parameters
    ----------
    moments : (n,) float64
        Of optics and motion, LR px^2.
    covariance : (n, n) float64
    motion : (n,) float64
        Estimated path along the axis, LR px, 0 where none was found.

    Returns
    -------
    moment, error : float
        LR px^2.

    Notes
    -----
    ``v_k = s + t_k + noise``: t_k >= 0 is exponentially distributed with an unknown mean where no
    motion was found, m_k^2 / 12 with the error of m_k where one was; a fifth of the motions found
    are none. What the errors have in common stays in full in the error of the mean.
    """
    common = max(float(covariance.mean()), 0.0)
    own = np.sqrt(np.maximum(np.diag(covariance) - common, 0.0) + _MOMENT_ERROR**2)
    s, tau = _MOMENTS[:, None, None], _MOTIONS[None, :, None]
    z = moments - s
    unknown = -np.log(tau) + own**2 / (2 * tau**2) - z / tau + log_ndtr(z / own - own / tau)
    of_motion = motion**2 / 12.0
    width = np.sqrt(own**2 + (motion * _MOTION_ERROR / 6.0) ** 2 + (_MOTION_ERROR**2 / 12.0) ** 2)
    known = -0.5 * ((z - of_motion) / width) ** 2 - np.log(width * np.sqrt(2 * np.pi))
    mixed = np.logaddexp(np.log(_FALSE_MOTION) + unknown, np.log(1 - _FALSE_MOTION) + known)
    likely = np.where(motion > 0, mixed, unknown).sum(-1) - 0.5 * np.log(tau[..., 0])
    weight = np.exp(likely - likely.max()).sum(1)
    weight /= weight.sum()
    mean = float(weight @ _MOMENTS)
    variance = float(weight @ (_MOMENTS - mean) ** 2)
    return mean, float(np.sqrt(variance + common))
