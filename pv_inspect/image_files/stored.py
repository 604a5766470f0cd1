"""The images of a result folder, read with the same care as frames."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.image_files.problems import ImageFileError
from pv_inspect.image_files.regular import open_regular
from pv_inspect.image_files.tiff import page_at, page_offsets
from pv_inspect.image_files.tiff_pixels import page_pixels

__all__ = ["stored_floats", "stored_shape"]

# 12 Mpx frames at magnification 6 make 450 Mpx.
_MOST_FLOAT_MPX = 512.0
_LIMITS = ReadLimits(max_frame_mpx=2 * _MOST_FLOAT_MPX)


def stored_shape(path: Path) -> tuple[int, int]:
    """Return (height, width) of the image in a TIFF, without reading its pixels.

    Raises
    ------
    FileNotFoundError
        If there is none.
    ValueError
        If it is no image of this program; one clause that says why.
    """
    with _opened(path) as file:
        page = page_at(file, _only_page(file), _LIMITS)
        if page.samples != 1 or page.dtype.newbyteorder("=") != np.float32:
            raise ValueError(f"it holds {page.dtype} values in {page.samples} channels")
        return page.shape


def stored_floats(path: Path) -> NDArray[np.float32]:
    """Read the image in a TIFF, (height, width) float32; errors as for `stored_shape`."""
    stored_shape(path)
    with _opened(path) as file:
        return np.asarray(page_pixels(file, _only_page(file), _LIMITS), np.float32)


def _only_page(file: BinaryIO) -> int:
    offsets = page_offsets(file, _LIMITS.max_frames)
    if len(offsets) > 1:
        raise ValueError(f"it has {len(offsets)} pages")
    return offsets[0]


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    path.stat()
    try:
        with open_regular(path) as file:
            yield file
    except ImageFileError as problem:
        raise ValueError(problem.reason) from None
