"""The pattern that a sensor lays over every frame: columns and single pixels.

Everything is estimated twice, from halves of the data in which the module image is wrong at
different places. What the halves have in common is the pattern, what they differ by the
uncertainty, and the ratio of the two decides how much of an estimate is taken: without a pattern
nothing is corrected.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, uniform_filter

from pv_inspect.common.robust import MAD_TO_SIGMA, MEDIAN_CHI2
from pv_inspect.photometry.residual_sums import COUNT, LIGHT, LIGHT2, MISFIT, PRODUCT, ResidualSums

__all__ = [
    "ColumnPattern",
    "Estimate",
    "column_lines",
    "columns_of_frames",
    "columns_of_halves",
    "fixed_columns",
    "mean_light",
    "pixel_gains",
    "shrink",
    "without_slow_columns",
]

Array = NDArray[np.float64]

# A pattern differs from column to column and from pixel to pixel. What is slower is the
# vignetting's, or the scene's.
_COLUMNS_AROUND = 12.0
_PIXELS_AROUND = 15
# Standard errors by which the halves must agree.
_SIGNIFICANCE = 4.0
# Share of the typical precision from which on an element helps to tell how strong the pattern is.
_TYPICAL = 0.2
# Robust standard deviations at which an element counts for no more when the strength is told.
_OUTLIER = 8.0
_LEAST_ELEMENTS = 30


@dataclass(frozen=True, eq=False)
class Estimate:
    """Values with the inverse variance that the noise gives them; 0 where nothing is known."""

    value: Array
    precision: Array


@dataclass(frozen=True, eq=False)
class ColumnPattern:
    """What the columns add to a prediction p: ``level + gain (p - light)``; all (width,) float64.

    Parameters
    ----------
    light : array
        Mean prediction that level and gain were found at, where they hardly depend on each other.
    level, gain : array
        Level: full scale = 1.
    level_error, gain_error : array
        Standard deviations.
    """

    light: Array
    level: Array
    level_error: Array
    gain: Array
    gain_error: Array

    @property
    def offset(self) -> Array:
        """What is added without light."""
        return self.level - self.gain * self.light

    def variance_at(self, light: Array) -> Array:
        """Variance of what is added at another prediction."""
        return np.asarray(self.level_error**2 + ((light - self.light) * self.gain_error) ** 2)


def shrink(first: Estimate, second: Estimate, variance: Array | float = 0.0) -> Array:
    """Combine two estimates of a pattern of mean zero, so that noise is not added to the frames.

    Parameters
    ----------
    first, second : Estimate of the same shape
        From independent data.
    variance : array of that shape, or float
        That the pattern has in any case.

    Returns
    -------
    float64 array of that shape
        All zero if the two do not agree, and there is no such variance.

    Notes
    -----
    With the precision-weighted mean m of both, of precision q, the result is
    ``m S / (S + c / q)``: the posterior mean for a pattern of variance S. S is the mean product of
    the halves, if it is significant, and the variance that is given; c >= 1 is the variance that
    they differ by over the one that q claims.
    """
    return _posterior(first, second, variance)[0]


def _posterior(
    first: Estimate, second: Estimate, variance: Array | float = 0.0
) -> tuple[Array, Array]:
    """Mean and variance of the pattern, see `shrink`."""
    given = np.broadcast_to(np.asarray(variance, np.float64), first.value.shape)
    total = first.precision + second.precision
    mean = first.value * first.precision + second.value * second.precision
    mean = np.divide(mean, total, out=np.zeros_like(mean), where=total > 0)
    lesser = np.minimum(first.precision, second.precision)
    known = lesser > 0
    if known.sum() < _LEAST_ELEMENTS:
        return np.zeros_like(mean), given.copy()
    known &= lesser > _TYPICAL * np.median(lesser[known])
    if known.sum() < _LEAST_ELEMENTS:
        return np.zeros_like(mean), given.copy()
    limit = _OUTLIER * MAD_TO_SIGMA * float(np.median(np.abs(mean[known])))
    a, b = (np.clip(e.value[known], -limit, limit) for e in (first, second))
    strength = float((a * b).mean())
    if not strength > _SIGNIFICANCE * float((a * b).std()) / np.sqrt(known.sum()):
        strength = 0.0
    claimed = 1.0 / first.precision[known] + 1.0 / second.precision[known]
    difference = (first.value - second.value)[known]
    excess = max(float(np.median(difference**2 / claimed)) / MEDIAN_CHI2, 1.0)
    prior = strength + given
    share = prior * total / (prior * total + excess)
    return mean * share, prior * (1.0 - share)


def fixed_columns(
    sums: ResidualSums, second: NDArray[np.bool_], known: ColumnPattern | None = None
) -> tuple[Array, Array]:
    """Estimate offset and gain of every column, the same in all frames.

    Parameters
    ----------
    sums : ResidualSums
    second : (n_frames,) bool
        Frames of the second half, see `residual_sums.halves_along`.
    known : ColumnPattern, optional
        What was taken out of the frames before; its uncertainty is a prior.

    Returns
    -------
    offset, gain : (width,) float64
        The column adds ``offset + gain * p`` to a prediction p.

    """
    found = columns_of_halves(sums.of_columns(second), known)
    return found.offset, found.gain


def columns_of_halves(sums: Array, known: ColumnPattern | None = None) -> ColumnPattern:
    """Estimate offset and gain of every column from two halves of the data.

    Parameters
    ----------
    sums : (2, 5, width) float64
        `residual_sums`' COUNT to PRODUCT of each half.
    known : ColumnPattern, optional
        What was taken out of the frames before; its uncertainty is a prior.

    Notes
    -----
    Both halves are fitted by ``c + gain (p - p0)`` with the mean prediction p0 of the column: c and
    gain are nearly uncorrelated then and shrunk one by one.
    """
    p0 = mean_light(sums.sum(axis=0))
    first, second = (column_lines(half, p0) for half in sums)
    priors = (0.0, 0.0) if known is None else (known.variance_at(p0), known.gain_error**2)
    level, level_variance = _posterior(first[0], second[0], priors[0])
    gain, gain_variance = _posterior(first[1], second[1], priors[1])
    return ColumnPattern(p0, level, np.sqrt(level_variance), gain, np.sqrt(gain_variance))


def mean_light(sums: Array) -> Array:
    """Return the mean prediction of every column, (width,), from (5, width) sums."""
    none = np.zeros(sums.shape[1])
    return np.asarray(np.divide(sums[LIGHT], sums[COUNT], out=none, where=sums[COUNT] > 0))


def column_lines(sums: Array, p0: Array) -> tuple[Estimate, Estimate]:
    """Fit r = c + gain (p - p0) per column to the (5, width) sums; returns c and gain.

    What is slower than a pattern is taken out of both.
    """
    w, wp, wpp, wr, wpr = sums
    spread = wpp - 2.0 * p0 * wp + p0**2 * w
    mixed = wp - p0 * w
    product = wpr - p0 * wr
    determinant = w * spread - mixed**2
    known = (w > 0) & (determinant > 1e-6 * w * wpp)
    safe = np.where(known, determinant, 1.0)
    level = np.where(known, (spread * wr - mixed * product) / safe, 0.0)
    gain = np.where(known, (w * product - mixed * wr) / safe, 0.0)
    level_precision = np.where(known, safe / np.where(known, spread, 1.0), 0.0)
    gain_precision = np.where(known, safe / np.where(known, w, 1.0), 0.0)
    return (
        _without_slow_columns(Estimate(level, level_precision)),
        _without_slow_columns(Estimate(gain, gain_precision)),
    )


def columns_of_frames(sums: ResidualSums) -> Array:
    """Estimate the offsets of the columns in every single frame.

    Parameters
    ----------
    sums : ResidualSums
        After the fixed columns have been taken out.

    Returns
    -------
    (n_frames, width) float64

    Notes
    -----
    The halves are alternating bands of rows. A frame that is blurred or placed otherwise than the
    model thinks leaves residuals in all rows as well, but they look like the first and second
    derivative of what it shows: those are projected out of the columns' profile.
    """
    halves: list[list[Estimate]] = [[], []]
    for bands in sums.bands:
        frame = bands.astype(np.float64)
        whole = frame.sum(axis=1)
        known = whole[COUNT] > 0
        p0 = np.divide(whole[LIGHT], whole[COUNT], out=np.zeros_like(whole[0]), where=known)
        slope = np.gradient(p0)
        for k in range(2):
            half = frame[:, k::2].sum(axis=1)
            raw = np.divide(half[MISFIT], half[COUNT], out=np.zeros_like(p0), where=half[COUNT] > 0)
            offset = _without_slow_columns(Estimate(raw, half[COUNT]))
            shapes = [
                _without_slow_columns(Estimate(shape, half[COUNT])).value
                for shape in (p0, slope, np.gradient(slope))
            ]
            halves[k].append(Estimate(_residual(offset, shapes), offset.precision))
    return shrink(_stacked(halves[0]), _stacked(halves[1]))


def _residual(estimate: Estimate, shapes: list[Array]) -> Array:
    """Return an estimate less its weighted least squares fit by some shapes."""
    root = np.sqrt(estimate.precision)
    design = np.column_stack(shapes)
    fit = np.linalg.lstsq(design * root[:, None], estimate.value * root, rcond=None)[0]
    left: Array = estimate.value - design @ fit
    return left


def _stacked(estimates: list[Estimate]) -> Estimate:
    return Estimate(
        np.array([e.value for e in estimates]), np.array([e.precision for e in estimates])
    )


def pixel_gains(sums: ResidualSums) -> Array:
    """Estimate the gain of every pixel against those around (photo response non-uniformity).

    Parameters
    ----------
    sums : ResidualSums
        After the fixed columns have been taken out.

    Returns
    -------
    (height, width) float64
        Without the mean over a column, which is `fixed_columns`' own.
    """
    halves = []
    for half in sums.pixels:
        light2, product = half[LIGHT2].astype(np.float64), half[PRODUCT].astype(np.float64)
        known = light2 > 0
        if not known.any():
            return np.zeros(light2.shape)
        known &= light2 > 0.02 * np.median(light2[known])
        light2 = np.where(known, light2, 0.0)
        gain = np.divide(product, light2, out=np.zeros_like(product), where=known)
        gain -= _ratio(
            uniform_filter(gain * light2, _PIXELS_AROUND, mode="constant"),
            uniform_filter(light2, _PIXELS_AROUND, mode="constant"),
        )
        gain -= _ratio((gain * light2).sum(axis=0), light2.sum(axis=0))
        halves.append(Estimate(np.where(known, gain, 0.0), light2))
    return shrink(halves[0], halves[1])


def without_slow_columns(values: Array) -> Array:
    """Subtract the mean of the columns around from (width,) values."""
    return _without_slow_columns(Estimate(values, np.ones(len(values)))).value


def _without_slow_columns(estimate: Estimate) -> Estimate:
    """Subtract the weighted mean of the columns around."""
    value, precision = estimate.value, estimate.precision
    near = _ratio(
        gaussian_filter1d(value * precision, _COLUMNS_AROUND, mode="constant"),
        gaussian_filter1d(precision, _COLUMNS_AROUND, mode="constant"),
    )
    return Estimate(np.where(precision > 0, value - near, 0.0), precision)


def _ratio(a: Array, b: Array) -> Array:
    return np.divide(a, b, out=np.zeros_like(a), where=b > 1e-12 * max(float(b.max()), 1e-300))
