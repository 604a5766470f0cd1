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
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from pv_inspect.image_files.limits import ReadLimits, check_size
from pv_inspect.image_files.orientation import known_orientation, turned_shape
from pv_inspect.image_files.problems import ImageFileError, damaged, needs_decoder
from pv_inspect.image_files.tiff_tags import (
    TiffEntry,
    TiffLayout,
    all_values,
    content_of,
    entries_at,
    layout_of,
    one_value,
)

__all__ = ["TiffPage", "TiffSegments", "page_at", "page_offsets", "segments_of"]

_BYTES = {1: 1, 7: 1}
_SUBFILE, _OLD_SUBFILE, _WIDTH, _HEIGHT, _BITS, _COMPRESSION = 254, 255, 256, 257, 258, 259
_PHOTOMETRIC, _FILL_ORDER, _STRIP_OFFSETS, _ORIENTATION, _SAMPLES = 262, 266, 273, 274, 277
_ROWS_PER_STRIP, _STRIP_COUNTS, _PLANAR, _PREDICTOR = 278, 279, 284, 317
_TILE_WIDTH, _TILE_HEIGHT, _TILE_OFFSETS, _TILE_COUNTS = 322, 323, 324, 325
_SAMPLE_FORMAT, _JPEG_TABLES, _DEPTH, _TILE_DEPTH = 339, 347, 32997, 32998
_KIND = {1: "uint", 2: "int", 3: "float", 4: "uint", 5: "complex int", 6: "complex"}
_JPEG = 7
# A strip for every row, or tiles of 32 x 32 px at the largest size that is read.
_MOST_SEGMENTS = 2**16


@dataclass(frozen=True)
class TiffPage:
    """What a page's header says, checked against itself and the limits.

    Parameters
    ----------
    height, width, samples : int
        Size, px, and channels.
    dtype : dtype
        With the file's byte order.
    bits : int
        Of a value: those of the type, or 9 to 15 packed without gaps.
    orientation : int
        How the picture is shown; 1 for as it is stored.
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
    bits: int
    orientation: int
    compression: int
    predictor: int
    photometric: int
    planar: bool
    reversed_bits: bool
    tiled: bool
    segment_shape: tuple[int, int]

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) as it is shown, px."""
        return turned_shape(self.height, self.width, self.orientation)

    @property
    def lossy(self) -> bool:
        """Whether the compression has changed the values."""
        return self.compression == _JPEG

    @property
    def packed(self) -> bool:
        """Whether values follow each other without regard to bytes; lines begin with a byte."""
        return self.bits != 8 * self.dtype.itemsize

    def line_bytes(self, width: int, channels: int) -> int:
        """Bytes of one line of pixels before any compression."""
        return (width * channels * self.bits + 7) // 8

    @property
    def picture_bytes(self) -> int:
        """Bytes of all pixels before any compression, in strips."""
        if self.planar:
            return self.samples * self.height * self.line_bytes(self.width, 1)
        return self.height * self.line_bytes(self.width, self.samples)

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
    layout = layout_of(file)
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
        entries, following = entries_at(file, layout, offset)
        reduced = one_value(file, layout, entries, _SUBFILE, 0) & 1
        if not (reduced or one_value(file, layout, entries, _OLD_SUBFILE, 1) == 2):
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
    layout = layout_of(file)
    entries, _ = entries_at(file, layout, offset)

    def one(tag: int, default: int | None = None) -> int:
        return one_value(file, layout, entries, tag, default)

    height, width, samples = one(_HEIGHT), one(_WIDTH), one(_SAMPLES, 1)
    if one(_DEPTH, 1) != 1 or one(_TILE_DEPTH, 1) != 1:
        raise ImageFileError("holds a volume, but a frame is flat: save every layer as a page.")
    dtype, bits = _dtype(file, layout, entries, samples)
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
        bits,
        known_orientation(one(_ORIENTATION, 1)),
        one(_COMPRESSION, 1),
        one(_PREDICTOR, 1),
        one(_PHOTOMETRIC, 1),
        one(_PLANAR, 1) == 2 and samples > 1,
        one(_FILL_ORDER, 1) == 2,
        tiled,
        segment,
    )


def segments_of(file: BinaryIO, offset: int, page: TiffPage, plane: int = 0) -> TiffSegments:
    """Find the tiles or strips of a page, or of one of the planes that follow it.

    Raises
    ------
    ImageFileError
        If some are missing or lie outside of the file.
    """
    layout = layout_of(file)
    entries, _ = entries_at(file, layout, offset)
    what = "tiles" if page.tiled else "strips"
    n, end = page.n_segments, file.seek(0, os.SEEK_END)
    if n > _MOST_SEGMENTS:
        raise damaged(f"it is cut into {n} {what}")
    tags = (_TILE_OFFSETS, _TILE_COUNTS) if page.tiled else (_STRIP_OFFSETS, _STRIP_COUNTS)
    offsets, counts = (all_values(file, layout, entries, tag, end) for tag in tags)
    if not counts.size and n == 1 and page.compression == 1:
        counts = np.array([page.picture_bytes], np.uint64)
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
        tables = content_of(file, layout, entry, _BYTES.get(entry.kind, 0))
    return TiffSegments(offsets, counts, tables)


def _bytes_without_gaps(
    page: TiffPage, offsets: NDArray[np.uint64], counts: NDArray[np.uint64]
) -> np.uint64:
    """Bytes of a picture that others can follow."""
    size = page.picture_bytes
    follows = np.array_equal(offsets[1:], (offsets + counts)[:-1])
    if page.compression != 1 or page.tiled or not follows or int(counts.sum()) != size:
        raise ImageFileError(
            "says that several pictures follow its first one, but they are packed or have gaps: "
            "save every picture as a page."
        )
    return np.uint64(size)


def _dtype(
    file: BinaryIO, layout: TiffLayout, entries: dict[int, TiffEntry], samples: int
) -> tuple[np.dtype[np.generic], int]:
    """Return the type of the decoded values, and how many bits a stored one has."""
    if samples not in (1, 3, 4):
        raise ImageFileError(
            f"has {samples} channels, but a frame is height x width: save every frame as its own "
            "page or file."
        )
    depths = set(all_values(file, layout, entries, _BITS, 16).tolist()) or {1}
    kinds = set(all_values(file, layout, entries, _SAMPLE_FORMAT, 16).tolist()) or {1}
    if len(depths) > 1 or len(kinds) > 1:
        raise ImageFileError("has channels of different types: export it as grey.")
    (bits,), kind = depths, _KIND.get(kinds.pop(), "unknown")
    if kind == "uint" and bits < 8:
        raise ImageFileError(
            f"holds {bits}-bit values, but frames have at least 8 bits: export what the camera "
            "delivered, without scaling."
        )
    stored = 16 if kind == "uint" and 8 < bits < 16 else bits
    try:
        return np.dtype(f"{kind}{stored}").newbyteorder("<" if layout.order == "<" else ">"), bits
    except TypeError:
        raise needs_decoder(f"{kind} values of {bits} bits") from None
