"""The tags of a TIFF file's headers: numbers and texts, each found inside of the file.

References
----------
TIFF Revision 6.0, Adobe 1992, section 2; BigTIFF after the design of libtiff.
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from pv_inspect.image_files.problems import damaged
from pv_inspect.image_files.regular import exactly

__all__ = [
    "TiffEntry",
    "TiffLayout",
    "all_values",
    "content_of",
    "entries_at",
    "layout_of",
    "one_value",
    "text_of",
]

# type code: (bytes, format); offsets of IFDs count as whole numbers
_WHOLE = {1: (1, "B"), 3: (2, "H"), 4: (4, "I"), 13: (4, "I"), 16: (8, "Q"), 18: (8, "Q")}
_ASCII = 2
_MOST_ENTRIES = 512


@dataclass(frozen=True)
class TiffLayout:
    """How this file counts: byte order and the widths of its numbers."""

    order: str
    big: bool
    first: int

    def numbers(self, data: bytes, letter: str) -> tuple[int, ...]:
        """Unpack all numbers of one type, given by its letter in `struct`."""
        size = struct.calcsize(letter)
        return struct.unpack(f"{self.order}{len(data) // size}{letter}", data)


@dataclass(frozen=True)
class TiffEntry:
    """One tag: the code of its type, how many values it has, and 4 or 8 bytes."""

    kind: int
    count: int
    # The value itself if it fits, else where it lies.
    field: bytes


def layout_of(file: BinaryIO) -> TiffLayout:
    """Read the first bytes; raises `ImageFileError` if they are not those of a TIFF."""
    file.seek(0)
    head = file.read(16)
    order = {b"II": "<", b"MM": ">"}.get(head[:2])
    if order is None or len(head) < 8:
        raise damaged("it is no TIFF")
    (version,) = struct.unpack(f"{order}H", head[2:4])
    if version == 42:
        return TiffLayout(order, False, struct.unpack(f"{order}I", head[4:8])[0])
    if version == 43 and len(head) == 16:
        width, zero, first = struct.unpack(f"{order}HHQ", head[4:])
        if (width, zero) == (8, 0):
            return TiffLayout(order, True, first)
    raise damaged("it is no TIFF")


def entries_at(file: BinaryIO, layout: TiffLayout, offset: int) -> tuple[dict[int, TiffEntry], int]:
    """Return the tags of the header at ``offset``, and where the next one lies."""
    n_count, letter, size = (8, "Q", 20) if layout.big else (2, "H", 12)
    if offset + n_count > file.seek(0, os.SEEK_END):
        raise damaged("the chain of its pages leads out of the file")
    (n,) = layout.numbers(exactly(file, offset, n_count), letter)
    if not 1 <= n <= _MOST_ENTRIES:
        raise damaged(f"the header of a page has {n} entries")
    word = 8 if layout.big else 4
    data = exactly(file, offset + n_count, n * size + word)
    entry = struct.Struct(f"{layout.order}HH{'Q8s' if layout.big else 'I4s'}")
    found: dict[int, TiffEntry] = {}
    for tag, kind, count, field in entry.iter_unpack(data[:-word]):
        found.setdefault(tag, TiffEntry(kind, count, field))
    (following,) = layout.numbers(data[-word:], "Q" if layout.big else "I")
    return found, following


def content_of(file: BinaryIO, layout: TiffLayout, entry: TiffEntry, item: int) -> bytes:
    """Return the bytes of all values of a tag, ``item`` bytes each."""
    size = item * entry.count
    if item == 0 or size == 0:
        raise damaged("a tag of its header has a wrong type")
    if size <= len(entry.field):
        return entry.field[:size]
    (offset,) = layout.numbers(entry.field, "Q" if layout.big else "I")
    if offset + size > file.seek(0, os.SEEK_END):
        raise damaged("its header leads out of the file")
    return exactly(file, offset, size)


def all_values(
    file: BinaryIO, layout: TiffLayout, entries: dict[int, TiffEntry], tag: int, most: int
) -> NDArray[np.uint64]:
    """All values of a tag, at most ``most``; none if it is missing."""
    entry = entries.get(tag)
    if entry is None:
        return np.empty(0, np.uint64)
    size, _ = _WHOLE.get(entry.kind, (0, ""))
    if entry.count > most:
        raise damaged(f"tag {tag} of its header has {entry.count} values")
    data = content_of(file, layout, entry, size)
    return np.frombuffer(data, np.dtype(f"{layout.order}u{size}")).astype(np.uint64)


def one_value(
    file: BinaryIO,
    layout: TiffLayout,
    entries: dict[int, TiffEntry],
    tag: int,
    default: int | None,
) -> int:
    """Return the first value of a tag; without a default it must not be missing."""
    entry = entries.get(tag)
    if entry is None:
        if default is None:
            raise damaged(f"tag {tag} is missing in its header")
        return default
    size, letter = _WHOLE.get(entry.kind, (0, ""))
    if not 0 < size <= len(entry.field) or entry.count < 1:
        raise damaged(f"tag {tag} of its header has a wrong type")
    if entry.count * size > len(entry.field):  # one value for each channel
        return layout.numbers(content_of(file, layout, entry, size), letter)[0]
    return layout.numbers(entry.field[:size], letter)[0]


def text_of(file: BinaryIO, layout: TiffLayout, entry: TiffEntry | None, most: int) -> bytes:
    """Return the text of a tag; empty if there is none, or more than ``most`` bytes."""
    if entry is None or entry.kind != _ASCII or not 0 < entry.count <= most:
        return b""
    return content_of(file, layout, entry, 1)
