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

__all__ = ["Estimate", "columns_of_frames", "fixed_columns", "pixel_gains", "shrink"]

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


def shrink(first: Estimate, second: Estimate) -> Array:
    """Combine two estimates of a pattern of mean zero, so that noise is not added to the frames.

    Parameters
    ----------
    first, second : Estimate of the same shape
        From independent data.

    Returns
    -------
    float64 array of that shape
        All zero if the two do not agree.

    Notes
    -----
    With the precision-weighted mean m of both, of precision q, the result is
    ``m S / (S + c / q)``: the posterior mean for a pattern of variance S. S is the mean product of
    the halves; c >= 1 is the variance that they differ by over the one that q claims.
    """
    total = first.precision + second.precision
    mean = first.value * first.precision + second.value * second.precision
    mean = np.divide(mean, total, out=np.zeros_like(mean), where=total > 0)
    lesser = np.minimum(first.precision, second.precision)
    known = lesser > 0
    if known.sum() < _LEAST_ELEMENTS:
        return np.zeros_like(mean)
    known &= lesser > _TYPICAL * np.median(lesser[known])
    if known.sum() < _LEAST_ELEMENTS:
        return np.zeros_like(mean)
    limit = _OUTLIER * MAD_TO_SIGMA * float(np.median(np.abs(mean[known])))
    a, b = (np.clip(e.value[known], -limit, limit) for e in (first, second))
    strength = float((a * b).mean())
    if not strength > _SIGNIFICANCE * float((a * b).std()) / np.sqrt(known.sum()):
        return np.zeros_like(mean)
    claimed = 1.0 / first.precision[known] + 1.0 / second.precision[known]
    difference = (first.value - second.value)[known]
    excess = max(float(np.median(difference**2 / claimed)) / MEDIAN_CHI2, 1.0)
    shrunk: Array = mean * strength * total / (strength * total + excess)
    return shrunk


def fixed_columns(sums: ResidualSums, second: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Estimate offset and gain of every column, the same in all frames.

    Parameters
    ----------
    sums : ResidualSums
    second : (n_frames,) bool
        Frames of the second half, see `residuals.halves_along`.

    Returns
    -------
    offset, gain : (width,) float64
        The column adds ``offset + gain * p`` to a prediction p.

    Notes
    -----
    Both halves are fitted by ``c + gain (p - p0)`` with the mean prediction p0 of the column: c and
    gain are nearly uncorrelated then and shrunk one by one.
    """
    columns = sums.bands.sum(axis=2, dtype=np.float64)
    whole = columns.sum(axis=0)
    p0 = np.divide(whole[LIGHT], whole[COUNT], out=np.zeros(whole.shape[1]), where=whole[COUNT] > 0)
    halves = [_line(columns[half].sum(axis=0), p0) for half in (~second, second)]
    level = shrink(*(_without_slow_columns(h[0]) for h in halves))
    gain = shrink(*(_without_slow_columns(h[1]) for h in halves))
    return level - gain * p0, gain


def _line(sums: Array, p0: Array) -> tuple[Estimate, Estimate]:
    """Fit r = c + gain (p - p0) per column to the (5, width) sums; returns c and gain."""
    w, wp, wpp, wr, wpr = sums
    spread = wpp - 2.0 * p0 * wp + p0**2 * w
    mixed = wp - p0 * w
    product = wpr - p0 * wr
    determinant = w * spread - mixed**2
    known = (w > 0) & (determinant > 1e-6 * w * wpp)
    safe = np.where(known, determinant, 1.0)
    level = np.where(known, (spread * wr - mixed * product) / safe, 0.0)
    gain = np.where(known, (w * product - mixed * wr) / safe, 0.0)
    return (
        Estimate(level, np.where(known, safe / np.where(known, spread, 1.0), 0.0)),
        Estimate(gain, np.where(known, safe / np.where(known, w, 1.0), 0.0)),
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
    return shrink(*(_stacked(h) for h in halves))


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
    return shrink(*halves)


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
