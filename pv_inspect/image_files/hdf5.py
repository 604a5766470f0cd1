"""HDF5: data sets of frames, read by h5py; nothing outside of the file is followed.

References
----------
HDF5 File Format Specification, version 3.0.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from math import prod
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from pv_inspect.image_files.arrays import StoredArray, listed_arrays, native, pictures_index
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.image_files.picture import Listing, Picture
from pv_inspect.image_files.problems import ImageFileError, damaged, needs_package
from pv_inspect.image_files.regular import FileState, open_regular

__all__ = ["decoded_hdf5", "listed_hdf5"]

_MOST_OBJECTS = 10_000
# A block that is unpacked as a whole.
_LARGEST_CHUNK = 2**28


def listed_hdf5(path: Path, state: FileState, limits: ReadLimits, series: str | None) -> Listing:
    """List the pictures of an HDF5 file; see `ImageFormat`."""
    found: list[StoredArray] = []
    n_objects = 0

    def visited(name: str, thing: Any) -> bool | None:
        nonlocal n_objects
        n_objects += 1
        if hasattr(thing, "chunks") and thing.shape is not None:
            found.append(StoredArray(name, tuple(map(int, thing.shape)), thing.dtype))
        return True if n_objects > _MOST_OBJECTS else None

    with open_regular(path, state) as file, _opened(file) as whole:
        whole.visititems(visited)
        listing = listed_arrays(found, limits, series)
        for name in dict.fromkeys(str(picture.place[0]) for picture in listing.pictures):
            _check(whole[name])
    return listing


def decoded_hdf5(path: Path, state: FileState, picture: Picture, _: ReadLimits) -> NDArray[Any]:
    """Decode a picture of an HDF5 file; see `ImageFormat`."""
    name, index = str(picture.place[0]), int(picture.place[1])
    with open_regular(path, state) as file, _opened(file) as whole:
        data = whole[name]
        _check(data)
        image = np.asarray(data[pictures_index(tuple(data.shape), index)])
    return native(image, picture)


@contextmanager
def _opened(file: BinaryIO) -> Iterator[Any]:
    try:
        import h5py
    except ImportError:
        raise needs_package("an HDF5 file", "hdf5") from None
    with suppress(ImportError):  # more decoders, where somebody has them
        import hdf5plugin  # noqa: F401
    try:
        with h5py.File(file, "r") as whole:
            yield whole
    except ImageFileError:
        raise
    # What the library says of damaged data can be any exception.
    except Exception as error:
        raise damaged(f"it is no whole HDF5 file, {str(error)[:80]}") from None


def _check(data: Any) -> None:
    """Check that a data set lies in the file, in blocks that are unpacked one by one."""
    import h5py

    if data.external or data.is_virtual:
        raise ImageFileError(
            "holds no pictures itself but names other files: give a file that holds them."
        )
    chunk = data.chunks
    if chunk is not None and prod(map(int, chunk)) * data.dtype.itemsize > _LARGEST_CHUNK:
        raise ImageFileError(
            "is packed in blocks that are too large to be unpacked: save it in blocks of one frame."
        )
    plan = data.id.get_create_plist()
    for k in range(plan.get_nfilters()):
        code, _, _, name = plan.get_filter(k)
        if not h5py.h5z.filter_avail(code):
            what = name.decode(errors="replace")[:30] or str(code)
            raise ImageFileError(
                f"is packed with {what}, which needs a decoder that is not installed: "
                "pip install hdf5plugin, or save it with gzip or without compression."
            )
