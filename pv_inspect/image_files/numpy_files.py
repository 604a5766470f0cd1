"""NumPy's files: one array (.npy), or several in a ZIP archive (.npz); never Python objects.

References
----------
numpy.lib.format, versions 1.0 and 2.0.
"""

from __future__ import annotations

import io
import os
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from lzma import LZMAError
from math import prod
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from pv_inspect.image_files.arrays import StoredArray, listed_arrays, native, pictures_index
from pv_inspect.image_files.forward import ForwardReader
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.image_files.picture import Listing, Picture
from pv_inspect.image_files.problems import ImageFileError, damaged
from pv_inspect.image_files.regular import FileState, exactly, open_regular

__all__ = ["decoded_numpy", "listed_numpy"]

Pixels = NDArray[Any]

# A header has some 100 bytes; what is longer describes records.
_LONGEST_HEADER = 4096
_MOST_MEMBERS = 4096
# Frames that lie across each other can only be unpacked together.
_LARGEST_WHOLE = 2**30
_ZIP_PROBLEMS = (
    zipfile.BadZipFile,
    zlib.error,
    LZMAError,
    EOFError,
    NotImplementedError,
    RuntimeError,  # a password is wanted
    ValueError,
    OverflowError,
)
_forward = ForwardReader()


def listed_numpy(path: Path, state: FileState, limits: ReadLimits, series: str | None) -> Listing:
    """List the pictures of a NumPy file; see `ImageFormat`."""
    with open_regular(path, state) as file:
        if not zipfile.is_zipfile(file):
            file.seek(0)
            array, _, _ = _header(file, "")
            _check_length(file, array)
            return listed_arrays([array], limits, series)
        with _archive(file) as archive:
            found, objects = [], False
            for name in _members(archive):
                with archive.open(name) as member:
                    array, _, _ = _header(member, name.removesuffix(".npy"))
                objects |= array.dtype.hasobject
                found.append(array)
    if objects and not any(array.picture_shape for array in found):
        raise _of_objects()
    return listed_arrays(found, limits, series)


def decoded_numpy(path: Path, state: FileState, picture: Picture, _: ReadLimits) -> Pixels:
    """Decode a picture of a NumPy file; see `ImageFormat`."""
    name, index = str(picture.place[0]), int(picture.place[1])
    with open_regular(path, state) as file:
        if zipfile.is_zipfile(file):
            return _out_of_archive(path, state, name, index, picture)
        file.seek(0)
        array, fortran, at = _header(file, name)
        _check_length(file, array)
        index_of = pictures_index(array.shape, index)
        if array.one_by_one and not fortran:
            size = _part_bytes(array)
            data = exactly(file, at + index * size, size)
            image = np.frombuffer(data, array.dtype).reshape(array.shape[1:])[index_of[1:]]
        else:
            order: Literal["F", "C"] = "F" if fortran else "C"
            opened: Any = file
            whole = np.memmap(opened, array.dtype, "r", at, array.shape, order)
            image = np.array(whole[index_of])
        return native(image, picture)


def _out_of_archive(
    path: Path, state: FileState, name: str, index: int, picture: Picture
) -> Pixels:
    """Read from the stream of a member: frame by frame where possible, else as a whole."""

    def begin() -> Iterator[Pixels]:
        with (
            open_regular(path, state) as file,
            _archive(file) as archive,
            archive.open(f"{name}.npy") as member,
        ):
            array, fortran, _ = _header(member, name)
            if array.one_by_one and not fortran:
                rest = pictures_index(array.shape, 0)[1:]
                for _k in range(array.n):
                    data = _all_of(member, _part_bytes(array))
                    values = np.frombuffer(data, array.dtype).reshape(array.shape[1:])
                    yield native(values[rest], picture)
                return
            size = array.dtype.itemsize * prod(array.shape)
            if size > _LARGEST_WHOLE:
                raise ImageFileError(
                    f"holds {size / 1e9:.1f} GB in an order that has to be read as a whole: save "
                    "it with the frames as the first axis."
                )
            whole = np.frombuffer(_all_of(member, size), array.dtype)
            whole = whole.reshape(array.shape, order="F" if fortran else "C")
            for k in range(array.n):
                yield native(whole[pictures_index(array.shape, k)], picture)

    return _forward.picture((path, state, name), index, begin)


def _part_bytes(array: StoredArray) -> int:
    return array.dtype.itemsize * prod(array.shape[1:])


def _members(archive: zipfile.ZipFile) -> list[str]:
    names = archive.namelist()
    if len(names) > _MOST_MEMBERS:
        raise damaged(f"it holds {len(names)} arrays")
    return [name for name in names if name.endswith(".npy")]


@contextmanager
def _archive(file: IO[bytes]) -> Iterator[zipfile.ZipFile]:
    try:
        with zipfile.ZipFile(file) as archive:
            yield archive
    except _ZIP_PROBLEMS as error:
        raise damaged(f"its archive is damaged, {error}") from None
    except KeyError:
        raise damaged("an array is no longer in its archive") from None


def _header(file: IO[bytes], name: str) -> tuple[StoredArray, bool, int]:
    """Return what the header says, whether the first axis varies fastest, and its length."""
    head = file.read(12)
    major = head[6] if len(head) == 12 else 0
    if not head.startswith(b"\x93NUMPY") or major not in (1, 2, 3):
        raise damaged("it is no array of NumPy")
    n_size = 2 if major == 1 else 4
    length = int.from_bytes(head[8 : 8 + n_size], "little")
    text = head[8 + n_size :]
    if not len(text) <= length <= _LONGEST_HEADER:
        raise damaged(f"its header has {length} bytes")
    text += file.read(length - len(text))
    whole = io.BytesIO(head[8 : 8 + n_size] + text)
    read = npy.read_array_header_1_0 if major == 1 else npy.read_array_header_2_0
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that Python 2 has written it
            shape, fortran, dtype = read(whole, max_header_size=_LONGEST_HEADER)
    except Exception:  # the header is parsed as Python's own text, which fails in many ways
        raise damaged("its header is damaged") from None
    if not all(type(n) is int and n >= 0 for n in shape):
        raise damaged("its header is damaged")
    return StoredArray(name, tuple(shape), dtype), bool(fortran), 8 + n_size + length


def _check_length(file: IO[bytes], array: StoredArray) -> None:
    if array.dtype.hasobject:
        raise _of_objects()
    at = file.tell()
    if at + array.dtype.itemsize * prod(array.shape) > file.seek(0, os.SEEK_END):
        raise damaged("the file ends too early")


def _all_of(stream: IO[bytes], size: int) -> bytes:
    data = stream.read(size)
    if len(data) != size:
        raise damaged("an array ends too early")
    return data


def _of_objects() -> ImageFileError:
    return ImageFileError(
        "holds Python objects, which are not read since they can run any program: save plain "
        "numbers."
    )
