"""A frame with current minus the frames without it, registered, with the noise of all of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.robust import MAD_TO_SIGMA
from pv_inspect.sequence.frame import Frame
from pv_inspect.sequence.frame_motion import Motion, motion_between
from pv_inspect.sequence.noise import NoiseModel

__all__ = ["Daylight", "Pair", "difference", "fitted", "registered"]

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
class Daylight:
    """A frame without current as a part of the daylight in a frame with current.

    Parameters
    ----------
    frame : int
    share : float
        Weight of the frame.
    motion : Motion or None
        Where its pixels are; None if the camera stood still.
    """

    frame: int
    share: float
    motion: Motion | None = None


@dataclass(frozen=True, eq=False)
class Pair:
    """The daylight in a frame with current: ``gain * sum(share * frame) + offset``."""

    daylight: tuple[Daylight, ...]
    gain: float = 1.0
    offset: float = 0.0


def registered(
    frame: Frame, daylight: tuple[Daylight, ...], exposed: Callable[[int], Frame]
) -> Pair:
    """Register the frames without current to one with it.

    Parameters
    ----------
    frame : Frame
        With current.
    daylight : tuple of Daylight
        Without current, not registered yet.
    exposed : callable
        Returns a frame as it was exposed.
    """
    parts = []
    for part in daylight:
        motion = motion_between(frame.image, exposed(part.frame).image)
        if motion is not None and motion.largest(_shape(frame)) < _STILL_PX:
            motion = None
        parts.append(replace(part, motion=motion))
    return Pair(tuple(parts))


def _shape(frame: Frame) -> tuple[int, int]:
    height, width = frame.image.shape
    return height, width


def fitted(
    frame: Frame, pair: Pair, region: Mask, exposed: Callable[[int], Frame], noise: NoiseModel
) -> tuple[Pair, float]:
    """Fit the light of the day around the module; return what is left there over the glow inside.

    Notes
    -----
    The black level of frames without any black is not known, so that a change of the light or of
    the camera's gain is a factor and an offset. Huber's weights, for the surroundings move.
    """
    daylight, valid, _ = _sum_of(frame, pair, exposed, noise)
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


def _sum_of(
    frame: Frame, pair: Pair, exposed: Callable[[int], Frame], noise: NoiseModel
) -> tuple[Image, Mask, Image]:
    """Return sum, valid pixels and variance of the weighted frames without current."""
    shape = _shape(frame)
    total, valid, variance = np.zeros(shape, np.float32), frame.valid.copy(), np.zeros(shape)
    for part in pair.daylight:
        dark = exposed(part.frame)
        light = cv2.GaussianBlur(dark.image, (0, 0), _SMOOTH_PX)
        image, seen, kept = dark.image, dark.valid, np.ones(1)
        if part.motion is not None:
            maps = part.motion.maps(shape)
            image, light = (
                np.asarray(
                    cv2.remap(p, *maps, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE),
                    np.float32,
                )
                for p in (dark.image, light)
            )
            wrong = cv2.remap(
                (~dark.valid).astype(np.float32), *maps, cv2.INTER_LINEAR, borderValue=1.0
            )
            seen = wrong < 0.5 / 8
            kept = _kept_noise(maps)
        valid &= seen
        total += np.float32(part.share) * image
        variance += kept * part.share**2 * np.square(noise.sigma(light))
    return total, valid, variance.astype(np.float32)


def difference(
    frame: Frame, pair: Pair, exposed: Callable[[int], Frame], noise: NoiseModel
) -> Frame:
    """Subtract the daylight of a frame with current.

    Parameters
    ----------
    frame : Frame
        With current.
    pair : Pair
    exposed : callable
        Returns a frame as it was exposed.
    noise : NoiseModel
        Of such frames.

    Returns
    -------
    Frame
        Its ``added_variance`` is what the daylight, here and in the subtracted frames, adds to the
        variance.
    """
    daylight, valid, variance = _sum_of(frame, pair, exposed, noise)
    gain = np.float32(pair.gain)
    image = frame.image - gain * daylight - np.float32(pair.offset)
    # The noise of the frame itself is that of all its light, not of the difference alone.
    light, glow = (cv2.GaussianBlur(p, (0, 0), _SMOOTH_PX) for p in (frame.image, image))
    own = np.square(noise.sigma(light)) - np.square(noise.sigma(glow))
    added = np.maximum(own, 0.0) + gain**2 * variance
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
