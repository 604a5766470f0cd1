"""One frame ready for use."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pv_inspect.sequence.sensor import (
    fill_pixels,
)

__all__ = ["Frame", "prepared"]

Raw = NDArray[np.unsignedinteger]


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
        False: saturated, hot or dead. Read-only.
    """

    image: NDArray[np.float32]
    valid: NDArray[np.bool_]


def prepared(
    raw: Raw,
    black: NDArray[np.float32],
    level: float,
    full_scale: float,
    defects: NDArray[np.bool_],
    flat: NDArray[np.float32] | None,
) -> Frame:
    """Take out what the sensor and the lens did to the numbers of a frame."""
    image = (raw.astype(np.float32) - black) / np.float32(full_scale - level)
    if flat is not None:
        np.divide(image, flat, out=image, where=flat > 0.0)
    valid = (raw < full_scale) & ~defects
    image = fill_pixels(image, defects, valid)
    image.flags.writeable = False
    valid.flags.writeable = False
    return Frame(image, valid)
