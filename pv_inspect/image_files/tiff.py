"""The pages of a TIFF file: what their headers say, checked, before any pixel is decoded.

The chain of pages is followed with a stop at an offset seen before; other chains (SubIFDs, Exif)
are not followed at all.

References
----------
TIFF Revision 6.0, Adobe 1992, section 2; BigTIFF after the design of libtiff.
"""

from __future__ import annotations

import math
import os
import re
import struct
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from pv_inspect.image_files.limits import ReadLimits, check_size
from pv_inspect.image_files.problems import ImageFileError, damaged, needs_decoder
from pv_inspect.image_files.regular import exactly

__all__ = ["TiffPage", "TiffSegments", "page_at", "page_offsets", "planes_of", "segments_of"]

# type code: (bytes, format); offsets of IFDs count as whole numbers
_WHOLE = {1: (1, "B"), 3: (2, "H"), 4: (4, "I"), 13: (4, "I"), 16: (8, "Q"), 18: (8, "Q")}
_BYTES = {1: 1, 7: 1}
_SUBFILE, _OLD_SUBFILE, _WIDTH, _HEIGHT, _BITS, _COMPRESSION = 254, 255, 256, 257, 258, 259
_PHOTOMETRIC, _FILL_ORDER, _STRIP_OFFSETS, _SAMPLES = 262, 266, 273, 277
_ROWS_PER_STRIP, _STRIP_COUNTS, _PLANAR, _PREDICTOR = 278, 279, 284, 317
_TILE_WIDTH, _TILE_HEIGHT, _TILE_OFFSETS, _TILE_COUNTS = 322, 323, 324, 325
_DESCRIPTION, _ASCII, _LONGEST_DESCRIPTION = 270, 2, 2**20
_SAMPLE_FORMAT, _JPEG_TABLES, _DEPTH, _TILE_DEPTH = 339, 347, 32997, 32998
_KIND = {1: "uint", 2: "int", 3: "float", 4: "uint", 5: "complex int", 6: "complex"}
_MOST_ENTRIES = 512
# A strip for every row, or tiles of 32 x 32 px at the largest size that is read.
_MOST_SEGMENTS = 2**16


@dataclass(frozen=True)
class _Layout:
    """How this file counts: byte order and the widths of its numbers."""

    order: str
    big: bool
    first: int

    def numbers(self, data: bytes, letter: str) -> tuple[int, ...]:
        size = struct.calcsize(letter)
        return struct.unpack(f"{self.order}{len(data) // size}{letter}", data)


@dataclass(frozen=True)
class _Entry:
    kind: int
    count: int
    # The value itself if it fits, else where it lies.
    field: bytes


@dataclass(frozen=True)
class TiffPage:
    """What a page's header says, checked against itself and the limits.

    Parameters
    ----------
    height, width, samples : int
        Size, px, and channels.
    dtype : dtype
        With the file's byte order.
    compression, predictor, photometric : int
        Tag values.
    planar : bool
        Channels one after the other instead of pixel by pixel.
    reversed_bits : bool
        Lowest bit first in each byte.
    tiled : bool
        Tiles instead of strips.
    segment_shape : tuple of int
        (height, width) of a tile or strip, px.
    """

    height: int
    width: int
    samples: int
    dtype: np.dtype[np.generic]
    compression: int
    predictor: int
    photometric: int
    planar: bool
    reversed_bits: bool
    tiled: bool
    segment_shape: tuple[int, int]

    @property
    def pixel_bytes(self) -> int:
        """Bytes of one pixel in all its channels."""
        return self.samples * self.dtype.itemsize

    @property
    def n_segments(self) -> int:
        """Number of tiles or strips."""
        high, wide = self.segment_shape
        count = math.ceil(self.height / high) * math.ceil(self.width / wide)
        return count * (self.samples if self.planar else 1)


@dataclass(frozen=True, eq=False)
class TiffSegments:
    """The tiles or strips of a page, all of them inside of the file.

    Parameters
    ----------
    offsets, counts : (n,) uint64
        Where they lie and how many bytes they have.
    jpeg_tables : bytes
        Tables that all JPEG segments share.
    """

    offsets: NDArray[np.uint64]
    counts: NDArray[np.uint64]
    jpeg_tables: bytes


