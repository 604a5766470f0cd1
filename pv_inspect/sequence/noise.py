"""The noise of the camera as a function of intensity: the photon transfer line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["NoiseModel", "estimate_noise"]

Mask = NDArray[np.bool_]
Image = NDArray[np.float32]

_BLOCK_PX = 8
_NOISE_BINS = 24
_LEAST_BLOCKS = 30
# 5 % quantile of a block's mean square over the true variance, white Gaussian noise.
_QUIET_BLOCK_SHARE = 0.555
# Quantisation to 14 bits; keeps sigma above zero on synthetic images without noise.
_LEAST_VARIANCE = (2.0**-14) ** 2 / 12.0
# Gaussian that the light is smoothed with before the noise is read off it.
_SMOOTH_LR_PX = 2.0
# Read variance over that of the shot noise at the middle level, at least. Where hardly a pixel is
# dark the line's value at black is a guess; near 0 it would give the dark ones all the weight.
# A camera with 3 electrons of read noise has 0.009 at 1000; D1 to E2 have 0.08 to 2.
_LEAST_READ_SHARE = 0.01
# Weight of a bin above the line against one below it.
_ABOVE_THE_LINE = 0.02


@dataclass(frozen=True)
class NoiseModel:
    """Photon transfer line: variance = ``read_variance`` + ``shot_gain`` * intensity.

    Parameters
    ----------
    read_variance : float
        Variance without light, full scale squared.
    shot_gain : float
        Growth of the variance with intensity, full scale (1 / full well, in electrons).
    grain_px : int
        Side of the squares within which errors are not independent: 1 for a camera, 8 after the
        compression of JPEG and video.
    """

    read_variance: float
    shot_gain: float
    grain_px: int = 1

    def sigma(self, image: NDArray[Any], added: NDArray[Any] | None = None) -> Image:
        """Return the standard deviation of the noise at every intensity of ``image``.

        Parameters
        ----------
        image : array of any shape, full scale = 1
        added : array of the same shape, optional
            Variance beyond that of the image, ``Frame.added_variance``.

        Returns
        -------
        float32 array of the same shape, full scale = 1
        """
        variance = self.read_variance + self.shot_gain * np.maximum(image, 0.0)
        if added is not None:
            variance = variance + added
        sigma: Image = np.sqrt(variance).astype(np.float32)
        return sigma

    def precision(self, image: Image, valid: Mask, added: Image | None = None) -> Image:
        """Return 1 / variance of the pixels of a frame for its registration.

        Parameters
        ----------
        image : (height, width) float32
            Full scale = 1. The variance follows the light, not a pixel's own noise: it is read off
            the smoothed image.
        valid : (height, width) bool
        added : (height, width) float32, optional
            Variance beyond that of the image, ``Frame.added_variance``.

        Returns
        -------
        (height, width) float32
            0 where a pixel is not valid.

        Notes
        -----
        Not the weights of the reconstruction, which `pv_inspect.photometry.photometry.observed`
        makes: those are of the light of the module, which the sensor has changed, and smooth over
        1 px that end after 4, so that a part of a frame has the weights of the whole. All results
        so far rest on the one or the other.
        """
        sigma = self.sigma(cv2.GaussianBlur(image, (0, 0), _SMOOTH_LR_PX), added)
        return np.where(valid, 1.0 / np.square(sigma), 0.0).astype(np.float32)


def estimate_noise(frames: list[Image], valid: list[Mask]) -> NoiseModel:
    """Estimate the photon transfer line from the frames.

    Parameters
    ----------
    frames : list of (height, width) float32, full scale = 1
    valid : list of (height, width) bool

    Returns
    -------
    NoiseModel

    Notes
    -----
    The product of two second differences, [1 -2 1] along x and y, answers neither to slopes nor
    to columns or rows; under white noise its variance is 36 sigma^2 (Immerkaer 1996,
    doi:10.1006/cviu.1996.0060). Texture only adds to it: at every intensity the quietest blocks
    of 8 x 8 pixels tell the noise, and the line runs along the lower edge of what they tell.
    """
    levels, variances = zip(
        *(_block_statistics(image, mask) for image, mask in zip(frames, valid, strict=True)),
        strict=True,
    )
    level, variance = np.concatenate(levels), np.concatenate(variances)
    if level.size < _LEAST_BLOCKS:  # nearly everything is saturated: say what quantisation does
        return NoiseModel(_LEAST_VARIANCE, 0.0)
    low, high = np.percentile(level, [0.5, 99.5])
    edges = np.linspace(low, high, _NOISE_BINS + 1)
    x, y, count = np.zeros((3, _NOISE_BINS))
    for k in range(_NOISE_BINS):
        inside = (level >= edges[k]) & (level <= edges[k + 1])
        count[k] = inside.sum()
        if count[k] >= _LEAST_BLOCKS:
            x[k] = level[inside].mean()
            y[k] = np.percentile(variance[inside], 5.0) / _QUIET_BLOCK_SHARE
    filled = count >= _LEAST_BLOCKS
    if filled.sum() < 2:
        return NoiseModel(max(float(np.median(variance)), _LEAST_VARIANCE), 0.0)
    return _lower_line(x[filled], y[filled], count[filled])


def _block_statistics(image: Image, valid: Mask) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return mean and noise variance of every block without an invalid pixel."""
    kernel = np.outer([1.0, -2.0, 1.0], [1.0, -2.0, 1.0])
    square = cv2.filter2D(image, cv2.CV_32F, kernel) ** 2 / 36.0
    clean = cv2.erode(valid.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0)
    height, width = (n // _BLOCK_PX * _BLOCK_PX for n in image.shape)

    def blocks(pixels: NDArray[Any]) -> NDArray[np.float64]:
        cut = pixels[:height, :width].astype(np.float64)
        tiles = cut.reshape(height // _BLOCK_PX, _BLOCK_PX, width // _BLOCK_PX, _BLOCK_PX)
        mean: NDArray[np.float64] = tiles.mean(axis=(1, 3)).ravel()
        return mean

    whole = blocks(clean) == 1.0
    return blocks(image)[whole], blocks(square)[whole]


def _lower_line(
    level: NDArray[np.float64], variance: NDArray[np.float64], count: NDArray[np.float64]
) -> NoiseModel:
    """Fit variance = read + gain * level by asymmetric least squares of the relative residuals."""
    scale = np.sqrt(count) / np.maximum(variance, _LEAST_VARIANCE)
    design = np.column_stack([np.ones_like(level), level])
    below = np.ones(level.shape, bool)
    for _ in range(30):
        weight = scale * np.sqrt(np.where(below, 1.0, _ABOVE_THE_LINE))
        read, gain = np.linalg.lstsq(design * weight[:, None], variance * weight, rcond=None)[0]
        previous, below = below, variance <= read + gain * level
        if np.array_equal(previous, below):
            break
    if gain < 0.0:
        return NoiseModel(max(float(np.median(variance)), _LEAST_VARIANCE), 0.0)
    least = max(_LEAST_VARIANCE, _LEAST_READ_SHARE * float(gain) * float(np.median(level)))
    return NoiseModel(max(float(read), least), float(gain))
