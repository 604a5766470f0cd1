"""One optical blur out of all that is known of it.

Borders of cells show the blur of the optics and of the scene together; how soft the scene is by
itself is known as a prior only. Held-out pixels tell it well or not at all. Any further piece of
evidence is a sigma with its error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from pv_inspect.reconstruction.border_blur import BorderBlur
from pv_inspect.reconstruction.psf_estimate import PsfEstimate, PsfMeasurements
from pv_inspect.reconstruction.psf_estimation import (
    SEARCHED_LR_PX,
    TYPICAL_SIGMA_LR_PX,
    TYPICAL_SPREAD_LR_PX,
)

__all__ = ["TYPICAL", "Evidence", "combined", "combined_over_sequences", "possible"]

Array = NDArray[np.float64]

# Softness of scenes, cell widths, standard deviation: a share of them is sharp up to the first, the
# others are anything up to the second, which photographs of cells have that scenes were made from:
# it was chosen with the eight development sequences in view.
_SHARP, _SOFTEST, _SHARP_SHARE = 0.0014, 0.0055, 0.5
# Held-out pixels, relative errors: a share of the scenes has the detail that their prior expects,
# the others tell next to nothing. From the seeds 60 to 89 of `benchmarks/psf_truth.py`, and as
# large a share as keeps what the pixels say of the eight development sequences.
_PIXELS_GOOD, _PIXELS_ERROR, _PIXELS_WRONG = 0.3, 0.01, 0.3
# Their error where no borders check them: the spread on the seeds 0 to 29.
_PIXELS_ALONE = 0.22
# Candidates: sigma [LR px] and softness [share of the softest].
_STEP = 0.002
# Shares of sharp scenes, and of good pixels, among the sequences of one camera: candidates.
_SHARES = (np.arange(20) + 0.5) / 20
_SIGMAS = np.arange(0.06, 2.0, _STEP)
_SOFTNESS = (np.arange(44) + 0.5) / 44

TYPICAL = PsfEstimate(TYPICAL_SIGMA_LR_PX, TYPICAL_SPREAD_LR_PX, "typical")
"""What is assumed where the frames don't tell it."""


@dataclass(frozen=True)
class Evidence:
    """What something else says of the optics, for instance earlier frames of the same camera.

    Parameters
    ----------
    sigma, error : float
        Standard deviation per axis, and one standard deviation of it, LR px.
    name : str
        As in `PsfEstimate.evidence`.
    """

    sigma: float
    error: float
    name: str


def combined(
    borders: BorderBlur | None,
    pixels: float | None,
    lr_px_per_unit: float,
    further: Sequence[Evidence] = (),
) -> PsfEstimate:
    """Combine all evidence.

    Parameters
    ----------
    borders : BorderBlur or None
    pixels : float or None
        Sigma that predicts held-out pixels best, LR px; None if there is none within the limits.
    lr_px_per_unit : float
    further : sequence of Evidence

    Returns
    -------
    PsfEstimate
        The most likely sigma, and the standard deviation about it; what is typical if nothing is
        known.
    """
    names = ["borders"] * (borders is not None) + ["pixels"] * (pixels is not None)
    names += [e.name for e in further]
    if not names:
        return TYPICAL
    measured = PsfMeasurements(None if borders is None else (borders.sigma, borders.error), pixels)
    if names == ["pixels"] and pixels is not None:
        return PsfEstimate(pixels, _PIXELS_ALONE * pixels, "pixels", measured=measured)
    likely = _by_measurements(measured, lr_px_per_unit)
    for one in further:
        likely += _normal(_SIGMAS - one.sigma, one.error)
    sigma, error = _most_likely(likely)
    shape = "unknown" if borders is None else borders.shape
    return PsfEstimate(sigma, error, " and ".join(names), shape, measured)


