"""Single images on disk: TIFF pages and PNG files as (height, width) arrays."""

from __future__ import annotations

import logging
import re
import threading
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias, cast

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError

__all__ = ["FrameFile", "expand", "natural_key", "read_frame"]

Pixels: TypeAlias = NDArray[np.unsignedinteger]

# A broken file is reported once, as an InspectionError, not on stderr as well.
logging.getLogger("tifffile").addHandler(logging.NullHandler())

# tifffile needs a further package for these; OpenCV has them built in.
_READ_BY_OPENCV = (tifffile.COMPRESSION.LZW, tifffile.COMPRESSION.JPEG)
_opencv_log = threading.Lock()

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True)
class FrameFile:
    """Where one frame lies.

    Parameters
    ----------
    path : Path
    page : int
        Index of the TIFF page; 0 for other files.
    single : bool
        Whether this is the only frame of the file.
    """

    path: Path
    page: int = 0
    single: bool = True

    def label(self, name: str) -> str:
        """Name of the frame, given the name of its file."""
        return name if self.single else f"{name}[{self.page}]"


def natural_key(name: str) -> list[tuple[int, int | str]]:
    """Sort key that puts frame_2 before frame_10.

    >>> sorted(["frame_10.tif", "frame_2.tif"], key=natural_key)
    ['frame_2.tif', 'frame_10.tif']
    """
    parts = re.split(r"(\d+)", name.casefold())
    return [(0, int(p)) if p.isdecimal() else (1, p) for p in parts]


def expand(path: Path) -> list[FrameFile]:
    """List the frames of a file: the pages of a TIFF (thumbnails left out), else the file.

    Raises
    ------
    InspectionError
        If the file can't be read as TIFF or holds no picture.
    """
    if path.suffix.lower() == ".png":
        return [FrameFile(path)]
    try:
        with tifffile.TiffFile(path) as tif:
            pages = [k for k, page in enumerate(tif.pages) if not page.aspage().subfiletype & 1]
    except Exception as error:  # whatever a parser throws at a broken file
        raise _unreadable(path.name, error) from None
    if not pages:
        raise _unreadable(path.name, ValueError("there is no picture in it"))
    return [FrameFile(path, page, len(pages) == 1) for page in pages]


def read_frame(file: FrameFile) -> Pixels:
    """Read one frame.

    Returns
    -------
    (height, width) uint8 or uint16

    Raises
    ------
    InspectionError
        If it can't be decoded, is coloured, or has another type than 8 or 16 bits unsigned.
    """
    name = file.label(file.path.name)
    try:
        image = _decode_png(file.path) if file.path.suffix.lower() == ".png" else _decode_tiff(file)
    except Exception as error:  # whatever a decoder throws at a broken file
        raise _unreadable(name, error) from None
    if image.dtype not in (np.uint8, np.uint16):
        raise InspectionError(
            f"{name} holds {image.dtype} values, but frames are 8- or 16-bit unsigned: export "
            "what the camera delivered, without scaling."
        )
    return _grey(image, name)


def _grey(image: Pixels, name: str) -> Pixels:
    if image.ndim == 3 and image.shape[2] in (3, 4):
        colours = image[..., :3]
        if np.all(colours == colours[..., :1]):
            return np.ascontiguousarray(colours[..., 0])
        raise InspectionError(
            f"{name} is a colour image, but luminescence frames have one grey channel: export it "
            "as grey, without a colour map."
        )
    if image.ndim != 2 or image.size == 0:
        raise InspectionError(
            f"{name} has the shape {image.shape}, but a frame is height x width: save every frame "
            "as its own page or file."
        )
    return image


def _decode_tiff(file: FrameFile) -> Pixels:
    with tifffile.TiffFile(file.path) as tif:
        page = tif.pages[file.page].aspage()
        ends = [o + n for o, n in zip(page.dataoffsets, page.databytecounts, strict=True)]
        if not ends or max(ends) > tif.filehandle.size:
            raise ValueError("the file ends too early")
        image: Pixels
        if page.compression in _READ_BY_OPENCV:
            image = _decode_with_opencv(file)
        else:
            image = page.asarray()
            image = image.astype(image.dtype.newbyteorder("="), copy=False)
            if page.photometric == tifffile.PHOTOMETRIC.MINISWHITE:
                image = np.invert(image)
        return image


def _decode_with_opencv(file: FrameFile) -> Pixels:
    data = np.frombuffer(file.path.read_bytes(), np.uint8)
    with _opencv_log:
        level = cv2.utils.logging.getLogLevel()
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        try:
            whole, images = cv2.imdecodemulti(
                data, cv2.IMREAD_UNCHANGED, range=(file.page, file.page + 1)
            )
        finally:
            cv2.utils.logging.setLogLevel(level)
    if not whole or len(images) != 1:
        raise ValueError("its compressed pixels are damaged")
    return cast(Pixels, images[0])


def _decode_png(path: Path) -> Pixels:
    data = path.read_bytes()
    _check_png(data)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ValueError("no image in it")
    return cast(Pixels, image)


def _check_png(data: bytes) -> None:
    """Check signature and checksums: the decoder would fill a cut file with zeros."""
    if not data.startswith(_PNG_SIGNATURE):
        raise ValueError("no PNG signature")
    at = len(_PNG_SIGNATURE)
    kind = b""
    while kind != b"IEND":
        length = int.from_bytes(data[at : at + 4])
        kind, end = data[at + 4 : at + 8], at + 8 + length
        if end + 4 > len(data):
            raise ValueError("the file ends too early")
        if zlib.crc32(data[at + 4 : end]) != int.from_bytes(data[end : end + 4]):
            raise ValueError("a checksum is wrong")
        at = end + 4


def _unreadable(name: str, error: Exception) -> InspectionError:
    reason = " ".join(str(error).split()) or type(error).__name__
    return InspectionError(
        f"{name} can't be read ({reason}): copy it again from the camera or remove it."
    )
