"""The pixels of one TIFF page: tiles or strips unpacked one by one, each bounded and whole."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from pv_inspect.image_files.byte_coding import (
    lzma_bytes,
    lzw,
    packbits,
    unpacked_bits,
    unpacked_zlib,
)
from pv_inspect.image_files.jpeg import decoded_jpeg, with_tables
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.image_files.orientation import turned
from pv_inspect.image_files.problems import damaged, needs_decoder
from pv_inspect.image_files.regular import exactly
from pv_inspect.image_files.tiff import TiffPage, page_at, segments_of

__all__ = ["page_pixels"]

Pixels = NDArray[Any]

_NONE, _LZW, _JPEG, _PACKBITS = 1, 5, 7, 32773
_BYTE_CODINGS = {
    _LZW: lzw,
    8: unpacked_zlib,
    32946: unpacked_zlib,
    _PACKBITS: packbits,
    34925: lzma_bytes,
}
_OTHERS = {
    2: "CCITT fax",
    3: "CCITT fax",
    4: "CCITT fax",
    6: "JPEG in TIFF of before 1995",
    32809: "ThunderScan",
    33003: "JPEG 2000",
    33005: "JPEG 2000",
    34712: "JPEG 2000",
    34887: "LERC",
    34892: "lossy JPEG of DNG",
    34926: "Zstandard",
    34933: "PNG in TIFF",
    34934: "JPEG XR",
    50000: "Zstandard",
    50001: "WebP",
    50002: "JPEG XL",
    52546: "JPEG XL",
}
_WHITE_IS_ZERO = 0
_REVERSED = np.array([int(f"{byte:08b}"[::-1], 2) for byte in range(256)], np.uint8)


def page_pixels(file: BinaryIO, offset: int, limits: ReadLimits, plane: int = 0) -> Pixels:
    """Decode the page whose header lies at ``offset``, or the ``plane``-th picture after it.

    Returns
    -------
    (height, width) or (height, width, samples), in the machine's byte order
        As it is shown. Grey where white is stored as zero is turned round.

    Raises
    ------
    ImageFileError
        If the pixels are damaged or incomplete, or nothing here decodes them.
    """
    page = page_at(file, offset, limits)
    coding = page.compression
    if coding not in (_NONE, _JPEG) and coding not in _BYTE_CODINGS:
        raise needs_decoder(f"{_OTHERS.get(coding, 'TIFF')} (compression {coding})")
    if page.predictor not in (1, 2) or (
        page.predictor == 2 and (page.dtype.kind == "f" or page.packed)
    ):
        what = f"{page.bits}-bit" if page.packed else f"{page.dtype}"
        raise needs_decoder(f"differences of kind {page.predictor} between {what} values")
    segments = segments_of(file, offset, page, plane)
    shape = page.height, page.width, page.samples
    image = np.empty(shape, page.dtype.newbyteorder("="))
    listed = zip(segments.offsets.tolist(), segments.counts.tolist(), _places(page), strict=True)
    for at, size, (rows, cols, channels) in listed:
        data = exactly(file, at, size)
        if page.reversed_bits:
            data = _REVERSED[np.frombuffer(data, np.uint8)].tobytes()
        here = image[rows, cols, channels]
        here[:] = _segment(data, page, segments.jpeg_tables, here.shape)
    if page.photometric == _WHITE_IS_ZERO and page.dtype.kind in "ui":
        np.invert(image, out=image)
        if page.packed:
            image &= 2**page.bits - 1
    return turned(image[..., 0] if page.samples == 1 else image, page.orientation)


def _places(page: TiffPage) -> Iterator[tuple[slice, slice, slice]]:
    high, wide = page.segment_shape
    planes = [slice(k, k + 1) for k in range(page.samples)] if page.planar else [slice(None)]
    for plane in planes:
        for top in range(0, page.height, high):
            for left in range(0, page.width, wide):
                bottom, right = min(top + high, page.height), min(left + wide, page.width)
                yield slice(top, bottom), slice(left, right), plane


def _segment(data: bytes, page: TiffPage, tables: bytes, shape: tuple[int, ...]) -> Pixels:
    """Decode one tile or strip to ``shape``, (rows, columns, channels)."""
    rows, cols, channels = shape
    high, wide = page.segment_shape
    if page.compression == _JPEG:
        picture = decoded_jpeg(with_tables(tables, data), (high, wide))
        picture = picture[..., None] if picture.ndim == 2 else picture
        if picture.dtype != page.dtype or picture.shape[2] != channels:
            raise damaged("its JPEG data are of another kind than its header")
        if picture.shape[0] < rows or picture.shape[1] < cols:
            raise damaged("its JPEG data are smaller than its header says")
        return picture[:rows, :cols]
    line = page.line_bytes(wide, channels)
    least = (rows - 1) * line + page.line_bytes(cols, channels)
    if page.compression != _NONE:
        data = _BYTE_CODINGS[page.compression](data, least, high * line)
    if len(data) < least:
        raise damaged(f"a part of its pixels has {len(data)} of {least} bytes")
    lines = np.zeros(rows * line, np.uint8)
    kept = np.frombuffer(data, np.uint8)[: rows * line]
    lines[: len(kept)] = kept
    if page.packed:
        return unpacked_bits(lines.reshape(rows, line), wide * channels, page.bits).reshape(
            rows, wide, channels
        )[:, :cols]
    values = lines.view(page.dtype).reshape(rows, wide, channels)
    if page.predictor == 2:
        values = values.astype(page.dtype.newbyteorder("="), copy=False)
        values = np.add.accumulate(values, axis=1, dtype=values.dtype)
    return values[:, :cols]
