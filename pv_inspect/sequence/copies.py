"""Frames that repeat another frame: bit for bit, or with its noise after some other processing.

Two exposures never have the same noise. A frame that agrees with another one better than noise
allows is no second measurement: video pipelines repeat frames, folders hold a frame twice, once
compressed. Such copies would pass for evidence, so they count once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from hashlib import blake2b

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.sequence.noise import NoiseModel, estimate_noise

__all__ = ["FrameContents", "Likeness", "copies_sentence", "copy_reasons", "likeness"]

Pixels = NDArray[np.unsignedinteger | np.float32]
Image = NDArray[np.float32]

_BLOCK_PX = 8
_THUMBNAIL = (48, 64)
# Median difference of the thumbnails of two frames, as a share of their contrast, up to which the
# frames themselves are compared: JPEG of quality 80 changes 0.002 of it, simulated frames that
# moved by 2 px 0.06.
_ALIKE = 0.02
# So many of the most similar earlier frames are compared with a frame.
_NEAREST = 3
# All of a usual sequence; at most 4 MiB each.
_WINDOWS_KEPT = 24
# Larger frames are compared in a window of this side around what is bright.
_WINDOW_PX = 1024
# The three marks of a copy; numbers are of simulated pairs of frames (8 and 12 bit, usual and low
# noise, fixed patterns, sharpened, denoised, compressed), chosen on 144 pairs of exposures and 576
# of copies. Of as many others no exposure was taken for a copy; of 96 copies as JPEG of quality 90
# or 95 16 were missed, all in frames with little noise or light.
# Variance of the difference over what two noises make of it: still exposures have 0.4 to 1, with
# very low noise, for which texture passes, down to 0.05. Less than the first is no exposure at
# all; less than the second is a copy if the share of the difference says so too.
_SAME, _COMMON_NOISE = 0.03, 0.25
# Share of the difference that is in either frame: independent exposures have 0.45 to 0.53.
_EVEN, _EVEN_SLACK = 0.5, 0.08
# Variance of means of 4 x 4 pixels of the difference over that of white noise. Compression changes
# fine detail only: JPEG of quality 90 and more has 0.1 to 0.37; exposures 1, sharpened ones 0.42.
# It need not be smaller than the noise for that.
_FINE_ONLY, _COMPRESSION = 0.38, 2.0
# In a part of the blocks a ratio four times too large is no copy's.
_EXCLUDED = 4.0 * _COMPRESSION
# A copy does not move [LR px]; the precision on single frames is about 0.005.
_STILL_PX = 0.03
# Share of the most different blocks that does not count: a clock in the picture, a passing bird.
_DIFFERENT = 0.05
_LEAST_BLOCKS = 30
# Blocks that show the module: this share of the way from dark to bright.
_BRIGHT = 0.3
# Variance of rounding, DN^2.
_ROUNDING = 1.0 / 12.0
# Predicts a pixel from its neighbours without its own noise; exact on planes and saddles.
_NEIGHBOURS = np.array([[-1.0, 2.0, -1.0], [2.0, 0.0, 2.0], [-1.0, 2.0, -1.0]]) / 4.0
# The noise model counts in full scale and keeps sigma above what 14 bits make of that.
_SCALE = 2.0**16


@dataclass
class FrameContents:
    """What is kept of frames while they are read one by one, to find those that repeat others."""

    _digests: list[bytes] = field(default_factory=list)
    _thumbnails: list[Image] = field(default_factory=list)

    def add(self, pixels: Pixels) -> None:
        """Take note of the next frame, (height, width) uint8, uint16 or float32."""
        about = f"{pixels.shape} {pixels.dtype}".encode()
        self._digests.append(blake2b(np.ascontiguousarray(pixels).data, person=about[:16]).digest())
        small = cv2.resize(pixels, _THUMBNAIL[::-1], interpolation=cv2.INTER_AREA)
        self._thumbnails.append(_standardised(np.asarray(small, np.float32)))

    def copies(self, read: Callable[[int], Pixels]) -> dict[int, int]:
        """Find the frames that repeat an earlier one.

        Parameters
        ----------
        read : callable
            Returns the pixels of a frame; called for frames that look alike only.

        Returns
        -------
        dict of int to int
            Frame to the first frame with the same content, which is no copy itself.
        """
        originals: dict[bytes, int] = {}
        found: dict[int, int] = {}
        distinct: list[int] = []
        pictures = np.array(self._thumbnails)
        window = lru_cache(maxsize=_WINDOWS_KEPT)(lambda k: _Window.of(read(k)))
        for index, digest in enumerate(self._digests):
            first = originals.setdefault(digest, index)
            if first != index:
                found[index] = found.get(first, first)
                continue
            away = np.median(np.abs(pictures[distinct] - pictures[index]), axis=1)
            for k in np.argsort(away, kind="stable")[:_NEAREST].tolist():
                if away[k] < _ALIKE and _same(window(distinct[k]), window(index)):
                    found[index] = distinct[k]
                    break
            else:
                distinct.append(index)
        return found


def copy_reasons(copies: Mapping[int, int], names: tuple[str, ...]) -> dict[int, str]:
    """Say of every copy why it is not used; frames as keys."""
    return {k: f"it is a copy of {names[first]}: counted once" for k, first in copies.items()}


def copies_sentence(copies: Mapping[int, int], names: tuple[str, ...]) -> str:
    """Say in one sentence which frames are copies; "" if none is."""
    if not copies:
        return ""
    first, n = min(copies), len(copies)
    example = f"{names[first]} is a copy of {names[copies[first]]}"
    if n == 1:
        return f"{example} and is counted once: the result is that of {len(names) - 1} frames."
    left = len(names) - n
    return (
        f"{n} of {len(names)} frames are copies of others and are counted once ({example}): the "
        f"result is that of {left} frame{'s' if left > 1 else ''}."
    )


@dataclass(frozen=True)
class Likeness:
    """How much two frames have in common.

    Parameters
    ----------
    ratio : float
        Variance of their difference over twice the variance of the noise within them, the least
        of that of pixels and of means of 2 x 2 and 4 x 4: at most about 1 for exposures of a still
        scene, more if it moved. Infinite if too little is bright and not saturated.
    moved_px : float
        How far the second frame is shifted, LR px.
    share : float
        Share of the difference that is in the first frame: 1/2 for independent exposures, 0 if the
        second frame is the first and something else, 1 the other way round.
    share_error : float
        Standard error of that.
    whiteness : float
        Variance of means of 4 x 4 pixels of the difference over that of white noise.
    """

    ratio: float
    moved_px: float = 0.0
    share: float = 0.0
    share_error: float = 0.0
    whiteness: float = 1.0

    @property
    def same(self) -> bool:
        """Whether the frames are one exposure."""
        if self.moved_px >= _STILL_PX:
            return False
        slack = max(_EVEN_SLACK, 4.0 * self.share_error)
        return (
            self.ratio < _SAME
            or (self.ratio < _COMMON_NOISE and abs(self.share - _EVEN) > slack)
            or (self.ratio < _COMPRESSION and self.whiteness < _FINE_ONLY)
        )


def likeness(first: Pixels, second: Pixels) -> Likeness:
    """Compare two frames.

    Parameters
    ----------
    first, second : (height, width) uint8, uint16 or float32, DN
        Frames of the same size and type.

    Returns
    -------
    Likeness

    Notes
    -----
    Exposures B = S + b and A = S + a with independent noise differ by D = b - a, of variance
    n_A + n_B, n the variances within the frames (second differences, see `estimate_noise`); the
    larger of both stands for either, for compression takes noise out of a copy. And - D . a is half
    of D . D; a is what A has beyond its neighbourhood. A copy B = A + e with an error e that is
    independent of A has - D . a = 0. Gain and offset between the frames are fitted first.
    """
    return _likeness(_Window.of(first), _Window.of(second))


@dataclass(frozen=True)
class _Window:
    """The part of a frame that is compared, DN, with the noise within it."""

    image: Image
    noise: NoiseModel

    @classmethod
    def of(cls, frame: Pixels) -> _Window:
        height, width = frame.shape
        step = max(1, min(height, width) // 64)
        weight = frame[::step, ::step].astype(np.float64)
        weight -= weight.min()
        total = max(float(weight.sum()), 1e-9)
        rows, cols = (n // 2 for n in (min(height, _WINDOW_PX), min(width, _WINDOW_PX)))
        y = int(step * (weight.sum(axis=1) @ np.arange(weight.shape[0])) / total)
        x = int(step * (weight.sum(axis=0) @ np.arange(weight.shape[1])) / total)
        top = int(np.clip(y - rows, 0, height - 2 * rows)) // _BLOCK_PX * _BLOCK_PX
        left = int(np.clip(x - cols, 0, width - 2 * cols)) // _BLOCK_PX * _BLOCK_PX
        cut = frame[top : top + 2 * rows, left : left + 2 * cols]
        image = cut[: len(cut) // 8 * 8, : cut.shape[1] // 8 * 8].astype(np.float32)
        return cls(image, estimate_noise([image / np.float32(_SCALE)], [image < image.max()]))

    def thinned(self) -> _Window:
        """Return every eighth row of blocks, with the same noise."""
        rows = self.image.reshape(-1, _BLOCK_PX, self.image.shape[1])[::8]
        return _Window(rows.reshape(-1, self.image.shape[1]), self.noise)

    def variance(self, level: Image) -> float:
        """Mean variance of the noise at the given intensities, DN^2."""
        return float(np.mean(np.square(self.noise.sigma(level / np.float32(_SCALE))))) * _SCALE**2


def _same(first: _Window, second: _Window) -> bool:
    """Whether the frames are one exposure; a part of them excludes it for most that moved."""
    ratio = _likeness(first.thinned(), second.thinned()).ratio
    if _EXCLUDED < ratio < np.inf:
        return False
    return _likeness(first, second).same


def _likeness(first: _Window, second: _Window) -> Likeness:
    a, b = first.image, second.image
    if a.shape != b.shape:  # what is bright lies elsewhere
        return Likeness(float("inf"))
    largest = max(a.max(), b.max())
    tiles_a, tiles_b = _tiles(a), _tiles(b)
    level = 0.5 * (tiles_a + tiles_b).mean(axis=(1, 2))
    use = (tiles_a.max(axis=(1, 2)) < largest) & (tiles_b.max(axis=(1, 2)) < largest)
    if use.sum() < _LEAST_BLOCKS:
        return Likeness(float("inf"))
    dark, bright = np.percentile(level[use], [1.0, 99.5])
    use &= level > dark + _BRIGHT * (bright - dark)
    if use.sum() < _LEAST_BLOCKS:
        return Likeness(float("inf"))
    gain, offset = _line(tiles_a[use].mean(axis=(1, 2)), tiles_b[use].mean(axis=(1, 2)))
    a = np.float32(gain) * a + np.float32(offset)
    difference = _tiles(b - a)
    square = np.mean(np.square(difference), axis=(1, 2))
    use &= square <= np.quantile(square[use], 1.0 - _DIFFERENT)
    noise = max(gain**2 * first.variance(level[use]), second.variance(level[use]), _ROUNDING)
    variances = [
        float(np.mean(np.square(_means(difference[use], side)))) * side**2 for side in (1, 2, 4)
    ]
    ratio = min(variances) / (2.0 * noise)
    whiteness = variances[2] / max(variances[0], 1e-12)
    possible = _COMMON_NOISE if whiteness >= _FINE_ONLY else _COMPRESSION
    if ratio >= possible or variances[0] == 0.0:
        return Likeness(ratio, whiteness=whiteness)
    mean = 0.5 * (a + b)
    d = difference[use].ravel().astype(np.float64)
    gx, gy = (_tiles(np.asarray(g, np.float32))[use].ravel() for g in np.gradient(mean)[::-1])
    slopes = np.column_stack([gx, gy]).astype(np.float64)
    shift = np.linalg.lstsq(slopes.T @ slopes, slopes.T @ d, rcond=None)[0]
    own = _tiles(a - np.asarray(cv2.filter2D(mean, -1, _NEIGHBOURS), np.float32))[use].ravel()
    power = float(d @ d)
    return Likeness(
        ratio,
        float(np.hypot(*shift)),
        -float(d @ own) / power,
        float(np.sqrt(np.mean(np.square(own)) / power)),
        whiteness,
    )


def _line(x: Image, y: Image) -> tuple[float, float]:
    """Gain and offset that turn the means of the blocks of one frame into those of the other."""
    gain, offset = 1.0, float(np.median(y - x))
    for _ in range(2):
        if np.ptp(x) > 0:
            gain, offset = np.polyfit(x, y, 1)
        away = np.abs(y - gain * x - offset)
        near = away <= np.quantile(away, 1.0 - _DIFFERENT)
        x, y = x[near], y[near]
    return float(gain), float(offset)


def _tiles(image: Image) -> Image:
    """Cut into blocks of 8 x 8 pixels, (n_blocks, 8, 8)."""
    height, width = image.shape
    tiles = image.reshape(height // _BLOCK_PX, _BLOCK_PX, width // _BLOCK_PX, _BLOCK_PX)
    return tiles.transpose(0, 2, 1, 3).reshape(-1, _BLOCK_PX, _BLOCK_PX)


def _means(tiles: Image, side: int) -> Image:
    """Means of side x side pixels within blocks."""
    n = _BLOCK_PX // side
    means: Image = tiles.reshape(-1, n, side, n, side).mean(axis=(2, 4))
    return means


def _standardised(small: Image) -> Image:
    """Thumbnail with median 0 and, from its 90 % range, contrast 1, as a vector."""
    low, middle, high = np.percentile(small, [5.0, 50.0, 95.0])
    return np.asarray((small - middle) / max(high - low, 1e-3), np.float32).ravel()
