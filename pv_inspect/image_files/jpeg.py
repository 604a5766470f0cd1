"""JPEG and BMP: size from the header, and pixels only if the decoder had nothing to complain of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.image_files.limits import ReadLimits, check_size
from pv_inspect.image_files.native_output import heard_on_stderr, silent_opencv
from pv_inspect.image_files.orientation import exif_orientation, turned, turned_shape
from pv_inspect.image_files.picture import Picture
from pv_inspect.image_files.problems import ImageFileError, damaged, needs_decoder
from pv_inspect.image_files.regular import FileState, open_regular

__all__ = ["decoded_bmp", "decoded_jpeg", "listed_photo", "read_photo", "with_tables"]

_START, _END = b"\xff\xd8", b"\xff\xd9"
_STAND_ALONE = {0x01, *range(0xD0, 0xD9)}
_START_OF_SCAN = 0xDA
_SCAN = b"\xff\xda"
# Notes and previews of cameras, before the size is said; usually less.
_HEADER_BYTES = 2**20
# Progressive pictures have about 10; each goes through the whole picture.
_MOST_SCANS = 40
_FRAME_HEADERS = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
_LOSSLESS = {0xC3, 0xC7, 0xCB, 0xCF}
# jerror.h of libjpeg: what its decoder says of damaged data, and of what does no harm.
_COMPLAINTS = (
    "Corrupt JPEG",
    "Premature end",
    "Inconsistent progression",
    "Invalid ",
    "Unsupported ",
    "Bogus ",
)
_REMARKS = ("Warning: unknown JFIF", "Unknown Adobe", "Caution: ", "Unknown APP")


def listed_photo(path: Path, state: FileState, limits: ReadLimits) -> Picture:
    """Find size and kind of a JPEG or BMP file in its header.

    Raises
    ------
    ImageFileError
        If it has no header, is too large or of a kind that is not read.
    """
    with open_regular(path, state) as file:
        data = file.read(_HEADER_BYTES)
        if data.startswith(b"BM"):
            height, width, channels = _bmp_size(data, limits)
            return Picture((height, width), np.dtype(np.uint8), coloured=channels > 1)
        try:
            height, width, channels = _jpeg_size(data)
        except ImageFileError:
            data += file.read(_most_bytes(limits) - len(data))
            height, width, channels = _jpeg_size(data)
    check_size(height, width, channels, limits)
    orientation = exif_orientation(data)
    return Picture(
        turned_shape(height, width, orientation),
        np.dtype(np.uint8),
        coloured=channels > 1,
        lossy=True,
        orientation=orientation,
    )


def read_photo(path: Path, limits: ReadLimits, state: FileState | None = None) -> NDArray[Any]:
    """Read a JPEG or BMP file, turned as its Exif part says.

    Parameters
    ----------
    path : Path
    limits : ReadLimits
    state : FileState, optional
        State of the file when it was looked at before.

    Returns
    -------
    (height, width) or (height, width, 3) uint8
        Blue, green, red.

    Raises
    ------
    ImageFileError
        As `decoded_jpeg`, and if the file has changed.
    """
    most = _most_bytes(limits)
    with open_regular(path, state) as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise ImageFileError(f"is larger than {most / 1e6:.0f} MB: it is no single picture.")
    if data.startswith(b"BM"):
        return decoded_bmp(data, limits)
    return turned(decoded_jpeg(data, None, limits), exif_orientation(data))


def _most_bytes(limits: ReadLimits) -> int:
    """No more than the picture itself would take, and some notes of the camera."""
    return int(limits.max_frame_mpx * 4e6) + 2**26


def with_tables(tables: bytes, data: bytes) -> bytes:
    """Put the tables that the segments of a TIFF share into one of them."""
    if not tables:
        return data
    if not (tables.startswith(_START) and tables.endswith(_END) and data.startswith(_START)):
        raise damaged("its JPEG tables are damaged")
    return tables[:-2] + data[2:]


def decoded_jpeg(
    data: bytes, largest: tuple[int, int] | None = None, limits: ReadLimits | None = None
) -> NDArray[Any]:
    """Decode a JPEG.

    Parameters
    ----------
    data : bytes
    largest : tuple of int, optional
        (height, width) that it may have at most.
    limits : ReadLimits, optional
        Limits on its size where nothing else is known.

    Returns
    -------
    (height, width) or (height, width, 3) uint8
        Blue, green, red.

    Raises
    ------
    ImageFileError
        If it is damaged, too large, or of a kind that is not read.
    """
    height, width, channels = _jpeg_size(data)
    check_size(height, width, channels, limits or ReadLimits())
    scans = data.count(_SCAN)
    if scans > _MOST_SCANS:
        raise damaged(f"its JPEG data are cut into {scans} scans")
    if largest is not None and (height > largest[0] or width > largest[1]):
        raise damaged("its JPEG data are larger than its header says")

    def decode() -> NDArray[Any] | None:
        return _decoded(data)

    image, heard = heard_on_stderr(decode, _of_libjpeg)
    complaints = [line for line in heard if line.startswith(_COMPLAINTS)]
    if image is None or complaints:
        raise damaged(complaints[0] if complaints else "its JPEG data are damaged")
    return image


def decoded_bmp(data: bytes, limits: ReadLimits) -> NDArray[Any]:
    """Decode a Windows bitmap; see `decoded_jpeg`."""
    height, width, channels = _bmp_size(data, limits)
    bits = 8 * channels
    pixels_at = int.from_bytes(data[10:14], "little")
    if pixels_at + height * ((width * bits + 31) // 32 * 4) > len(data):
        raise damaged("the file ends too early")
    image = _decoded(data)
    if image is None:
        raise damaged("it is no whole BMP")
    return image


def _bmp_size(data: bytes, limits: ReadLimits) -> tuple[int, int, int]:
    """Return (height, width, bytes of a pixel) out of the header of a Windows bitmap."""
    if not data.startswith(b"BM") or len(data) < 54:
        raise damaged("it is no BMP")
    width, height = (int.from_bytes(data[at : at + 4], "little", signed=True) for at in (18, 22))
    bits = int.from_bytes(data[28:30], "little")
    packed = int.from_bytes(data[30:34], "little")
    height = abs(height)
    check_size(height, width, max(1, bits // 8), limits)
    if bits not in (8, 24, 32) or packed not in (0, 3):
        raise needs_decoder(f"BMP of {bits} bits with compression {packed}")
    return height, width, bits // 8


def _decoded(data: bytes) -> NDArray[Any] | None:
    with silent_opencv():
        try:
            image: NDArray[Any] | None = cv2.imdecode(
                np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED
            )
        except cv2.error:
            return None
    return image


def _of_libjpeg(line: str) -> bool:
    return line.startswith(_COMPLAINTS + _REMARKS)


def _jpeg_size(data: bytes) -> tuple[int, int, int]:
    """Return (height, width, channels) out of the frame header."""
    if not data.startswith(_START):
        raise damaged("it is no JPEG")
    at = 2
    while at + 4 <= len(data):
        if data[at] != 0xFF:
            break
        marker = data[at + 1]
        if marker == 0xFF:  # filling
            at += 1
            continue
        if marker in _STAND_ALONE:
            at += 2
            continue
        if marker == _START_OF_SCAN:
            break
        length = int.from_bytes(data[at + 2 : at + 4])
        if marker in _FRAME_HEADERS and at + 10 <= len(data):
            if marker in _LOSSLESS or data[at + 4] != 8:
                raise needs_decoder("lossless JPEG or JPEG of more than 8 bits")
            return (
                int.from_bytes(data[at + 5 : at + 7]),
                int.from_bytes(data[at + 7 : at + 9]),
                data[at + 9],
            )
        at += 2 + max(length, 2)
    raise damaged("its JPEG header is damaged")
