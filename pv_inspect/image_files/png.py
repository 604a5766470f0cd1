"""PNG: only what the picture needs reaches the decoder, and only after it was found whole.

libpng writes its complaints to the process's stderr and fills a cut picture with zeros. So
checksums, sizes and the inflated lines are verified here, and libpng gets nothing to complain of.

References
----------
Portable Network Graphics (PNG) Specification, third edition, W3C 2025.
"""

from __future__ import annotations

import math
import os
import struct
import zlib
from dataclasses import dataclass
from typing import Any, BinaryIO

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.image_files.byte_coding import unpacked_zlib
from pv_inspect.image_files.limits import ReadLimits, check_size
from pv_inspect.image_files.problems import damaged
from pv_inspect.image_files.regular import exactly

__all__ = ["PngHeader", "png_header", "png_pixels"]

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
# colour type: (channels, bit depths)
_KINDS = {
    0: (1, (1, 2, 4, 8, 16)),
    2: (3, (8, 16)),
    3: (1, (1, 2, 4, 8)),
    4: (2, (8, 16)),
    6: (4, (8, 16)),
}
_PALETTE = 3
# Adam7: first column, first row, step along columns, step along rows.
_PASSES = (
    (0, 0, 8, 8),
    (4, 0, 8, 8),
    (0, 4, 4, 8),
    (2, 0, 4, 4),
    (0, 2, 2, 4),
    (1, 0, 2, 2),
    (0, 1, 1, 2),
)
_MOST_CHUNKS = 2**18


@dataclass(frozen=True)
class PngHeader:
    """The header chunk.

    Parameters
    ----------
    height, width : int
        Size, px.
    bits : int
        Of one channel.
    colour : int
        Colour type.
    interlaced : bool
    """

    height: int
    width: int
    bits: int
    colour: int
    interlaced: bool

    @property
    def dtype(self) -> np.dtype[np.generic]:
        """Type of the decoded values."""
        return np.dtype(np.uint16 if self.bits == 16 else np.uint8)

    @property
    def coloured(self) -> bool:
        """Whether it has colours, which may be alike."""
        return self.colour in (2, _PALETTE, 6)

    def passes(self) -> list[tuple[int, int]]:
        """(rows, bytes of a row with its filter) of each interlace pass; one if there are none."""
        channels = _KINDS[self.colour][0]
        grid = _PASSES if self.interlaced else ((0, 0, 1, 1),)
        found = []
        for left, top, right, down in grid:
            cols = math.ceil((self.width - left) / right)
            rows = math.ceil((self.height - top) / down)
            if cols > 0 and rows > 0:
                found.append((rows, 1 + math.ceil(cols * channels * self.bits / 8)))
        return found


def png_header(file: BinaryIO, limits: ReadLimits) -> PngHeader:
    """Read and check the header.

    Raises
    ------
    ImageFileError
        If it is no PNG, its header is wrong, or it is too large.
    """
    file.seek(0)
    if file.read(8) != _SIGNATURE:
        raise damaged("no PNG signature")
    length, kind = struct.unpack(">I4s", exactly(file, 8, 8))
    if kind != b"IHDR" or length != 13:
        raise damaged("no PNG header")
    data = exactly(file, 16, 17)
    _check_sum(b"IHDR" + data[:13], data[13:])
    width, height, bits, colour, packing, filtering, interlace = struct.unpack(
        ">IIBBBBB", data[:13]
    )
    channels, depths = _KINDS.get(colour, (0, ()))
    if bits not in depths or packing or filtering or interlace > 1:
        raise damaged("its PNG header is wrong")
    # A palette and transparency unfold to 4 channels.
    decoded = {1: 4 if colour == _PALETTE else 1, 2: 4}.get(channels, channels)
    check_size(height, width, decoded * (2 if bits == 16 else 1), limits)
    return PngHeader(height, width, bits, colour, bool(interlace))


def png_pixels(file: BinaryIO, header: PngHeader) -> NDArray[Any]:
    """Decode the picture.

    Returns
    -------
    (height, width) or (height, width, channels) uint8 or uint16
        Blue, green, red, alpha.

    Raises
    ------
    ImageFileError
        If it is damaged or cut.
    """
    lines = _lines(header, *_chunks(file, header))
    image = cv2.imdecode(np.frombuffer(lines, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.shape[:2] != (header.height, header.width):
        raise damaged("no image in it")
    return np.asarray(image)


def _chunks(file: BinaryIO, header: PngHeader) -> tuple[bytes, bytes]:
    """Return (palette, compressed picture); other chunks are passed over unread."""
    end = file.seek(0, os.SEEK_END)
    most = sum(rows * size for rows, size in header.passes())
    # A compressed stream is never much longer than what it holds.
    most += most // 100 + 65536
    palette, total, at = b"", 0, 33
    parts: list[bytes] = []
    for _ in range(_MOST_CHUNKS):
        if at + 12 > end:
            raise damaged("the file ends too early")
        length, kind = struct.unpack(">I4s", exactly(file, at, 8))
        if at + 12 + length > end:
            raise damaged("the file ends too early")
        if kind in (b"IDAT", b"IEND") or (kind == b"PLTE" and not parts):
            total += length
            if total > most:
                raise damaged("its compressed picture is longer than the picture")
            data = exactly(file, at + 8, length + 4)
            _check_sum(kind + data[:-4], data[-4:])
            if kind == b"IEND":
                return palette, b"".join(parts)
            if kind == b"PLTE":
                palette = data[:-4]
            else:
                parts.append(data[:-4])
        elif not kind[0] & 0x20:
            raise damaged("it has an unknown part that is needed to show it")
        at += 12 + length
    raise damaged(f"it is cut into more than {_MOST_CHUNKS} parts")


def _lines(header: PngHeader, palette: bytes, packed: bytes) -> bytes:
    """Return a PNG with the same picture, found whole and not compressed."""
    size = sum(rows * line for rows, line in header.passes())
    lines = unpacked_zlib(packed, size, size)
    filters, at = np.frombuffer(lines, np.uint8), 0
    for rows, line in header.passes():
        if filters[at : at + rows * line : line].max() > 4:
            raise damaged("a line is filtered in an unknown way")
        at += rows * line
    head = struct.pack(
        ">IIBBBBB", header.width, header.height, header.bits, header.colour, 0, 0, header.interlaced
    )
    chunks = [_SIGNATURE, _chunk(b"IHDR", head)]
    if header.colour == _PALETTE:
        if not 3 <= len(palette) <= 3 * 2**header.bits or len(palette) % 3:
            raise damaged("its palette is wrong")
        # Whole, so that every value of a pixel has a colour.
        chunks.append(_chunk(b"PLTE", palette.ljust(3 * 2**header.bits, b"\0")))
    chunks += [_chunk(b"IDAT", zlib.compress(lines, 0)), _chunk(b"IEND", b"")]
    return b"".join(chunks)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I4s", len(data), kind) + data + struct.pack(">I", zlib.crc32(kind + data))


def _check_sum(data: bytes, expected: bytes) -> None:
    if zlib.crc32(data) != int.from_bytes(expected):
        raise damaged("a checksum is wrong")
