"""One grey channel out of pictures that were stored with colours."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError

__all__ = ["grey_of"]

# Channels that differ by no more than this share of the brightest value, or this many levels of 8
# or 16 bits, are one picture: exports with a white balance, rounding of colour spaces and the
# colour channels of JPEG do that. Colour maps reach half of the range and more.
_TINT, _LEVELS = 0.05, 3
# Share of the pixels that may differ more: a coloured cross hair or clock.
_OVERLAY = 1e-3


def grey_of(image: NDArray[Any], name: str) -> tuple[NDArray[Any], bool]:
    """Return the picture if it is grey, or the mean of channels that hardly differ.

    Parameters
    ----------
    image : (height, width) or (height, width, 3 or 4)
        A fourth channel is ignored.
    name : str
        For the message.

    Returns
    -------
    grey : (height, width) in the same type
        Where one of the channels is at its limit, so is the result.
    tinted : bool
        Whether the channels differ.

    Raises
    ------
    InspectionError
        If it has colours.
    """
    if image.ndim == 2:
        return image, False
    colours = image[..., :3]
    if all(np.array_equal(colours[..., 0], colours[..., k]) for k in (1, 2)):
        return np.ascontiguousarray(colours[..., 0]), False
    brightest = colours.max(axis=2)
    span = brightest.astype(np.float64) - colours.min(axis=2)
    tint = _TINT * float(np.max(brightest, where=np.isfinite(span), initial=0))
    if image.dtype.kind == "u":
        tint = max(tint, _LEVELS)
    # What is no number is no colour either.
    if np.mean(span > tint) > _OVERLAY:
        raise InspectionError(
            f"{name} is a colour image, but luminescence frames have one grey channel: export it "
            "as grey, without a colour map."
        )
    mean = colours.mean(axis=2, dtype=np.float64)
    if image.dtype.kind in "ui":
        most = np.iinfo(image.dtype).max
        mean = np.where(brightest == most, most, np.rint(mean))
    return mean.astype(image.dtype), True
