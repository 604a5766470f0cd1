"""How near an image is to the truth: PSNR, SSIM, Fourier ring correlation, displacement."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage.metrics import structural_similarity

__all__ = [
    "ImageScore",
    "displacement",
    "fitted",
    "fourier_ring_correlation",
    "image_score",
    "ring_cutoff",
]

Image = NDArray[np.float32]
Floats = NDArray[np.float64]

# Share of the truth's pixels under its peak: single bright ones do not set the scale.
_PEAK_PERCENTILE = 99.9
# Where two images have no more in common than one bit in two: the usual limit of FRC.
_FRC_LIMIT = 1 / 7
# Slow brightness, which vignetting and exposure change, is that wider than this share of a cell.
_SLOW_CELLS = 0.25
# ECC ends after so many steps, or when one gains less.
_ECC_STEPS, _ECC_GAIN = 80, 1e-7


@dataclass(frozen=True)
class ImageScore:
    """Agreement of the cells of an image with the truth.

    Parameters
    ----------
    psnr_db : float
        Peak signal-to-noise ratio over all cells, each with its best gain and offset.
    flat_psnr_db : float
        The same after slow brightness was made that of the truth.
    ssim : float
        Mean structural similarity of the cells.
    frc_cutoff : float
        Where Fourier ring correlation first falls under 1/7, cycles per LR px.
    shift_px : (x, y)
        Median displacement of the cells against the truth, LR px.
    """

    psnr_db: float
    flat_psnr_db: float
    ssim: float
    frc_cutoff: float
    shift_px: tuple[float, float]


def image_score(pairs: Sequence[tuple[Image, Image]], magnification: float) -> ImageScore:
    """Score cells against the truth.

    Parameters
    ----------
    pairs : sequence of (image, truth)
        (h, w) float32 each.
    magnification : float
        HR pixels per LR pixel.

    Returns
    -------
    ImageScore

    Notes
    -----
    PSNR = 10 log10(P^2 / MSE) with P the 99.9 percentile of the truth and the mean over all pixels
    of all cells.
    """
    peak = float(np.percentile(np.concatenate([t.ravel() for _, t in pairs]), _PEAK_PERCENTILE))
    alike = [(fitted(image, truth), truth.astype(np.float64)) for image, truth in pairs]
    flat = [(_flattened(image, truth), truth) for image, truth in alike]
    similarity: Any = structural_similarity
    ssim = [similarity(t, i, data_range=peak) for i, t in alike]
    rings = fourier_ring_correlation(alike, magnification)
    shifts = np.array([displacement(image, truth) for image, truth in pairs])
    x, y = np.nanmedian(shifts, axis=0) if np.isfinite(shifts).any() else (np.nan, np.nan)
    return ImageScore(
        _psnr(alike, peak),
        _psnr(flat, peak),
        float(np.mean(ssim)),
        ring_cutoff(*rings),
        (float(x) / magnification, float(y) / magnification),
    )


def fitted(image: Image, truth: Image) -> Floats:
    """Return the image with the gain and offset that bring it nearest to the truth.

    Parameters
    ----------
    image, truth : (h, w) float32

    Returns
    -------
    (h, w) float64
    """
    ours, true = image.astype(np.float64), truth.astype(np.float64)
    spread = ours - ours.mean()
    power = float((spread**2).sum())
    gain = float((spread * true).sum()) / power if power > 0 else 0.0
    return np.asarray(gain * spread + float(true.mean()))


def _flattened(image: Floats, truth: Floats) -> Floats:
    """Make the slow brightness of an image that of the truth."""
    sigma = _SLOW_CELLS * max(truth.shape)
    slow, true = (
        cv2.GaussianBlur(values, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
        for values in (image, truth)
    )
    return np.asarray(image - slow + true)


def _psnr(pairs: Iterable[tuple[Floats, Floats]], peak: float) -> float:
    total, count = 0.0, 0
    for image, truth in pairs:
        total += float(((image - truth) ** 2).sum())
        count += image.size
    return float(10 * np.log10(peak**2 / max(total / count, 1e-20)))


def fourier_ring_correlation(
    pairs: Iterable[tuple[Floats, Floats]], magnification: float
) -> tuple[Floats, Floats]:
    """Correlate the spectra of two images over rings of one frequency, pooled over all cells.

    Parameters
    ----------
    pairs : iterable of two (h, w) float64
    magnification : float
        HR pixels per LR pixel.

    Returns
    -------
    frequency, correlation : (n,) float64
        Cycles per LR px up to the Nyquist frequency of the grid, and the correlation there.

    Notes
    -----
    FRC(q) = Re sum F G* / sqrt(sum |F|^2 sum |G|^2) over the frequencies of a ring, with a Hann
    window on each cell [1]_.

    References
    ----------
    .. [1] W. O. Saxton, W. Baumeister, J. Microscopy 127, 1982.
           doi:10.1111/j.1365-2818.1982.tb00405.x
    """
    sums: Floats | None = None
    width = 0.0
    for a, b in pairs:
        height, length = a.shape
        ring_px = max(1.0 / height, 1.0 / length)
        if sums is None:
            width = ring_px
            sums = np.zeros((3, int(0.5 / width) + 1))
        window = np.outer(np.hanning(height + 2)[1:-1], np.hanning(length + 2)[1:-1])
        f, g = (np.fft.fft2((values - values.mean()) * window) for values in (a, b))
        radius = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.fftfreq(length)[None])
        ring = (radius / width + 0.5).astype(int).ravel()
        inside = ring < sums.shape[1]
        for k, values in enumerate(((f * g.conj()).real, np.abs(f) ** 2, np.abs(g) ** 2)):
            sums[k] += np.bincount(ring[inside], values.ravel()[inside], sums.shape[1])
    if sums is None:
        return np.zeros(0), np.zeros(0)
    found = sums[0] / np.sqrt(np.maximum(sums[1] * sums[2], 1e-30))
    return np.arange(found.size) * width * magnification, found


def ring_cutoff(frequency: Floats, correlation: Floats) -> float:
    """Return the frequency where the correlation first falls under 1/7, between two rings.

    Parameters
    ----------
    frequency, correlation : (n,) float64
        Of `fourier_ring_correlation`; smoothed by 1/4, 1/2, 1/4.

    Returns
    -------
    float
        The last frequency if it never does.
    """
    smooth = np.convolve(np.pad(correlation, 1, mode="edge"), [0.25, 0.5, 0.25], "valid")
    under = np.flatnonzero((smooth < _FRC_LIMIT) & (np.arange(smooth.size) >= 2))
    if not under.size:
        return float(frequency[-1])
    k = int(under[0])
    above, below = float(smooth[k - 1]), float(smooth[k])
    share = (above - _FRC_LIMIT) / (above - below) if above > _FRC_LIMIT else 0.0
    return float(frequency[k - 1] + share * (frequency[k] - frequency[k - 1]))


def displacement(image: Image, truth: Image) -> tuple[float, float]:
    """Find the shift of an image against the truth by enhanced correlation (ECC).

    Parameters
    ----------
    image, truth : (h, w) float32

    Returns
    -------
    (x, y)
        HR px that the image lies to the right of and below the truth; NaN if it is not found.
    """
    sigma = _SLOW_CELLS * max(truth.shape)
    ours, true = (
        np.asarray(values - cv2.GaussianBlur(values, (0, 0), sigma), np.float32)
        for values in (image.astype(np.float32), truth.astype(np.float32))
    )
    warp: Any = np.eye(2, 3, dtype=np.float32)
    whole = np.full(true.shape, 255, np.uint8)
    ends = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _ECC_STEPS, _ECC_GAIN)
    try:
        _, warp = cv2.findTransformECC(true, ours, warp, cv2.MOTION_TRANSLATION, ends, whole, 5)
    except cv2.error:
        return float("nan"), float("nan")
    return float(warp[0, 2]), float(warp[1, 2])
