"""What the sensor does to a frame: bit depth, black level, columns and defective pixels.

Everything is estimated from the frames themselves, for nobody delivers a camera certificate with
a field measurement. Stacks are (n_frames, height, width) in the stored dtype, levels in DN.
"""

from __future__ import annotations

from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from pv_inspect.common.robust import MAD_TO_SIGMA

__all__ = [
    "Raw",
    "black_level",
    "column_offsets",
    "defective_pixels",
    "effective_depth",
    "fill_pixels",
    "flat_field",
    "temporal_median",
]

# Counts, or computed values brought to the same scale.
Raw: TypeAlias = NDArray[np.unsignedinteger | np.float32]
Mask = NDArray[np.bool_]
Image = NDArray[np.float32]

_DEPTHS = (8, 10, 12, 14, 16)
# A defect stands out by so many sigmas of the noise and by so many times its surroundings.
_SIGNIFICANCE = 8.0
_TIMES_SURROUNDINGS = 6.0
# Smaller deviations (share of full scale) are left alone: they do less than the noise does.
# Few frames prove less; with n frames this times 10 / n.
_LEAST_DEFECT = 0.01
# From here on a deviation need not be constant, only be there: its surroundings move.
_LARGE_DEFECT = 0.02
# Share of the deviation that must be there in three quarters of the frames.
_STEADINESS = 0.3
# Without the test in time only isolated extremes are called defective; on lines and edges they must
# stand out more. Of 6320 defects above a tenth of full scale in 48 simulated single frames (optical
# sigma 0.3, 0.45, 0.7) 221 are missed and no good pixel is taken for one:
# `benchmarks/few_frames.py defects --seeds 40 56`.
_TIMES_SURROUNDINGS_IN_SPACE, _ON_LINES = 6.0, 10.0
# Correlation of the detail of two frames above which the module has not moved between them.
_STILL = 0.5
_FRAMES_FOR_TEMPORAL_TEST = 3
# A point that came through the optics gives at least this share of its peak to a 4-neighbour
# (optical sigma 0.4 LR px before the square aperture, point on the pixel centre: 0.13).
_SPREAD_OF_A_POINT = 0.12


def effective_depth(maximum: int, used_bits: int, stored_bits: int) -> tuple[int, float]:
    """Find the camera's bit depth inside the stored integers.

    Cameras of 10 to 14 bits are stored in 16: right-aligned (maximum 4095) or left-aligned
    (multiples of 16, maximum 65520). A hot pixel reaches full scale and gives the depth away.

    Parameters
    ----------
    maximum : int
        Largest value of all frames.
    used_bits : int
        Bitwise or of all values.
    stored_bits : int
        8 or 16.

    Returns
    -------
    bit_depth : int
        One of 8, 10, 12, 14, 16.
    full_scale : float
        DN at saturation.
    """
    if stored_bits == 8 or used_bits == 0:
        return stored_bits, float(2**stored_bits - 1)
    zeros = (used_bits & -used_bits).bit_length() - 1
    depth = min(d for d in _DEPTHS if d >= stored_bits - zeros)
    # Values below half of the range with zeros at the bottom are chance, not alignment.
    if depth < stored_bits and maximum >= 2 ** (stored_bits - 4):
        return depth, float((2**depth - 1) << (stored_bits - depth))
    depth = min(d for d in _DEPTHS if maximum < 2**d)
    return depth, float(2**depth - 1)


