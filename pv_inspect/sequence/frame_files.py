"""Single images on disk: TIFF pages and PNG files as (height, width) arrays."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.image_files.png import png_header, png_pixels
from pv_inspect.image_files.problems import ImageFileError
from pv_inspect.image_files.regular import FileState, file_state, open_regular
from pv_inspect.image_files.tiff import page_at, page_offsets, planes_of
from pv_inspect.image_files.tiff_pixels import page_pixels

__all__ = ["FrameFile", "expand", "natural_key", "read_floats", "read_frame"]

Pixels: TypeAlias = NDArray[np.unsignedinteger]


@dataclass(frozen=True)
class FrameFile:
    """Where one frame lies, and what its header says.

    Parameters
    ----------
    path : Path
    page : int
        Index of the TIFF page among the pictures of the file; 0 for other files.
    single : bool
        Whether this is the only frame of the file.
    shape : tuple of int
        (height, width), px.
    dtype : dtype
        Type of the values.
    offset : int
        Where the header of the TIFF page lies.
    state : FileState
        State of the file when it was listed.
    limits : ReadLimits
    plane : int
        Which of the pictures that share this header.
    """

    path: Path
    page: int
    single: bool
    shape: tuple[int, int]
    dtype: np.dtype[Any]
    offset: int
    state: FileState
    limits: ReadLimits
    plane: int = 0

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


def expand(path: Path, limits: ReadLimits | None = None) -> list[FrameFile]:
    """List the frames of a file: the pages of a TIFF (thumbnails left out), else the file.

    Only headers are read.

    Parameters
    ----------
    path : Path
    limits : ReadLimits, optional
        What is read at most; the default limits if not given.

    Raises
    ------
    InspectionError
        If the file can't be read as TIFF or PNG, holds no picture, or one that is too large.
    """
    limits = limits or ReadLimits()
    try:
        state = file_state(path)
        with open_regular(path, state) as file:
            if _is_png(path):
                png = png_header(file, limits)
                shape = png.height, png.width
                return [FrameFile(path, 0, True, shape, png.dtype, 0, state, limits)]
            offsets = page_offsets(file, limits.max_frames)
            pages = [page_at(file, offset, limits) for offset in offsets]
            planes = planes_of(file, offsets[0]) if len(pages) == 1 else 1
    except ImageFileError as problem:
        raise InspectionError(f"{path.name} {problem}") from None
    if planes > limits.max_frames:
        raise InspectionError(
            f"{path.name} has {planes} pictures, more than the {limits.max_frames} that are read "
            "as one sequence: take some of them, or raise max_frames."
        )
    places = [(page, offset, 0) for page, offset in zip(pages, offsets, strict=True)]
    if planes > 1:
        places = [(pages[0], offsets[0], plane) for plane in range(planes)]
    return [
        FrameFile(
            path,
            k,
            len(places) == 1,
            (page.height, page.width),
            page.dtype.newbyteorder("="),
            offset,
            state,
            limits,
            plane,
        )
        for k, (page, offset, plane) in enumerate(places)
    ]


def read_frame(file: FrameFile) -> Pixels:
    """Read one frame.

    Returns
    -------
    (height, width) uint8 or uint16

    Raises
    ------
    InspectionError
        If it can't be decoded, is coloured, has another type than 8 or 16 bits unsigned, or has
        changed since it was listed.
    """
    name = file.label(file.path.name)
    if file.dtype not in (np.uint8, np.uint16):
        raise InspectionError(
            f"{name} holds {file.dtype} values, but frames are 8- or 16-bit unsigned: export "
            "what the camera delivered, without scaling."
        )
    return cast(Pixels, _grey(_decoded(file), name))


def read_floats(file: FrameFile) -> NDArray[np.floating]:
    """Read one frame of floating-point values, for instance a result.

    Returns
    -------
    (height, width) in the type of the file

    Raises
    ------
    InspectionError
        If it can't be decoded, is coloured, or holds whole numbers.
    """
    name = file.label(file.path.name)
    if file.dtype.kind != "f":
        raise InspectionError(
            f"{name} holds {file.dtype} values, but floating-point values are expected: give the "
            "file that pv-inspect wrote."
        )
    return cast("NDArray[np.floating]", _grey(_decoded(file), name))


def _is_png(path: Path) -> bool:
    return path.suffix.lower() == ".png"


def _decoded(file: FrameFile) -> NDArray[Any]:
    try:
        with open_regular(file.path, file.state) as opened:
            if _is_png(file.path):
                image = png_pixels(opened, png_header(opened, file.limits))
            else:
                image = page_pixels(opened, file.offset, file.limits, file.plane)
    except ImageFileError as problem:
        raise InspectionError(f"{file.label(file.path.name)} {problem}") from None
    return image


def _grey(image: NDArray[Any], name: str) -> NDArray[Any]:
    if image.ndim == 2:
        return image
    grey = np.ascontiguousarray(image[..., 0])
    if all(np.array_equal(grey, image[..., k]) for k in (1, 2)):
        return grey
    raise InspectionError(
        f"{name} is a colour image, but luminescence frames have one grey channel: export it "
        "as grey, without a colour map."
    )
