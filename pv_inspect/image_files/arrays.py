"""Arrays as pictures: which axis counts the frames, and which arrays of a file belong together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pv_inspect.image_files.limits import ReadLimits, check_size
from pv_inspect.image_files.natural_order import natural_key
from pv_inspect.image_files.picture import Listing, Picture
from pv_inspect.image_files.problems import ImageFileError
from pv_inspect.image_files.series import Series, chosen_series, left_out

__all__ = ["StoredArray", "listed_arrays", "native", "pictures_index"]

# No side of a frame is shorter, so that a shorter last axis counts frames.
_SHORTEST_SIDE_PX = 32


@dataclass(frozen=True)
class StoredArray:
    """An array of a file.

    Parameters
    ----------
    name : str
        That finds it in the file; "" where there is only one.
    shape : tuple of int
    dtype : dtype
    orientation : int
    lossy : bool
    """

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    orientation: int = 1
    lossy: bool = False

    @property
    def picture_shape(self) -> tuple[int, int] | None:
        """(height, width) of a picture in it; None if it holds no pictures."""
        if self.dtype.kind not in "uif" or not all(self.shape):
            return None
        axes = _axes(self.shape)
        return None if axes is None else (self.shape[axes[1]], self.shape[axes[2]])

    @property
    def n(self) -> int:
        """Number of pictures."""
        axes = _axes(self.shape)
        return 1 if axes is None or axes[0] is None else self.shape[axes[0]]

    @property
    def one_by_one(self) -> bool:
        """Whether its first axis counts the pictures."""
        axes = _axes(self.shape)
        return axes is not None and axes[0] == 0

    @property
    def coloured(self) -> bool:
        """Whether its last axis are channels of colours."""
        axes = _axes(self.shape)
        return axes is not None and axes[3]


def pictures_index(shape: tuple[int, ...], k: int) -> tuple[int | slice, ...]:
    """Return the index of the ``k``-th picture in an array of pictures."""
    axes = _axes(shape)
    index: list[int | slice] = [0] * len(shape)
    if axes is None:
        raise ImageFileError("holds no pictures: give an array of frames x height x width.")
    frames, rows, cols, coloured = axes
    index[rows] = index[cols] = slice(None)
    if frames is not None:
        index[frames] = k
    if coloured:
        index[-1] = slice(None)
    return tuple(index)


def _axes(shape: tuple[int, ...]) -> tuple[int | None, int, int, bool] | None:
    """(axis of the frames, of the rows, of the columns, whether the last axis is of colours)."""
    # An axis of length one counts nothing, but a picture may be as narrow as that.
    long = [axis for axis, n in enumerate(shape) if n > 1]
    coloured = len(long) >= 3 and long[-1] == len(shape) - 1 and shape[-1] in (3, 4)
    if coloured:
        long = long[:-1]
    if len(long) == 2:
        return None, long[0], long[1], coloured
    if len(long) != 3:
        return None
    first, second, last = long
    sides = min(shape[first], shape[second])
    if not coloured and shape[last] < _SHORTEST_SIDE_PX <= sides:
        return last, first, second, False
    return first, second, last, coloured


def listed_arrays(found: Sequence[StoredArray], limits: ReadLimits, wanted: str | None) -> Listing:
    """List the pictures of the array that is meant; the place of one is (name, index).

    Single pictures of one size and type are one series if there is no longer one of their kind.

    Raises
    ------
    ImageFileError
        If there are none, several can be meant, or they are too large or too many.
    """
    arrays = [array for array in found if array.picture_shape is not None]
    if not arrays:
        raise ImageFileError(
            "holds no pictures: give whole or floating-point numbers, frames x height x width."
        )
    groups: list[list[StoredArray]] = []
    several = {_kind(array) for array in arrays if array.n > 1}
    for array in sorted(arrays, key=lambda array: natural_key(array.name)):
        alike = [g for g in groups if _kind(g[0]) == _kind(array) and g[0].n == array.n == 1]
        if alike and _kind(array) not in several:
            alike[0].append(array)
        else:
            groups.append([array])
    series = [
        Series(
            group[0].name if len(group) == 1 else "",
            sum(array.n for array in group),
            group[0].picture_shape or (0, 0),
            group[0].dtype.newbyteorder("="),
            group[0].coloured,
        )
        for group in groups
    ]
    chosen = chosen_series(series, wanted)
    of_series = series[chosen]
    if of_series.n > limits.max_frames:
        raise ImageFileError(
            f"has {of_series.n} pictures, more than the {limits.max_frames} that are read as one "
            "sequence: take some of them, or raise max_frames."
        )
    pixel_bytes = of_series.dtype.itemsize * (4 if of_series.coloured else 1)
    check_size(*of_series.shape, pixel_bytes, limits)
    pictures = tuple(
        Picture(
            of_series.shape,
            of_series.dtype,
            (array.name, k),
            coloured=of_series.coloured,
            lossy=array.lossy,
            orientation=array.orientation,
        )
        for array in groups[chosen]
        for k in range(array.n)
    )
    return Listing(pictures, left_out(series, chosen))


def _kind(array: StoredArray) -> object:
    return array.picture_shape, array.dtype.newbyteorder("="), array.coloured


def native(image: NDArray[Any], picture: Picture) -> NDArray[Any]:
    """Bring the values of a picture to the type that it was listed with."""
    return np.ascontiguousarray(image, picture.dtype)
