"""FITS, the format of astronomical cameras: images, cubes and extensions, read by astropy.

References
----------
FITS Standard 4.0, IAU 2018.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from pv_inspect.image_files.arrays import StoredArray, listed_arrays, native, pictures_index
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.image_files.orientation import AS_STORED, turned
from pv_inspect.image_files.picture import Listing, Picture
from pv_inspect.image_files.problems import ImageFileError, damaged, needs_package
from pv_inspect.image_files.regular import FileState, open_regular

__all__ = ["decoded_fits", "listed_fits"]

_MOST_EXTENSIONS = 2000
_STORED = {8: "u1", 16: "i2", 32: "i4", 64: "i8", -32: "f4", -64: "f8"}
# Row order of programs that store the lowest row first; others store the top row first, or do not
# say, and are shown as numpy does.
_BOTTOM_UP = 4


def listed_fits(path: Path, state: FileState, limits: ReadLimits, series: str | None) -> Listing:
    """List the pictures of a FITS file; see `ImageFormat`."""
    with open_regular(path, state) as file, _opened(file) as units:
        end = file.seek(0, os.SEEK_END)
        found = []
        for k in range(_MOST_EXTENSIONS):
            try:
                unit = units[k]
            except IndexError:
                break
            if unit.is_image:
                found.append(_array(unit, k, end))
    return listed_arrays([array for array in found if array.shape], limits, series)


def decoded_fits(path: Path, state: FileState, picture: Picture, _: ReadLimits) -> NDArray[Any]:
    """Decode a picture of a FITS file; see `ImageFormat`."""
    name, index = str(picture.place[0]), int(picture.place[1])
    with open_regular(path, state) as file, _opened(file) as units:
        unit = units[int(name.partition(" ")[0]) - 1]
        shape = tuple(map(int, unit.shape))
        where = pictures_index(shape, index)
        wanted = tuple(n for n, at in zip(shape, where, strict=True) if isinstance(at, slice))
        values = np.asarray(unit.section[where])
        if values.size != prod(wanted):
            raise damaged("its data are smaller than its header says")
    # astropy keeps some axes of length one.
    return turned(native(values.reshape(wanted), picture), picture.orientation)


@contextmanager
def _opened(file: BinaryIO) -> Iterator[Any]:
    try:
        from astropy.io import fits
    except ImportError:
        raise needs_package("a FITS file", "fits") from None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # remarks on the standard
        try:
            with fits.open(file, memmap=False, lazy_load_hdus=True) as units:
                yield units
        except (ImageFileError, OSError) as error:
            raise _told(error) from None
        # What astropy says of damaged data can be any exception.
        except Exception as error:
            raise damaged(f"{type(error).__name__}: {str(error)[:80]}") from None


def _told(error: ImageFileError | OSError) -> Exception:
    if isinstance(error, ImageFileError) or error.errno is not None:
        return error
    return damaged("it is no whole FITS file")


def _array(unit: Any, k: int, end: int) -> StoredArray:
    """What the header of an image says; the name begins with its number."""
    header = unit.header
    shape = tuple(int(n) for n in unit.shape)
    bits = int(header["BITPIX"])
    if bits not in _STORED or any(n < 0 for n in shape):
        raise damaged("its header is damaged")
    compressed = type(unit).__name__ == "CompImageHDU"
    at = unit.fileinfo()["datLoc"]
    if not compressed and at + abs(bits) // 8 * prod(shape, start=bool(shape)) > end:
        raise damaged("the file ends too early")
    name = str(header.get("EXTNAME", "")).strip()
    order = str(header.get("ROWORDER", "")).upper()
    return StoredArray(
        f"{k + 1} {name}".strip(),
        shape,
        _type_of(bits, header),
        _BOTTOM_UP if order == "BOTTOM-UP" else AS_STORED,
        compressed and "HCOMPRESS" in str(header.get("ZCMPTYPE", "")),
    )


def _type_of(bits: int, header: Any) -> np.dtype[Any]:
    stored = np.dtype(_STORED[bits])
    scale, zero = header.get("BSCALE", 1), header.get("BZERO", 0)
    if stored.kind == "f" or (scale == 1 and zero == 0 and "BLANK" not in header):
        return stored
    if scale == 1 and bits in (16, 32) and zero == 2 ** (bits - 1) and "BLANK" not in header:
        return np.dtype(f"u{stored.itemsize}")
    return np.dtype(np.float32 if bits <= 16 else np.float64)
