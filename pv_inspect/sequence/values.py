"""What the stored values mean: counts of a camera, or numbers that were computed from them.

Frames of 8 and 16 bits, and whole numbers of other types that fit into 16, are *counts*: the
camera's bits are found in them, and its full scale is where it saturates. Everything else is
*computed*: averaged, corrected or scaled. Such frames have no full scale of a camera, so where it
was saturated is not known; they are brought to a scale of the same kind by this rule:

- Values up to 2 are shares of full scale. Full scale is the smallest of 1 and what 14, 12, 10 and 8
  bits in 16 are of it (1/4, 1/16, ...) that no value exceeds; the largest value if that is above 1.
- Larger values are counts with fractions or signs. Full scale is the smallest of 255, 1023, 4095,
  16383 and 65535 that no value exceeds; the largest value if that is above 65535.
- Where the largest value is less than an eighth of that, it is full scale itself: it is in some
  other unit.

Pixels that are infinite, no number, beyond 1e30, more than a full scale below zero (like -9999), or
wrapped round (a dark frame was subtracted in unsigned numbers, so that what fell below zero came
out at the top) show nothing: they are not used, and filled from around for what needs a value
everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.image_files.picture import Picture
from pv_inspect.sequence.sensor import Raw, effective_depth

__all__ = ["Raw", "ValueScale", "ValueSurvey", "comparable"]

Mask: TypeAlias = NDArray[np.bool_]

# Corrections lift shares of full scale a little above 1.
_LARGEST_SHARE = 2.0
_DEPTHS = (8, 10, 12, 14, 16)
_OTHER_UNIT = 8.0
# float32 has rounded 4095 / 65535 up.
_ROUNDING = 1e-6
# Larger values fill gaps (often the largest float there is).
_FILLER = 1e30
# What computed values are brought to: that of 16 bits.
_FULL_SCALE_DN = 65535.0
# Next to saturated areas JPEG and video leave some levels less than full scale.
_LOSSY_LEVELS = 3
# Wrapped values: this share of the pixels at least is above half of the largest value and at most
# that share between an eighth and half of it, while half of those around the first are below this
# share of what is bright. Saturated areas are surrounded by light; hot pixels are fewer.
_WRAPPED, _BETWEEN, _DARK = 3e-4, 1e-3, 0.1
# Sides of the windows that a gap is filled from, one after the other, px.
_AROUND_PX = (3, 9, 27, 81, 243)


@dataclass(frozen=True)
class ValueScale:
    """How stored values become DN that all frames of a sequence share.

    Parameters
    ----------
    bit_depth : int or None
        Of the camera; None for computed values.
    full_scale : float
        In stored values.
    saturated_from : float
        DN from which a pixel counts as saturated.
    factor : float
        DN for one of the stored values.
    highest : float
        Stored values above it have wrapped round.
    whole : bool
        Whether these are counts.
    """

    bit_depth: int | None
    full_scale: float
    saturated_from: float
    factor: float = 1.0
    whole: bool = True
    highest: float = np.inf

    @property
    def full_scale_dn(self) -> float:
        """Full scale, DN."""
        return self.full_scale * self.factor

    def dn(self, raw: Raw) -> tuple[Raw, Mask | None]:
        """Bring a frame to DN.

        Returns
        -------
        values : (height, width) uint8, uint16 or float32
            Without gaps.
        missing : (height, width) bool or None
            Where there was no value; None if nowhere.
        """
        if raw.dtype.kind == "u":
            return raw, None
        filled, missing = self.without_gaps(raw)
        if self.whole:
            return np.rint(filled).astype(np.uint16), missing
        return (filled.astype(np.float64) * self.factor).astype(np.float32), missing

    def without_gaps(self, raw: Raw) -> tuple[Raw, Mask | None]:
        """Fill what shows nothing in floating-point values; see `dn`."""
        return _without_gaps(raw, -self.full_scale, self.highest)


@dataclass
class ValueSurvey:
    """What the values of all frames have in common, collected frame by frame."""

    minimum: float = np.inf
    maximum: float = -np.inf
    used_bits: int = 0
    whole: bool = True
    n_missing: int = 0
    n_wrapped: int = 0
    highest: float = np.inf

    def add(self, raw: Raw) -> None:
        """Take note of a frame.

        Parameters
        ----------
        raw : (height, width) uint8, uint16 or float32
        """
        if raw.dtype.kind == "u":
            self.minimum = min(self.minimum, float(raw.min()))
            self.maximum = max(self.maximum, float(raw.max()))
            self.used_bits |= int(np.bitwise_or.reduce(raw, axis=None))
            return
        known = raw[np.abs(raw) < _FILLER]
        self.n_missing += raw.size - known.size
        if not known.size:
            return
        limit = _wrapped_above(raw, known)
        if limit is not None:
            self.highest = min(self.highest, limit)
            known, before = known[known <= limit], known.size
            self.n_wrapped += before - known.size
        self.minimum = min(self.minimum, float(known.min()))
        self.maximum = max(self.maximum, float(known.max()))
        self.whole &= self.minimum >= 0 and self.maximum <= _FULL_SCALE_DN
        if self.whole:
            counts = known.astype(np.uint16)
            self.whole = bool(np.array_equal(counts, known))
            self.used_bits |= int(np.bitwise_or.reduce(counts, axis=None))

    def reach(self, raw: Raw) -> None:
        """Take note of the largest value of a reference image, which may be an average."""
        if raw.dtype.kind == "u":
            self.maximum = max(self.maximum, float(raw.max()))
            self.used_bits |= int(np.bitwise_or.reduce(raw, axis=None))
        else:
            known = raw[np.abs(raw) < _FILLER]
            self.maximum = max(self.maximum, float(known.max(initial=self.maximum)))

    def scale(self, pictures: Sequence[Picture]) -> ValueScale:
        """Decide what the values mean.

        Parameters
        ----------
        pictures : sequence of Picture
            All frames, of one type.
        """
        dtype, bits = pictures[0].dtype, pictures[0].bits
        lossy = any(picture.lossy for picture in pictures)
        # Noise around zero that was wrapped is neither whole nor the whole story.
        whole = self.whole and not self.n_wrapped
        # Floating-point zeros and ones are no counts of a camera.
        if whole and (dtype.kind != "f" or self.maximum > _LARGEST_SHARE):
            if bits:
                depth, full_scale = bits, float(2**bits - 1)
            else:
                stored = 8 if dtype == np.uint8 else 16
                depth, full_scale = effective_depth(int(self.maximum), self.used_bits, stored)
            return ValueScale(depth, full_scale, full_scale - _LOSSY_LEVELS * lossy)
        if self.maximum <= 0:
            raise InspectionError(
                f"The frames hold no value above zero (from {self.minimum:g} to {self.maximum:g}): "
                "export what the camera delivered."
            )
        full_scale = self._computed_full_scale()
        factor = _FULL_SCALE_DN / full_scale
        # The largest value is where several pixels would be cut off, if any are.
        top = float(np.float32(self.maximum * factor))
        return ValueScale(None, full_scale, top, factor, whole=False, highest=self.highest)

    def _computed_full_scale(self) -> float:
        largest = self.maximum
        unit = 1.0 / _FULL_SCALE_DN if largest <= _LARGEST_SHARE else 1.0
        candidates = [(2**depth - 1) * unit for depth in _DEPTHS]
        found = next((value for value in candidates if value * (1 + _ROUNDING) >= largest), largest)
        return largest if largest < found / _OTHER_UNIT else found


def comparable(raw: Raw) -> Raw:
    """Return a frame whose values can be compared before their scale is known."""
    if raw.dtype.kind == "u":
        return raw
    known = raw[np.abs(raw) < _FILLER]
    limit = _wrapped_above(raw, known) if known.size else None
    filled, _ = _without_gaps(raw, -np.inf, np.inf if limit is None else limit)
    top = float(np.abs(filled).max())
    return (filled.astype(np.float64) * (_FULL_SCALE_DN / top if top else 0)).astype(np.float32)


def _wrapped_above(raw: Raw, known: Raw) -> float | None:
    """Return the value above which pixels of a frame have wrapped round; None if none have."""
    top = float(known.max())
    if top <= 0 or np.mean(known > top / 2) < _WRAPPED:
        return None
    rest = known[known <= top / 2]
    if not rest.size or np.mean(known > top / 8) - np.mean(known > top / 2) > _BETWEEN:
        return None
    wrapped = raw > top / 2
    low = cv2.erode(np.where(np.abs(raw) < _FILLER, raw, np.float32(top)), np.ones((3, 3)))
    dark = _DARK * float(np.percentile(rest, 99.0))
    return top / 2 if float(np.median(low[wrapped])) < dark else None


def _without_gaps(raw: Raw, least: float, most: float) -> tuple[Raw, Mask | None]:
    """Fill what is no usable number, or not from least to most, with the mean of what is around.

    Returns
    -------
    filled : (height, width) float32
    missing : (height, width) bool or None
        None if nothing was filled.
    """
    missing = ~((np.abs(raw) < _FILLER) & (raw >= least) & (raw <= most))
    if not missing.any():
        return raw, None
    known = (~missing).astype(np.float32)
    if not known.any():
        return np.zeros_like(raw), missing
    values = np.where(missing, np.float32(0), raw)
    filled, todo = values.copy(), missing.copy()
    for side in _AROUND_PX:
        weight = cv2.blur(known, (side, side))
        mean = cv2.blur(values, (side, side)) / np.maximum(weight, 1e-6)
        here = todo & (weight > 0.5 / side**2)
        filled[here] = mean[here]
        todo &= ~here
        if not todo.any():
            break
    filled[todo] = np.median(values[~missing])
    return filled, missing