def page_offsets(file: BinaryIO, most: int) -> list[int]:
    """Return where the headers of the pictures lie; thumbnails are left out.

    Parameters
    ----------
    file : binary file
    most : int
        Largest number of pages.

    Raises
    ------
    ImageFileError
        If it is no TIFF, its chain of pages is broken or leads back, or is longer than ``most``.
    """
    layout = _layout(file)
    offset = layout.first
    found: list[int] = []
    seen: set[int] = set()
    while offset:
        if offset in seen:
            raise damaged(f"its chain of pages leads back to itself after {len(seen)} pages")
        if len(found) == most or len(seen) == 2 * most:
            raise ImageFileError(
                f"has more than {most} pages, but a sequence has about 20 frames: take some of "
                "them, or raise max_frames."
            )
        seen.add(offset)
        entries, following = _entries(file, layout, offset)
        reduced = _one(file, layout, entries, _SUBFILE, 0) & 1
        if not (reduced or _one(file, layout, entries, _OLD_SUBFILE, 1) == 2):
            found.append(offset)
        offset = following
    if not found:
        raise damaged("there is no picture in it")
    return found


def page_at(file: BinaryIO, offset: int, limits: ReadLimits) -> TiffPage:
    """Read the header of one page.

    Raises
    ------
    ImageFileError
        If it contradicts itself, is not in the file as a whole, is too large, or is of a kind that
        is not read.
    """
    layout = _layout(file)
    entries, _ = _entries(file, layout, offset)

    def one(tag: int, default: int | None = None) -> int:
        return _one(file, layout, entries, tag, default)

    height, width, samples = one(_HEIGHT), one(_WIDTH), one(_SAMPLES, 1)
    if one(_DEPTH, 1) != 1 or one(_TILE_DEPTH, 1) != 1:
        raise ImageFileError("holds a volume, but a frame is flat: save every layer as a page.")
    dtype = _dtype(file, layout, entries, samples)
    check_size(height, width, samples * dtype.itemsize, limits)
    tiled = _TILE_OFFSETS in entries or _TILE_WIDTH in entries
    if tiled:
        segment = one(_TILE_HEIGHT), one(_TILE_WIDTH)
        check_size(*segment, samples * dtype.itemsize, limits)
    else:
        segment = min(one(_ROWS_PER_STRIP, height), height) or height, width
    return TiffPage(
        height,
        width,
        samples,
        dtype,
        one(_COMPRESSION, 1),
        one(_PREDICTOR, 1),
        one(_PHOTOMETRIC, 1),
        one(_PLANAR, 1) == 2 and samples > 1,
        one(_FILL_ORDER, 1) == 2,
        tiled,
        segment,
    )


def planes_of(file: BinaryIO, offset: int) -> int:
    """Return how many pictures one header stands for, 1 if it does not say.

    ImageJ writes large stacks as one header with all pictures after the first, without gaps.
    """
    layout = _layout(file)
    entries, _ = _entries(file, layout, offset)
    entry = entries.get(_DESCRIPTION)
    if entry is None or entry.kind != _ASCII or entry.count > _LONGEST_DESCRIPTION:
        return 1
    text = _content(file, layout, entry, 1)
    images = re.search(rb"^images=(\d{1,9})\s*$", text, re.MULTILINE)
    return max(1, int(images[1])) if text.startswith(b"ImageJ=") and images else 1


def segments_of(file: BinaryIO, offset: int, page: TiffPage, plane: int = 0) -> TiffSegments:
    """Find the tiles or strips of a page, or of one of the planes that follow it.

    Raises
    ------
    ImageFileError
        If some are missing or lie outside of the file.
    """
    layout = _layout(file)
    entries, _ = _entries(file, layout, offset)
    what = "tiles" if page.tiled else "strips"
    n, end = page.n_segments, file.seek(0, os.SEEK_END)
    if n > _MOST_SEGMENTS:
        raise damaged(f"it is cut into {n} {what}")
    tags = (_TILE_OFFSETS, _TILE_COUNTS) if page.tiled else (_STRIP_OFFSETS, _STRIP_COUNTS)
    offsets, counts = (_all(file, layout, entries, tag, end) for tag in tags)
    if not counts.size and n == 1 and page.compression == 1:
        counts = np.array([page.height * page.width * page.pixel_bytes], np.uint64)
    if min(offsets.size, counts.size) < n:
        raise damaged(f"it lists {min(offsets.size, counts.size)} of its {n} {what}")
    offsets, counts = offsets[:n], counts[:n]
    if plane:
        offsets = offsets + np.uint64(plane) * _bytes_without_gaps(page, offsets, counts)
    absent = int(np.sum((offsets == 0) | (counts == 0)))
    if absent:
        raise damaged(f"{absent} of its {n} {what} are declared but absent")
    if np.any(counts > end) or np.any(offsets > np.uint64(end) - counts):
        raise damaged("the file ends too early")
    tables = b""
    if _JPEG_TABLES in entries:
        entry = entries[_JPEG_TABLES]
        tables = _content(file, layout, entry, _BYTES.get(entry.kind, 0))
    return TiffSegments(offsets, counts, tables)


