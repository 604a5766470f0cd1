"""What the headers of a file say of the pictures in it, and how a format is read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.image_files.orientation import AS_STORED
from pv_inspect.image_files.regular import FileState

__all__ = ["ImageFormat", "Listing", "Picture"]


@dataclass(frozen=True)
class Picture:
    """One picture of a file.

    Parameters
    ----------
    shape : tuple of int
        (height, width) as it is shown, px.
    dtype : dtype
        Type of the decoded values, in the machine's byte order.
    place : tuple
        Where it is, in the terms of its format.
    bits : int
        Of a value; 0 where that of the type counts.
    coloured : bool
        Whether it has channels of colours, which may be alike.
    lossy : bool
        Whether its compression has changed the values.
    orientation : int
        What was done to show it; `AS_STORED` for nothing.
    """

    shape: tuple[int, int]
    dtype: np.dtype[Any]
    place: tuple[int | str, ...] = ()
    bits: int = 0
    coloured: bool = False
    lossy: bool = False
    orientation: int = AS_STORED


@dataclass(frozen=True)
class Listing:
    """The pictures of a file.

    Parameters
    ----------
    pictures : tuple of Picture
    notes : tuple of str
        What was left out; each goes on after the file's name and ends a sentence.
    """

    pictures: tuple[Picture, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class ImageFormat:
    """A family of files and how it is read.

    Parameters
    ----------
    name : str
        As in `pv_inspect.image_files.endings`.
    listed : callable
        Lists the pictures of a file, (path, state, limits, series), from headers only; raises
        `ImageFileError`.
    decoded : callable
        Decodes one of them, (path, state, picture, limits), to (height, width) or (height, width,
        channels); raises `ImageFileError`.
    stacks : bool
        Whether such a file is meant to hold a whole sequence: in a folder it counts only where
        there are no images of other formats.
    """

    name: str
    listed: Callable[[Path, FileState, ReadLimits, str | None], Listing]
    decoded: Callable[[Path, FileState, Picture, ReadLimits], NDArray[Any]]
    stacks: bool = False
