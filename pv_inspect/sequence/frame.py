"""One frame ready for use."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pv_inspect.sequence.sensor import fill_pixels
from pv_inspect.sequence.values import Raw, ValueScale

__all__ = ["Frame", "prepared"]


@dataclass(frozen=True)
class Frame:
    """One frame ready for use.

    Parameters
    ----------
    image : (height, width) float32
        Black-subtracted intensity, full scale = 1, divided by the flat field if there is one;
        defective pixels are filled from their neighbours. Saturated areas keep what the camera
        said. Read-only.
    valid : (height, width) bool
        False: saturated, hot, dead, or without a value. Read-only.
    added_variance : (height, width) float32 or None
        Of a difference of frames: variance beyond what the noise model says of ``image``, full
        scale squared. Read-only.
    """

    image: NDArray[np.float32]
    valid: NDArray[np.bool_]
    added_variance: NDArray[np.float32] | None = None


def prepared(
    raw: Raw,
    black: NDArray[np.float32],
    level: float,
    scale: ValueScale,
    defects: NDArray[np.bool_],
    flat: NDArray[np.float32] | None,
) -> Frame:
    """Take out what the sensor and the lens did to the numbers of a frame.

    Parameters
    ----------
    raw : (height, width)
        As it is stored.
    black : (width,) or (height, width) float32
        DN.
    level : float
        Black level, DN.
    scale : ValueScale
    defects : (height, width) bool
    flat : (height, width) float32 or None
    """
    values, missing = scale.dn(raw)
    image = (values.astype(np.float32) - black) / np.float32(scale.full_scale_dn - level)
    if flat is not None:
        np.divide(image, flat, out=image, where=flat > 0.0)
    valid = (values < scale.saturated_from) & ~defects
    if missing is not None:
        valid &= ~missing
    image = fill_pixels(image, defects, valid)
    image.flags.writeable = False
    valid.flags.writeable = False
    return Frame(image, valid)
