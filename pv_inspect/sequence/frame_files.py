"""Single images on disk, of whatever format, as (height, width) arrays."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError, printable
from pv_inspect.image_files.formats import FORMAT_NAMES, format_of
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.image_files.natural_order import natural_key
from pv_inspect.image_files.picture import ImageFormat, Picture
from pv_inspect.image_files.problems import ImageFileError
from pv_inspect.image_files.regular import FileState, file_state
from pv_inspect.sequence.grey import grey_of

__all__ = [
    "FrameFile",
    "expand",
    "expand_with_notes",
    "natural_key",
    "read_floats",
    "read_frame",
    "read_tinted",
]

Pixels: TypeAlias = NDArray[np.unsignedinteger | np.float32]


@dataclass(frozen=True)
class FrameFile:
    """Where one frame lies, and what its header says.

    Parameters
    ----------
    path : Path
    page : int
        Index among the pictures of the file.
    single : bool
        Whether this is the only frame of the file.
    picture : Picture
        What its header says.
    state : FileState
        State of the file when it was listed.
    limits : ReadLimits
    """

    path: Path
    page: int
    single: bool
    picture: Picture
    state: FileState
    limits: ReadLimits

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width), px."""
        return self.picture.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the stored values."""
        return self.picture.dtype

    @property
    def format(self) -> ImageFormat:
        """How it is read."""
        return _known_format(self.path)

    def label(self, name: str) -> str:
        """Name of the frame, given the name of its file."""
        return name if self.single else f"{name}[{self.page}]"


def expand(
    path: Path, limits: ReadLimits | None = None, series: str | None = None
) -> list[FrameFile]:
    """List the frames of a file: the pages of a TIFF (thumbnails left out), else the file.

    Only headers are read.

    Parameters
    ----------
    path : Path
    limits : ReadLimits, optional
        What is read at most; the default limits if not given.
    series : str, optional
        Which one, where a file holds several series of pictures.

    Raises
    ------
    InspectionError
        If the file can't be read, holds no picture, or one that is too large.
    """
    return expand_with_notes(path, limits or ReadLimits(), series)[0]


def expand_with_notes(
    path: Path, limits: ReadLimits, series: str | None = None
) -> tuple[list[FrameFile], tuple[str, ...]]:
    """List the frames of a file as `expand`, and say in sentences what was left out of it."""
    try:
        state = file_state(path)
        listing = _known_format(path).listed(path, state, limits, series)
    except ImageFileError as problem:
        raise InspectionError(f"{path.name} {problem}") from None
    pictures = listing.pictures
    files = [
        FrameFile(path, k, len(pictures) == 1, picture, state, limits)
        for k, picture in enumerate(pictures)
    ]
    return files, tuple(printable(f"{path.name} {note}") for note in listing.notes)


def read_frame(file: FrameFile) -> Pixels:
    """Read one frame; see `read_tinted`."""
    return read_tinted(file)[0]


def read_tinted(file: FrameFile) -> tuple[Pixels, bool]:
    """Read one frame, and tell whether it had a slight tint.

    Returns
    -------
    image : (height, width) uint8 or uint16 if it is stored so, else float32
        Values that are infinite or no numbers are left as they are.
    tinted : bool

    Raises
    ------
    InspectionError
        If it can't be decoded, is coloured, holds no plain numbers, or has changed since it was
        listed.
    """
    name = file.label(file.path.name)
    if file.dtype.kind not in "uif":
        raise InspectionError(
            f"{name} holds {file.dtype} values, but frames are whole or floating-point numbers: "
            "export what the camera delivered, without scaling."
        )
    image, tinted = grey_of(_decoded(file), name)
    if file.dtype in (np.uint8, np.uint16):
        return cast(Pixels, image), tinted
    with np.errstate(over="ignore", invalid="ignore"):  # too large for float32: as infinite
        return image.astype(np.float32), tinted


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
    return cast("NDArray[np.floating]", grey_of(_decoded(file), name)[0])


def _known_format(path: Path) -> ImageFormat:
    found = format_of(path)
    if found is None:
        raise InspectionError(
            f"{path.name} is no {FORMAT_NAMES} file: convert it losslessly to TIFF or PNG."
        )
    return found


def _decoded(file: FrameFile) -> NDArray[Any]:
    try:
        return file.format.decoded(file.path, file.state, file.picture, file.limits)
    except ImageFileError as problem:
        raise InspectionError(f"{file.label(file.path.name)} {problem}") from None