def _bytes_without_gaps(
    page: TiffPage, offsets: NDArray[np.uint64], counts: NDArray[np.uint64]
) -> np.uint64:
    """Bytes of a picture that others can follow."""
    size = page.height * page.width * page.pixel_bytes
    follows = np.array_equal(offsets[1:], (offsets + counts)[:-1])
    if page.compression != 1 or page.tiled or not follows or int(counts.sum()) != size:
        raise ImageFileError(
            "says that several pictures follow its first one, but they are packed or have gaps: "
            "save every picture as a page."
        )
    return np.uint64(size)


def _layout(file: BinaryIO) -> _Layout:
    file.seek(0)
    head = file.read(16)
    order = {b"II": "<", b"MM": ">"}.get(head[:2])
    if order is None or len(head) < 8:
        raise damaged("it is no TIFF")
    (version,) = struct.unpack(f"{order}H", head[2:4])
    if version == 42:
        return _Layout(order, False, struct.unpack(f"{order}I", head[4:8])[0])
    if version == 43 and len(head) == 16:
        width, zero, first = struct.unpack(f"{order}HHQ", head[4:])
        if (width, zero) == (8, 0):
            return _Layout(order, True, first)
    raise damaged("it is no TIFF")


def _entries(file: BinaryIO, layout: _Layout, offset: int) -> tuple[dict[int, _Entry], int]:
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
    found: dict[int, _Entry] = {}
    for tag, kind, count, field in entry.iter_unpack(data[:-word]):
        found.setdefault(tag, _Entry(kind, count, field))
    (following,) = layout.numbers(data[-word:], "Q" if layout.big else "I")
    return found, following


def _content(file: BinaryIO, layout: _Layout, entry: _Entry, item: int) -> bytes:
    size = item * entry.count
    if item == 0 or size == 0:
        raise damaged("a tag of its header has a wrong type")
    if size <= len(entry.field):
        return entry.field[:size]
    (offset,) = layout.numbers(entry.field, "Q" if layout.big else "I")
    if offset + size > file.seek(0, os.SEEK_END):
        raise damaged("its header leads out of the file")
    return exactly(file, offset, size)


def _all(
    file: BinaryIO, layout: _Layout, entries: dict[int, _Entry], tag: int, most: int
) -> NDArray[np.uint64]:
    """All values of a tag, at most ``most``; none if it is missing."""
    entry = entries.get(tag)
    if entry is None:
        return np.empty(0, np.uint64)
    size, _ = _WHOLE.get(entry.kind, (0, ""))
    if entry.count > most:
        raise damaged(f"tag {tag} of its header has {entry.count} values")
    data = _content(file, layout, entry, size)
    return np.frombuffer(data, np.dtype(f"{layout.order}u{size}")).astype(np.uint64)


def _one(
    file: BinaryIO,
    layout: _Layout,
    entries: dict[int, _Entry],
    tag: int,
    default: int | None,
) -> int:
    entry = entries.get(tag)
    if entry is None:
        if default is None:
            raise damaged(f"tag {tag} is missing in its header")
        return default
    size, letter = _WHOLE.get(entry.kind, (0, ""))
    if not 0 < size <= len(entry.field) or entry.count < 1:
        raise damaged(f"tag {tag} of its header has a wrong type")
    if entry.count * size > len(entry.field):  # one value for each channel
        return layout.numbers(_content(file, layout, entry, size), letter)[0]
    return layout.numbers(entry.field[:size], letter)[0]


def _dtype(
    file: BinaryIO, layout: _Layout, entries: dict[int, _Entry], samples: int
) -> np.dtype[np.generic]:
    if samples not in (1, 3, 4):
        raise ImageFileError(
            f"has {samples} channels, but a frame is height x width: save every frame as its own "
            "page or file."
        )
    depths = set(_all(file, layout, entries, _BITS, 16).tolist()) or {1}
    kinds = set(_all(file, layout, entries, _SAMPLE_FORMAT, 16).tolist()) or {1}
    if len(depths) > 1 or len(kinds) > 1:
        raise ImageFileError("has channels of different types: export it as grey.")
    (bits,), kind = depths, _KIND.get(kinds.pop(), "unknown")
    if bits % 8 and kind == "uint" and bits < 16:
        raise ImageFileError(
            f"holds {bits}-bit values packed without gaps, but frames are 8- or 16-bit unsigned: "
            "convert it to 16 bits, without scaling."
        )
    try:
        return np.dtype(f"{kind}{bits}").newbyteorder("<" if layout.order == "<" else ">")
    except TypeError:
        raise needs_decoder(f"{kind} values of {bits} bits") from None