def temporal_median(stack: Raw) -> Image:
    """Return the median over the frames, (height, width) float32, DN."""
    n, height, width = stack.shape
    out = np.empty((height, width), np.float32)
    rows = max(1, 2**22 // (n * width))
    for top in range(0, height, rows):  # in bands: np.median copies what it gets
        out[top : top + rows] = np.median(stack[:, top : top + rows], axis=0)
    return out


def black_level(median: Image) -> float:
    """Estimate the black level from the temporal median of the frames.

    No pixel is darker than black, so the darkest percent of the (smoothed) scene bounds it from
    above. Around a module this is the night; when the module fills the image it is the gaps
    between cells, and the image still does not turn negative as a whole.

    Parameters
    ----------
    median : (height, width) float32, DN

    Returns
    -------
    float
        DN.
    """
    smooth = cv2.blur(cv2.medianBlur(median, 5), (5, 5))
    return float(np.percentile(smooth, 1.0))


def defective_pixels(stack: Raw, full_scale: float) -> Mask:
    """Find hot and dead pixels: they stay on the sensor while the module moves.

    Parameters
    ----------
    stack : (n_frames, height, width) uint8, uint16 or float32, DN
        Frames of the sequence; at least 3 for the temporal test, fewer leave the spatial one.
    full_scale : float
        DN at saturation.

    Returns
    -------
    (height, width) bool
        True: defective.

    Notes
    -----
    With e_t = pixel - median of its 3 x 3 neighbourhood in frame t, and m the median of e over
    the frames, a pixel is defective if

    - abs(m) stands out of what m does in the surrounding 7 x 7 pixels and on the whole sensor,
      and of its own standard error unless it is large,
    - e is there in at least three quarters of the frames: moving detail and noise are not, and
    - it stands alone: its 4-neighbours carry less of its light than a real point would give them
      through optics and pixel aperture. This is what saves real detail when the module
      moves less than a pixel, or when there is one frame only.
    """
    n = 1 if _stands_still(stack) else len(stack)
    in_time = n >= _FRAMES_FOR_TEMPORAL_TEST
    middle, weak, strong = _temporal_deviation(stack)
    size = np.abs(middle)
    around = 1.25 * (cv2.blur(size, (7, 7)) * 49.0 - size) / 48.0
    everywhere = MAD_TO_SIGMA * float(np.median(size))
    times = _TIMES_SURROUNDINGS if in_time else _TIMES_SURROUNDINGS_IN_SPACE
    least = _LEAST_DEFECT * max(1.0, 10.0 / n)
    threshold = np.maximum(times * around, max(_SIGNIFICANCE * everywhere, least * full_scale))
    if in_time:
        error = 1.25 * (strong - weak) / 1.349 / np.sqrt(n)
        certain = np.minimum(_SIGNIFICANCE * error, _LARGE_DEFECT * full_scale)
        np.maximum(threshold, certain, out=threshold)

    outstanding = (size > threshold) & (weak > _STEADINESS * size)
    rows, cols = np.nonzero(outstanding)
    # Stricter where detail may stay in place; elsewhere motion has done its part.
    limit = (0.75 if in_time else 0.5) * _SPREAD_OF_A_POINT
    alone = _spread(stack, rows, cols) < limit
    if not in_time:
        far = size[rows, cols] * times > _ON_LINES * threshold[rows, cols]
        alone |= far & (_spread(stack, rows, cols, on_line=True) < limit)
    defective: Mask = np.zeros(size.shape, bool)
    defective[rows[alone], cols[alone]] = True
    return defective


def _spread(
    stack: Raw, rows: NDArray[np.intp], cols: NDArray[np.intp], on_line: bool = False
) -> NDArray[np.float64]:
    """Return what the 4-neighbours of some pixels have of their deviation, (n_pixels,).

    The deviation is from the median of the 16 pixels at distance 2, in the median over the
    frames. The median of the four neighbours lets a second defect, but no column, be one of them.
    On a line or an edge the neighbours differ from that median by themselves: with ``on_line`` each
    is compared with the pixel behind it.
    """
    height, width = stack.shape[1:]
    steps = np.arange(-2, 3)
    # Beyond the border the image is mirrored.
    at_rows = height - 1 - np.abs(height - 1 - np.abs(rows[:, None, None] + steps[:, None]))
    at_cols = width - 1 - np.abs(width - 1 - np.abs(cols[:, None, None] + steps))
    patches = stack[:, at_rows, at_cols].astype(np.float64)
    ring = np.ones((5, 5), bool)
    ring[1:4, 1:4] = False
    patches -= np.median(patches[..., ring], axis=-1)[..., None, None]
    patch = np.median(patches, axis=0)
    cross = np.stack([patch[:, 1, 2], patch[:, 3, 2], patch[:, 2, 1], patch[:, 2, 3]])
    peak = patch[:, 2, 2]
    if on_line:
        behind = np.stack([patch[:, 0, 2], patch[:, 4, 2], patch[:, 2, 0], patch[:, 2, 4]])
        cross, peak = cross - behind, peak - np.median(behind, axis=0)
    share: NDArray[np.float64] = np.median(cross * np.sign(peak), axis=0)
    return share / np.maximum(np.abs(peak), 1e-9)


def _stands_still(stack: Raw) -> bool:
    """Tell whether the detail of the frames stays on the same pixels."""
    half = len(stack) // 2
    correlations = []
    for first in range(min(half, 3)):
        pair = []
        for frame in (stack[first], stack[first + half]):
            detail = frame.astype(np.float32) - cv2.medianBlur(frame, 3)
            detail -= np.median(detail[::4], axis=0)  # streaks of columns stay where they are
            limit = np.percentile(np.abs(detail[::4, ::4]), 99.0)  # and so do the defects
            pair.append(np.clip(detail, -limit, limit).ravel())
        spread = float(pair[0].std() * pair[1].std())
        product = float(((pair[0] - pair[0].mean()) * (pair[1] - pair[1].mean())).mean())
        correlations.append(product / spread if spread > 0.0 else 0.0)
    return bool(correlations) and float(np.median(correlations)) > _STILL


def _temporal_deviation(stack: Raw) -> tuple[Image, Image, Image]:
    """Return median, weak and strong quartile over the frames of (pixel - 3 x 3 median), DN.

    The quartiles are counted in the direction of the median: weak is what three quarters of the
    frames reach at least.
    """
    n, height, width = stack.shape
    middle, weak, strong = np.empty((3, height, width), np.float32)
    rows = max(8, 2**22 // (n * width))
    for top in range(0, height, rows):
        first, last = max(top - 1, 0), min(top + rows + 1, height)
        band = np.stack(
            [
                frame.astype(np.float32) - cv2.medianBlur(frame, 3)
                for frame in np.ascontiguousarray(stack[:, first:last])
            ]
        )
        band = np.sort(band[:, top - first : top - first + rows], axis=0)
        out = np.s_[top : top + band.shape[1]]
        middle[out] = 0.5 * (band[(n - 1) // 2] + band[n // 2])
        low, high = band[n // 4], band[(3 * n - 1) // 4]
        weak[out] = np.where(middle[out] > 0, low, -high)
        strong[out] = np.where(middle[out] > 0, high, -low)
    return middle, weak, strong


def column_offsets(stack: Raw, full_scale: float) -> NDArray[np.float32]:
    """Estimate the fixed offset of every column from the night above and below the module.

    Parameters
    ----------
    stack : (n_frames, height, width) uint8, uint16 or float32, DN
    full_scale : float
        DN at saturation.

    Returns
    -------
    (width,) float32
        DN above what the columns around have. All zero if the background does not show a
        pattern: rows of one half of it must say the same as those of the other half. Zero for
        columns with too little background.
    """
    median = temporal_median(stack)
    width = median.shape[1]
    none = np.zeros(width, np.float32)
    # Dark in nearly all frames; one frame of glare may not hide the background.
    quarter = max(len(stack) // 4, 1) if len(stack) > 1 else 0
    bright = np.partition(stack, len(stack) - 1 - quarter, axis=0)[len(stack) - 1 - quarter]
    smooth = cv2.blur(bright.astype(np.float32), (9, 9))
    dark = smooth < np.percentile(smooth, 1.0) + _NIGHT * full_scale
    dark = cv2.erode(dark.astype(np.uint8), np.ones((17, 17), np.uint8)) > 0
    enough = dark.sum(axis=0) >= _LEAST_NIGHT_ROWS
    if enough.sum() < width // 4:
        return none
    night = np.where(dark, median, np.nan)[:, enough]
    upper = (np.arange(len(median)) // 8) % 2 == 0
    halves = []
    for rows in (np.ones(len(median), bool), upper, ~upper):
        usable = np.isfinite(night[rows]).any(axis=0)
        profile = np.zeros(night.shape[1], np.float32)
        profile[usable] = np.nanmedian(night[rows][:, usable], axis=0)
        halves.append(profile - median_filter(profile, _COLUMNS_AROUND, mode="reflect"))
    whole, first, second = halves
    spread = float(first.std() * second.std())
    if spread == 0.0 or float(((first - first.mean()) * (second - second.mean())).mean()) < (
        _PATTERN_CORRELATION * spread
    ):
        return none
    offsets = none.copy()
    offsets[enough] = whole
    return offsets


# Background: less than this above the darkest percent, share of full scale.
_NIGHT = 0.015
_LEAST_NIGHT_ROWS = 32
_COLUMNS_AROUND = 63
_PATTERN_CORRELATION = 0.7


# Plausible flat frames: share of saturated pixels, share of pixels without light, and the light
# itself as a share of full scale.
_MOST_SATURATED = 0.01
_MOST_UNLIT = 0.02
_LEAST_LIGHT = 0.05
# A pixel with less than this share of the typical one sees no light.
_UNLIT = 0.1


def flat_field(flat: Raw, black: NDArray[np.float32], full_scale: float) -> Image:
    """Turn an image of an evenly bright surface into the relative response of every pixel.

    Parameters
    ----------
    flat : (height, width) uint8, uint16 or float32, DN
    black : (width,) or (height, width) float32
        What a pixel says without light, DN.
    full_scale : float
        DN at saturation.

    Returns
    -------
    (height, width) float32
        About 1: divided by the median of the bright pixels, those above half of the 99th
        percentile. 0 for single pixels without light.

    Raises
    ------
    ValueError
        With half a sentence that says why this is no flat frame.
    """
    light = flat.astype(np.float32) - black
    saturated = float((flat >= full_scale).mean())
    if saturated > _MOST_SATURATED:
        raise ValueError(f"has {100 * saturated:.0f} % saturated pixels")
    high = float(np.percentile(light, 99.0))
    bright = float(np.median(light[light >= min(0.5 * high, high)]))
    if not bright > _LEAST_LIGHT * full_scale:
        raise ValueError(
            f"is too dark ({bright:.0f} DN above black, at least "
            f"{_LEAST_LIGHT * full_scale:.0f} DN is needed)"
        )
    response = light / np.float32(bright)
    unlit = response < _UNLIT
    share = float(unlit.mean())
    if share > _MOST_UNLIT:
        raise ValueError(f"is dark in {100 * share:.0f} % of its pixels")
    response[unlit] = 0.0
    return response


def fill_pixels(image: Image, bad: Mask, valid: Mask) -> Image:
    """Replace ``bad`` pixels by the mean of the valid ones around, nearest neighbours first.

    Parameters
    ----------
    image : (height, width) float32
    bad : (height, width) bool
        Pixels to replace.
    valid : (height, width) bool
        Pixels that may be used.

    Returns
    -------
    (height, width) float32
        A new image; pixels without a valid one within 3 px keep their value.
    """
    out = image.copy()
    rows, cols = np.nonzero(bad)
    height, width = image.shape
    for r, c in zip(rows.tolist(), cols.tolist(), strict=True):
        for radius in (1, 2, 3):
            near = np.s_[
                max(r - radius, 0) : min(r + radius + 1, height),
                max(c - radius, 0) : min(c + radius + 1, width),
            ]
            use = valid[near]
            if use.sum() >= 3:
                out[r, c] = image[near][use].mean()
                break
    return out
