"""A frame with current minus one without it, registered, with the noise of both."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.robust import MAD_TO_SIGMA
from pv_inspect.sequence.frame import Frame
from pv_inspect.sequence.frame_motion import Motion, motion_between
from pv_inspect.sequence.noise import NoiseModel

__all__ = ["Pair", "difference", "fitted", "registered"]

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Gaussian that the light is smoothed with before its noise is read off it.
_SMOOTH_PX = 2.0
# A view that moved less is not interpolated [px]: that would do more harm.
_STILL_PX = 0.02
# Share of the frame around the module that the daylight is compared in, at least.
_LEAST_AROUND = 0.02
_HUBER = 1.5
# Spread that is expected of the light between two frames, as a share.
_EXPECTED_GAIN = 0.2
_MOST_SAMPLES = 20_000


@dataclass(frozen=True, eq=False)
class Pair:
    """The daylight in a frame with current: ``gain * dark + offset``.

    Parameters
    ----------
    dark : int
        The frame without current.
    motion : Motion or None
        Where its pixels are; None if the camera stood still.
    gain, offset : float
    """

    dark: int
    motion: Motion | None = None
    gain: float = 1.0
    offset: float = 0.0


def registered(frame: Frame, dark: Frame, index: int) -> Pair:
    """Register a frame without current to one with it.

    Parameters
    ----------
    frame : Frame
        With current.
    dark : Frame
        Without current.
    index : int
        Of the latter.
    """
    motion = motion_between(frame.image, dark.image)
    if motion is not None and motion.largest(dark.image.shape) < _STILL_PX:
        motion = None
    return Pair(index, motion)


def fitted(frame: Frame, pair: Pair, dark: Frame, region: Mask) -> tuple[Pair, float]:
    """Fit the light of the day around the module; return what is left there over the glow inside.

    Notes
    -----
    The black level of frames without any black is not known, so that a change of the light or of
    the camera's gain is a factor and an offset. Huber's weights, for the surroundings move.
    """
    daylight, valid = _aligned(dark, pair)
    valid = valid & frame.valid
    image = cv2.GaussianBlur(frame.image, (0, 0), _SMOOTH_PX)
    smooth = cv2.GaussianBlur(daylight, (0, 0), _SMOOTH_PX)
    near = np.ones((2 * (frame.image.shape[1] // 32) + 1,) * 2, np.uint8)
    around = (cv2.dilate(region.astype(np.uint8), near) == 0) & valid
    inside = region & valid
    if around.mean() >= _LEAST_AROUND:
        y, x = image[around].astype(np.float64), smooth[around].astype(np.float64)
        step = max(1, len(x) // _MOST_SAMPLES)
        gain, offset = _line(x[::step], y[::step])
        pair = replace(pair, gain=gain, offset=offset)
    rest = image - np.float32(pair.gain) * smooth - np.float32(pair.offset)
    glow = float(np.median(rest[inside])) if inside.any() else 0.0
    left = float(np.median(np.abs(rest[around]))) if around.any() else 0.0
    return pair, left / glow if glow > 0 else float("inf")


def _line(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float]:
    """Fit y = gain x + offset with Huber's weights; without contrast in x the gain stays 1."""
    middle = float(x.mean())
    gain, level = 1.0, float(np.median(y - x)) + middle
    for _ in range(10):
        rest = y - level - gain * (x - middle)
        sigma = max(MAD_TO_SIGMA * float(np.median(np.abs(rest))), 1e-9)
        weight = np.minimum(1.0, _HUBER * sigma / np.maximum(np.abs(rest), 1e-12)) / sigma**2
        # Pixels around each other show one thing: a hundredth of them is independent.
        weight *= 0.01
        centre = x - middle
        prior = 1.0 / _EXPECTED_GAIN**2
        normal = np.array(
            [
                [np.sum(weight * centre**2) + prior, np.sum(weight * centre)],
                [np.sum(weight * centre), np.sum(weight)],
            ]
        )
        right = np.array([np.sum(weight * centre * y) + prior, np.sum(weight * y)])
        gain, level = map(float, np.linalg.solve(normal, right))
    return gain, level - gain * middle


def _aligned(dark: Frame, pair: Pair) -> tuple[Image, Mask]:
    """Return the frame without current where the one with current sees it, and what is valid."""
    if pair.motion is None:
        return dark.image, dark.valid
    maps = pair.motion.maps(dark.image.shape)
    image = cv2.remap(dark.image, *maps, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
    wrong = cv2.remap((~dark.valid).astype(np.float32), *maps, cv2.INTER_LINEAR, borderValue=1.0)
    return np.asarray(image, np.float32), wrong < 0.5 / 8


def _aligned_variance(dark: Frame, pair: Pair, noise: NoiseModel) -> Image:
    """Variance of the aligned frame without current."""
    light = cv2.GaussianBlur(dark.image, (0, 0), _SMOOTH_PX)
    if pair.motion is None:
        return np.square(noise.sigma(light))
    maps = pair.motion.maps(dark.image.shape)
    light = cv2.remap(light, *maps, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
    variance = _kept_noise(maps) * np.square(noise.sigma(np.asarray(light, np.float32)))
    return variance.astype(np.float32)


def difference(frame: Frame, pair: Pair, dark: Frame, noise: NoiseModel) -> Frame:
    """Subtract the daylight of a frame with current.

    Parameters
    ----------
    frame : Frame
        With current.
    pair : Pair
    dark : Frame
        That of the pair, as it was exposed.
    noise : NoiseModel
        Of such frames.

    Returns
    -------
    Frame
        Its ``added_variance`` is what the daylight, here and in the subtracted frame, adds to the
        variance.
    """
    daylight, valid = _aligned(dark, pair)
    gain = np.float32(pair.gain)
    image = frame.image - gain * daylight - np.float32(pair.offset)
    # The noise of the frame itself is that of all its light, not of the difference alone.
    light, glow = (cv2.GaussianBlur(p, (0, 0), _SMOOTH_PX) for p in (frame.image, image))
    own = np.square(noise.sigma(light)) - np.square(noise.sigma(glow))
    added = np.maximum(own, 0.0) + gain**2 * _aligned_variance(dark, pair, noise)
    valid = valid & frame.valid
    made = Frame(np.asarray(image, np.float32), valid, np.asarray(added, np.float32))
    for array in (made.image, made.valid, made.added_variance):
        assert array is not None
        array.flags.writeable = False
    return made


def _kept_noise(maps: tuple[Image, Image]) -> NDArray[np.float64]:
    """Share of the variance of white noise that interpolation leaves, at every pixel."""
    fractions = np.arange(33) / 32
    kept = np.array([_kernel_power(float(f)) for f in fractions])
    across, down = (kept[np.rint(32 * (m - np.floor(m))).astype(np.intp)] for m in maps)
    power: NDArray[np.float64] = across * down
    return power


def _kernel_power(fraction: float) -> float:
    x = np.arange(-3, 5) - fraction
    kernel = np.sinc(x) * np.sinc(x / 4) * (np.abs(x) < 4)
    return float(np.sum(np.square(kernel / kernel.sum())))
