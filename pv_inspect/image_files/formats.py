"""The formats that frames are read from, and which one a file has."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from pv_inspect.image_files.endings import ENDINGS
from pv_inspect.image_files.fits import decoded_fits, listed_fits
from pv_inspect.image_files.hdf5 import decoded_hdf5, listed_hdf5
from pv_inspect.image_files.jpeg import listed_photo, read_photo
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.image_files.numpy_files import decoded_numpy, listed_numpy
from pv_inspect.image_files.picture import ImageFormat, Listing, Picture
from pv_inspect.image_files.png import png_header, png_pixels
from pv_inspect.image_files.regular import FileState, open_regular
from pv_inspect.image_files.tiff_series import decoded_tiff, listed_tiff
from pv_inspect.image_files.video import decoded_video, listed_video

__all__ = ["FORMATS", "FORMAT_NAMES", "format_of"]


def _listed_png(path: Path, state: FileState, limits: ReadLimits, _: str | None) -> Listing:
    with open_regular(path, state) as file:
        png = png_header(file, limits)
    return Listing((Picture((png.height, png.width), png.dtype, coloured=png.coloured),))


def _decoded_png(path: Path, state: FileState, _: Picture, limits: ReadLimits) -> NDArray[Any]:
    with open_regular(path, state) as file:
        return png_pixels(file, png_header(file, limits))


def _listed_photo(path: Path, state: FileState, limits: ReadLimits, _: str | None) -> Listing:
    return Listing((listed_photo(path, state, limits),))


def _decoded_photo(path: Path, state: FileState, _: Picture, limits: ReadLimits) -> NDArray[Any]:
    return read_photo(path, limits, state)


FORMATS = (
    ImageFormat("TIFF", listed_tiff, decoded_tiff),
    ImageFormat("PNG", _listed_png, _decoded_png),
    ImageFormat("JPEG", _listed_photo, _decoded_photo),
    ImageFormat("BMP", _listed_photo, _decoded_photo),
    ImageFormat("FITS", listed_fits, decoded_fits),
    ImageFormat("NumPy", listed_numpy, decoded_numpy, stacks=True),
    ImageFormat("HDF5", listed_hdf5, decoded_hdf5, stacks=True),
    ImageFormat("video", listed_video, decoded_video, stacks=True),
)
_OF_ENDING = {ending: kind for kind in FORMATS for ending in ENDINGS[kind.name]}

FORMAT_NAMES = f"{', '.join(kind.name for kind in FORMATS[:-1])} or {FORMATS[-1].name}"
"""What a sentence calls all of them."""


def format_of(path: Path) -> ImageFormat | None:
    """Return the format that the ending of a file stands for, None if it is none of them."""
    return _OF_ENDING.get(path.suffix.lower())
