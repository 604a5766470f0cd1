"""AVI of uncompressed grey or colour pictures, as cameras write it: read without any decoder.

FFmpeg takes 16 bits without a name for colours of 5 bits, and does not know the name Y16.

References
----------
AVI RIFF File Reference, Microsoft; OpenDML AVI File Format Extensions 1.02.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from pv_inspect.image_files.limits import ReadLimits, check_size
from pv_inspect.image_files.picture import Picture
from pv_inspect.image_files.problems import ImageFileError, damaged
from pv_inspect.image_files.regular import exactly

__all__ = ["RawAvi", "raw_avi", "raw_avi_pixels", "raw_picture"]

# (compression, bits): bytes of a pixel.
_NO_NAME = b"\0\0\0\0"
_KINDS = {
    **{(_NO_NAME, bits): bits // 8 for bits in (8, 16, 24, 32)},
    **{(name, 8): 1 for name in (b"Y800", b"Y8  ", b"GREY")},
    **{(name, 16): 2 for name in (b"Y16 ", b"Y1\0\x10")},
}
_LISTS = (b"RIFF", b"LIST")
_MOST_CHUNKS = 10**6


@dataclass(frozen=True)
class RawAvi:
    """Where the pictures of an uncompressed AVI are.

    Parameters
    ----------
    height, width : int
        Size, px.
    pixel_bytes : int
        1 or 2 for grey, 3 or 4 for colours.
    bottom_up : bool
        Whether the lowest row comes first.
    palette : bytes
        Blue, green, red and nothing of every value; empty if there is none.
    frames : tuple of int
        Where the pictures begin.
    """

    height: int
    width: int
    pixel_bytes: int
    bottom_up: bool
    palette: bytes
    frames: tuple[int, ...]

    @property
    def line_bytes(self) -> int:
        """Bytes of a line, a multiple of four."""
        return (self.width * self.pixel_bytes + 3) // 4 * 4


def raw_avi(file: BinaryIO, limits: ReadLimits) -> RawAvi | None:
    """Find the pictures of an AVI; None if it is compressed or none.

    Raises
    ------
    ImageFileError
        If it ends too early, is damaged, too large, or has too many pictures.
    """
    file.seek(0)
    head = file.read(12)
    if head[:4] != b"RIFF" or head[8:] != b"AVI ":
        return None
    end = file.seek(0, os.SEEK_END)
    header: bytes | None = None
    promised, tag = 0, b""
    frames: list[tuple[int, int]] = []
    for name, at, size in _chunks(file, end):
        if name == b"strh" and size >= 36:
            stream = exactly(file, at, 36)
            if stream[:4] == b"vids" and header is None:
                promised = int.from_bytes(stream[32:36], "little")
                tag = b"vids"
            else:
                tag = b""
        elif name == b"strf" and tag and header is None:
            header = exactly(file, at, min(size, 40 + 1024))
            found = _format(header, limits)
            if found is None:
                return None
        elif name[2:] in (b"db", b"dc") and name[:2].isdigit() and header is not None and size:
            if len(frames) == limits.max_frames:
                raise ImageFileError(
                    f"has more than {limits.max_frames} pictures, but a sequence has about 20: "
                    "take some of them, or raise max_frames."
                )
            frames.append((at, size))
    if header is None:
        return None
    avi = _format(header, limits)
    assert avi is not None
    least = (avi.height - 1) * avi.line_bytes + avi.width * avi.pixel_bytes
    if promised > len(frames) or any(size < least for _, size in frames):
        raise damaged(f"the file ends too early, after {len(frames)} of {promised} pictures")
    if not frames:
        raise damaged("there is no picture in it")
    return RawAvi(
        avi.height,
        avi.width,
        avi.pixel_bytes,
        avi.bottom_up,
        avi.palette,
        tuple(at for at, _ in frames),
    )


def raw_avi_pixels(file: BinaryIO, avi: RawAvi, index: int) -> NDArray[Any]:
    """Decode a picture: (height, width) uint8 or uint16, or (height, width, 3) uint8."""
    size = (avi.height - 1) * avi.line_bytes + avi.width * avi.pixel_bytes
    data = exactly(file, avi.frames[index], size)
    lines = np.zeros(avi.height * avi.line_bytes, np.uint8)
    lines[:size] = np.frombuffer(data, np.uint8)
    rows = lines.reshape(avi.height, -1)[:, : avi.width * avi.pixel_bytes]
    rows = np.ascontiguousarray(rows[::-1] if avi.bottom_up else rows)
    if avi.pixel_bytes == 2:
        return rows.view("<u2").astype(np.uint16)
    if avi.pixel_bytes > 2:
        return rows.reshape(avi.height, avi.width, -1)[..., :3]
    if avi.palette:
        colours = np.zeros((256, 4), np.uint8)
        known = np.frombuffer(avi.palette, np.uint8).reshape(-1, 4)
        colours[: len(known)] = known
        if np.array_equal(colours[:, :3], np.arange(256, dtype=np.uint8)[:, None].repeat(3, 1)):
            return rows
        return colours[rows][..., :3]
    return rows


def raw_picture(avi: RawAvi, index: int) -> Picture:
    """What is known of a picture."""
    dtype = np.dtype(np.uint16 if avi.pixel_bytes == 2 else np.uint8)
    coloured = avi.pixel_bytes > 2 or bool(avi.palette)
    return Picture((avi.height, avi.width), dtype, (0, index), coloured=coloured)


def _format(header: bytes, limits: ReadLimits) -> RawAvi | None:
    if len(header) < 40:
        raise damaged("its header is damaged")
    length, width, height, _, bits = struct.unpack("<IiiHH", header[:16])
    pixel_bytes = _KINDS.get((header[16:20], bits))
    if pixel_bytes is None:
        return None
    check_size(abs(height), width, pixel_bytes, limits)
    palette = header[length:] if bits == 8 and header[16:20] == _NO_NAME else b""
    bottom_up = height > 0 and header[16:20] == _NO_NAME
    palette = palette[: len(palette) // 4 * 4]
    return RawAvi(abs(height), width, pixel_bytes, bottom_up, palette, ())


def _chunks(file: BinaryIO, end: int) -> Iterator[tuple[bytes, int, int]]:
    """(name, where its content begins, bytes) of every chunk, lists unfolded."""
    at = 0
    for _ in range(_MOST_CHUNKS):
        if at + 8 > end:
            return
        name, size = struct.unpack("<4sI", exactly(file, at, 8))
        if name in _LISTS:
            at += 12
            continue
        if at + 8 + size > end:
            raise damaged("the file ends too early")
        yield name, at + 8, size
        at += 8 + size + size % 2
    raise damaged(f"it is cut into more than {_MOST_CHUNKS} parts")