def combined_over_sequences(
    told: Sequence[tuple[PsfEstimate, float]],
) -> tuple[float, float]:
    """Return mean and standard deviation of what sigma of one camera may be, LR px.

    Parameters
    ----------
    told : sequence of (PsfEstimate, float)
        Of sequences of the camera, each with its LR px per cell width; at least one.

    Notes
    -----
    The likelihoods are multiplied, each with the softness of its own scene: no border is sharper
    than the optics show it. A mean of the single estimates would take over what each assumes of
    its scene. Which share of the scenes is sharp, and in which share the held-out pixels are good,
    the sequences tell together: borders of the same width in all of them are those of sharp scenes.
    Before, these shares have the means that `combined` takes for granted, and weigh as much as two
    sequences do.

    The mean, not the maximum: held-out pixels that agree by chance make narrow peaks, and who uses
    the two takes them for a normal distribution.
    """
    plain = np.zeros(len(_SIGMAS))
    borders = np.zeros((len(_SHARES), len(_SIGMAS)))
    pixels = np.zeros((len(_SHARES), len(_SIGMAS)))
    for one, lr_px_per_unit in told:
        if one.measured is None:
            plain += _normal(_SIGMAS - one.sigma, one.error)
            continue
        if one.measured.borders is not None:
            borders += [_by_borders(*one.measured.borders, lr_px_per_unit, p) for p in _SHARES]
        if one.measured.pixels is not None:
            pixels += [_by_pixels(one.measured.pixels, p) for p in _SHARES]
    likely = plain
    for each, mean in ((borders, _SHARP_SHARE), (pixels, _PIXELS_GOOD)):
        # The beta distribution's density, but for a constant; scipy.stats alone would take as long
        # to import as the rest of SciPy.
        before = (2.0 * mean - 1.0) * np.log(_SHARES) + (1.0 - 2.0 * mean) * np.log1p(-_SHARES)
        likely = likely + logsumexp(each + before[:, None], axis=0)
    weight = np.exp(likely - likely.max())
    mean = float(weight @ _SIGMAS / weight.sum())
    return mean, float(np.sqrt(weight @ (_SIGMAS - mean) ** 2 / weight.sum()))


def possible(borders: BorderBlur, lr_px_per_unit: float) -> tuple[float, float]:
    """Least and largest sigma [LR px] that the borders of cells allow.

    Notes
    -----
    Borders are at most as sharp as what the optics show of them: a border that is soft itself makes
    the optics look too wide, never too sharp.
    """
    least = float(np.sqrt(max(borders.sigma**2 - (_SOFTEST * lr_px_per_unit) ** 2, 0.0)))
    low, high = SEARCHED_LR_PX
    return max(least - borders.error, low), min(borders.sigma + borders.error, high)


def _by_measurements(measured: PsfMeasurements, lr_px_per_unit: float) -> Array:
    """Log likelihood of every sigma, from one sequence."""
    likely = np.zeros(len(_SIGMAS))
    if measured.borders is not None:
        likely += _by_borders(*measured.borders, lr_px_per_unit)
    if measured.pixels is not None:
        likely += _by_pixels(measured.pixels)
    return likely


def _by_pixels(pixels: float, good_share: float = _PIXELS_GOOD) -> Array:
    """Log likelihood of every sigma, from held-out pixels that may tell nothing."""
    away = np.log(_SIGMAS / pixels)
    good = np.log(good_share) + _normal(away, _PIXELS_ERROR)
    wrong = np.log(1.0 - good_share) + _normal(away, _PIXELS_WRONG)
    return np.asarray(np.logaddexp(good, wrong), np.float64)


def _by_borders(
    width: float, error: float, lr_px_per_unit: float, sharp_share: float = _SHARP_SHARE
) -> Array:
    """Log likelihood of every sigma, the mean over how soft the scene may be."""
    soft = _SOFTEST * _SOFTNESS
    sharp = soft < _SHARP
    prior = (1.0 - sharp_share) / len(soft) + sharp_share * sharp / sharp.sum()
    together = np.hypot(_SIGMAS[:, None], soft * lr_px_per_unit)
    each = _normal(together - width, error)
    return np.asarray(logsumexp(each, axis=1, b=prior), np.float64)


def _most_likely(likely: Array) -> tuple[float, float]:
    """Maximum of a log likelihood (vertex of the parabola), and the standard deviation about it."""
    k = int(np.clip(np.argmax(likely), 1, len(likely) - 2))
    before, here, after = likely[k - 1 : k + 2]
    bend = 2.0 * here - before - after
    sigma = float(_SIGMAS[k] + (0.5 * _STEP * (after - before) / bend if bend > 0 else 0.0))
    weight = np.exp(likely - likely.max())
    return sigma, float(np.sqrt(weight @ (_SIGMAS - sigma) ** 2 / weight.sum()))


def _normal(x: Array, spread: float) -> Array:
    """Logarithm of a normal distribution, but for a constant."""
    return np.asarray(-0.5 * (x / spread) ** 2 - np.log(spread), np.float64)
