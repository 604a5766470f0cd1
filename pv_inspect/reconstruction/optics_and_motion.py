"""What of the blur of the frames is the optics, and what is motion.

Every frame and axis has a second moment of blur that the borders of cells show: that of the optics,
which is the same for all, and that of the motion along the axis, which is never negative.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

__all__ = ["common_moment", "contradicted_frames"]

Array = NDArray[np.float64]

# Error of one second moment beyond its statistics, LR px^2, and of an estimated motion, LR px.
_MOMENT_ERROR, _MOTION_ERROR = 0.005, 0.25
# Share of the motions that are none.
_FALSE_MOTION = 0.2
# Candidates: second moment of the optics and mean of that of the motion, LR px^2.
_MOMENTS = np.linspace(0.02, 1.5, 593)
_MOTIONS = np.geomspace(0.001, 0.3, 25)
# A motion is contradicted where less than this share of its second moment is seen and one standard
# deviation more. Seeds 60 to 89 of `benchmarks/psf_truth.py`, deviations below 0.4: true motions
# show 0.7 to 1.2 of it, false ones 0 to 0.5.
_LEAST_SEEN = 0.7
# Second moment of a motion that borders must be able to show, LR px^2: that of 0.6 LR px.
_LEAST_MOMENT = 0.03
# Share of the second moment of a motion along the axes that were read.
_LEAST_READ = 0.7


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
    own = _own_error(covariance, common)
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


def contradicted_frames(
    pairs: NDArray[np.int64], moments: Array, covariance: Array, motion: Array, lengths: Array
) -> NDArray[np.int64]:
    """Frames whose borders are as sharp along their motion as if there were none.

    Parameters
    ----------
    pairs : (n,) int64
        2 * frame + axis.
    moments, covariance, motion
        See `common_moment`.
    lengths : (n_frames,) float64
        Whole path of every frame, LR px.

    Returns
    -------
    (n_contradicted,) int64

    Notes
    -----
    With p the second moments along both axes that a motion adds, and d those that the frame has
    beyond the optics, ``p . d / p . p`` is 1 for a motion that is true and 0 for one that is not.
    Frames that may have moved along an axis that was not read are not contradicted. A motion along
    a diagonal that is the same in all frames can't be told from the optics; it is not contradicted
    either.
    """
    optics, error = common_moment(moments, covariance, motion)
    variance = _own_error(covariance, max(float(covariance.mean()), 0.0)) ** 2 + error**2
    expected = motion**2 / 12.0
    frames, at = np.unique(pairs // 2, return_inverse=True)
    size = np.bincount(at, expected**2)
    some = np.maximum(size, 1e-12)
    seen = np.bincount(at, expected * (moments - optics)) / some
    deviation = np.sqrt(np.bincount(at, expected**2 * variance)) / some
    read = np.bincount(at, expected) > _LEAST_READ * lengths[frames] ** 2 / 12.0
    told = read & (size > _LEAST_MOMENT**2)
    return np.asarray(frames[told & (seen + deviation < _LEAST_SEEN)], np.int64)


def _own_error(covariance: Array, common: float) -> Array:
    """Errors of the moments that they don't have in common."""
    own = np.maximum(np.diag(covariance) - common, 0.0) + _MOMENT_ERROR**2
    return np.asarray(np.sqrt(own), np.float64)
