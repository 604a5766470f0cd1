"""How a picture is turned before it is shown: tag 274 of TIFF, which Exif puts into JPEG as well.

Viewers show a picture as the tag says, so rows and columns are meant that way; every format is
treated alike.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "AS_STORED",
    "exif_orientation",
    "known_orientation",
    "said_of_orientation",
    "turned",
    "turned_shape",
]

AS_STORED = 1
_TAG, _SHORT = 274, 3
_SAID = {
    2: "mirrored left to right",
    3: "turned by 180 degrees",
    4: "mirrored top to bottom",
    5: "mirrored along the diagonal",
    6: "turned by 90 degrees clockwise",
    7: "mirrored along the other diagonal",
    8: "turned by 90 degrees counterclockwise",
}


def known_orientation(value: int) -> int:
    """Return the value of the tag, `AS_STORED` if it is none of its values."""
    return value if value in _SAID else AS_STORED


def said_of_orientation(orientation: int) -> str:
    """Say what is done to the picture as a clause, "" if nothing."""
    return _SAID.get(orientation, "")


def turned_shape(height: int, width: int, orientation: int) -> tuple[int, int]:
    """Return (height, width) after `turned`."""
    return (width, height) if orientation >= 5 else (height, width)


def turned(image: NDArray[np.generic], orientation: int) -> NDArray[np.generic]:
    """Turn or mirror a picture as its tag says.

    Parameters
    ----------
    image : (height, width) or (height, width, channels)
    orientation : int
        1 to 8.

    Returns
    -------
    array
        The same one if nothing has to be done.
    """
    if orientation == AS_STORED:
        return image
    if orientation >= 5:
        image = image.swapaxes(0, 1)
    rows = slice(None, None, -1) if orientation in (3, 4, 7, 8) else slice(None)
    cols = slice(None, None, -1) if orientation in (2, 3, 6, 7) else slice(None)
    return np.ascontiguousarray(image[rows, cols])


def exif_orientation(jpeg: bytes) -> int:
    """Find the orientation in the Exif part of a JPEG; `AS_STORED` if there is none that is whole.

    Parameters
    ----------
    jpeg : bytes
        The file, or its beginning.
    """
    for marker, content in _segments(jpeg):
        if marker == 0xE1 and content.startswith(b"Exif\0\0"):
            try:
                return known_orientation(_in_tiff(content[6:]))
            except struct.error:
                return AS_STORED
    return AS_STORED


def _segments(jpeg: bytes) -> Iterator[tuple[int, bytes]]:
    """Segments (marker, content) before the picture."""
    at = 2
    while at + 4 <= len(jpeg) and jpeg[at] == 0xFF and jpeg[at + 1] != 0xDA:
        length = int.from_bytes(jpeg[at + 2 : at + 4])
        if jpeg[at + 1] == 0xFF:  # filling
            at += 1
            continue
        yield jpeg[at + 1], jpeg[at + 4 : at + 2 + length]
        at += 2 + max(length, 2)


def _in_tiff(data: bytes) -> int:
    order = {b"II": "<", b"MM": ">"}.get(data[:2])
    if order is None:
        return AS_STORED
    (at,) = struct.unpack_from(f"{order}I", data, 4)
    (n,) = struct.unpack_from(f"{order}H", data, at)
    for k in range(min(n, 512)):
        tag, kind, count, value = struct.unpack_from(f"{order}HHIH", data, at + 2 + 12 * k)
        if (tag, kind, count) == (_TAG, _SHORT, 1):
            return int(value)
    return AS_STORED
