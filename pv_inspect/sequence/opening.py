"""What is checked when a sequence is opened."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.sequence.copies import FrameContents
from pv_inspect.sequence.frame_files import FrameFile, expand, read_frame
from pv_inspect.sequence.frame_list import existing_image
from pv_inspect.sequence.sensor import (
    temporal_median,
)

__all__ = ["DecodedFrames", "check_frames", "read_reference"]

Raw = NDArray[np.unsignedinteger]


_SMALLEST_SIDE_PX = 32


class DecodedFrames:
    """The frames as they are on disk; the first ones are kept once they were decoded.

    Parameters
    ----------
    files : tuple of FrameFile
    most_bytes : int
        So much is kept.
    """

    def __init__(self, files: tuple[FrameFile, ...], most_bytes: int) -> None:
        self._files = files
        self._left = most_bytes
        self._kept: dict[int, Raw] = {}

    def __getitem__(self, index: int) -> Raw:
        """Return a frame, (height, width) uint8 or uint16."""
        known = self._kept.get(index)
        if known is not None:
            return known
        image = read_frame(self._files[index])
        if image.nbytes <= self._left:
            self._left -= image.nbytes
            self._kept[index] = image
        return image


def check_frames(
    files: tuple[FrameFile, ...],
    names: tuple[str, ...],
    contents: FrameContents,
    decoded: DecodedFrames,
) -> tuple[tuple[int, int], int, int]:
    """Decode every frame once, into contents; return (shape, maximum, bitwise or of all values)."""
    shape = Counter(file.shape for file in files).most_common(1)[0][0]
    dtype = Counter(file.dtype for file in files).most_common(1)[0][0]
    maximum, used_bits = 0, 0
    # What the headers say comes first: nothing is decoded in vain.
    for name, file in zip(names, files, strict=True):
        if file.shape != shape:
            raise InspectionError(
                f"{name} is {file.shape[1]} x {file.shape[0]}, the sequence is {shape[1]} x "
                f"{shape[0]}: remove it or load it as its own sequence."
            )
        if file.dtype != dtype:
            raise InspectionError(
                f"{name} has {8 * file.dtype.itemsize} bits, the sequence has "
                f"{8 * dtype.itemsize}: remove it or export all frames alike."
            )
    if min(shape) < _SMALLEST_SIDE_PX:
        raise InspectionError(
            f"The frames are {shape[1]} x {shape[0]}, too small to show a module: at least "
            f"{_SMALLEST_SIDE_PX} x {_SMALLEST_SIDE_PX} is needed, give the full images."
        )
    for index in range(len(files)):
        image = decoded[index]
        maximum = max(maximum, int(image.max()))
        used_bits |= int(np.bitwise_or.reduce(image, axis=None))
        contents.add(image)
    return shape, maximum, used_bits


def read_reference(
    path: Path, kind: str, shape: tuple[int, int], dtype: np.dtype[Any], limits: ReadLimits
) -> Raw:
    """Read a dark or flat frame, the median of its pages."""
    files = expand(existing_image(path), limits)
    for file in files:
        if file.shape != shape or file.dtype != dtype:
            raise InspectionError(
                f"The {kind} frame {path} is {file.shape[1]} x {file.shape[0]} with "
                f"{8 * file.dtype.itemsize} bits, the sequence is {shape[1]} x {shape[0]} with "
                f"{8 * dtype.itemsize}: take it with the same camera settings."
            )
    pages = [read_frame(file) for file in files]
    if len(pages) == 1:
        return pages[0]
    median: Raw = temporal_median(np.stack(pages)).astype(dtype)
    return median
