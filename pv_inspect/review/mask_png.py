"""Corrected masks as PNG, checked before a decoder sees them.

A picture out of somebody else's file may be damaged, or claim to be larger than the memory.
"""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError

__all__ = ["mask_from_png", "mask_to_png"]

Mask = NDArray[np.bool_]

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
# A cell is drawn at its HR size, some hundred pixels.
_MOST_PIXELS = 2**24


def mask_to_png(mask: Mask) -> bytes:
    """Pack a mask, (h, w) bool.

    Raises
    ------
    InspectionError
        If it is none.
    """
    if mask.ndim != 2 or mask.dtype != np.bool_ or not 0 < mask.size <= _MOST_PIXELS:
        raise InspectionError(
            f"A corrected mask is {mask.dtype} of shape {mask.shape}: give (h, w) bool."
        )
    flags = [cv2.IMWRITE_PNG_BILEVEL, 1]
    return bytes(cv2.imencode(".png", mask.astype(np.uint8) * 255, flags)[1])


def mask_from_png(png: bytes) -> Mask:
    """Unpack a mask, (h, w) bool.

    Raises
    ------
    ValueError
        If it is damaged, too large, or no picture of `mask_to_png`.
    """
    _check(png)
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise ValueError("a mask can't be decoded")
    return np.asarray(image > 0)


def _check(png: bytes) -> None:
    """Refuse what a decoder would complain about on its own, or never finish."""
    if not png.startswith(_SIGNATURE):
        raise ValueError("a mask is no PNG")
    at, chunks = len(_SIGNATURE), []
    while at < len(png):
        if at + 12 > len(png):
            raise ValueError("a mask is cut off")
        length, name = struct.unpack_from(">I4s", png, at)
        content = png[at + 8 : at + 8 + length]
        if len(content) != length or at + 12 + length > len(png):
            raise ValueError("a mask is cut off")
        (checksum,) = struct.unpack_from(">I", png, at + 8 + length)
        if checksum != zlib.crc32(png[at + 4 : at + 8 + length]):
            raise ValueError("a mask is damaged")
        chunks.append((name, content))
        at += 12 + length
    names = [name for name, _ in chunks]
    packed = b"".join(content for name, content in chunks if name == b"IDAT")
    n_data = names.count(b"IDAT")
    if names != [b"IHDR", *n_data * [b"IDAT"], b"IEND"] or len(chunks[0][1]) != 13:
        raise ValueError("a mask is a PNG of another kind")
    width, height, depth, *rest = struct.unpack(">IIBBBBB", chunks[0][1])
    if depth not in (1, 8) or rest != [0, 0, 0, 0]:
        raise ValueError("a mask is a PNG of another kind")
    if not 0 < width * height <= _MOST_PIXELS:
        raise ValueError(f"a mask of {width} x {height} px is too large")
    expected = height * (1 + -(-width * depth // 8))
    unpacking = zlib.decompressobj()
    try:
        lines = unpacking.decompress(packed, expected + 1)
    except zlib.error:
        raise ValueError("a mask is damaged") from None
    stride = expected // height
    if len(lines) != expected or not unpacking.eof or max(lines[::stride]) > 4:
        raise ValueError("a mask is damaged")
