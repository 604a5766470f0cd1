"""Decoders of TIFF's compressed bytes; each gives what is wanted or says that it is damaged.

OpenCV has them too, but fills what is missing with zeros and says nothing.

References
----------
TIFF Revision 6.0, Adobe 1992, sections 9 (PackBits) and 13 (LZW).
"""

from __future__ import annotations

import lzma
import zlib
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.compiling import compiled
from pv_inspect.image_files.problems import damaged, needs_decoder

__all__ = ["lzma_bytes", "lzw", "packbits", "unpacked_bits", "unpacked_zlib"]

Bytes = NDArray[np.uint8]

# xz can demand gigabytes for its dictionary; the usual presets need less than 70 MB.
_LZMA_MEMORY = 128 * 2**20
# Values that are unpacked at a time: 3 arrays of 4 bytes for each.
_VALUES_AT_A_TIME = 2**20
_CLEAR, _END, _FIRST_CODE, _MOST_CODES = 256, 257, 258, 4096


def unpacked_zlib(data: bytes, least: int, most: int) -> bytes:
    """Inflate up to ``most`` bytes; the checksum is verified unless there are more than that.

    Raises
    ------
    ImageFileError
        If the stream is damaged or holds less than ``least`` bytes.
    """
    stream = zlib.decompressobj()
    try:
        found = stream.decompress(data, most)
        # Whatever follows: more data, or the checksum, which is compared now.
        more = b"" if stream.eof else stream.decompress(stream.unconsumed_tail, 1)
        if not (stream.eof or more):
            raise damaged("its compressed data end too early")
    except zlib.error as error:
        raise damaged(f"its compressed data are damaged, {error}") from None
    return _enough(found, least)


def lzma_bytes(data: bytes, least: int, most: int) -> bytes:
    """Unpack LZMA; parameters and errors as for `unpacked_zlib`."""
    try:
        found = lzma.LZMADecompressor(memlimit=_LZMA_MEMORY).decompress(data, most)
    except lzma.LZMAError as error:
        raise damaged(f"its compressed data are damaged, {error}") from None
    return _enough(found, least)


def lzw(data: bytes, least: int, most: int) -> bytes:
    """Unpack LZW; parameters and errors as for `unpacked_zlib`."""
    if len(data) > 1 and data[0] == 0 and data[1] & 1:
        raise needs_decoder("LZW of before 1992, with its bits reversed")
    return _compiled(_lzw, data, least, most)


def packbits(data: bytes, least: int, most: int) -> bytes:
    """Unpack run lengths; parameters and errors as for `unpacked_zlib`."""
    return _compiled(_packbits, data, least, most)


def unpacked_bits(lines: Bytes, n_values: int, bits: int) -> NDArray[np.uint16]:
    """Unpack values of 9 to 15 bits that follow each other without gaps, highest bit first.

    Parameters
    ----------
    lines : (n_lines, n_bytes) uint8
        Each line begins with a byte of its own.
    n_values : int
        Values of a line.
    bits : int

    Returns
    -------
    (n_lines, n_values) uint16
    """
    at = np.arange(n_values) * bits
    first, shift = at >> 3, np.asarray(24 - bits - (at & 7), np.uint32)
    out = np.empty((len(lines), n_values), np.uint16)
    step = max(1, _VALUES_AT_A_TIME // max(n_values, 1))
    for top in range(0, len(lines), step):
        # A value lies in three bytes at most; the last ones of a line have none after them.
        part = np.pad(lines[top : top + step], ((0, 0), (0, 2)))
        word = part[:, first].astype(np.uint32)
        for k in (1, 2):
            word = (word << np.uint32(8)) | part[:, first + k]
        out[top : top + step] = (word >> shift) & np.uint32(2**bits - 1)
    return out


def _compiled(decode: Callable[[Bytes, Bytes], int], data: bytes, least: int, most: int) -> bytes:
    out = np.empty(most, np.uint8)
    count = decode(np.frombuffer(data, np.uint8), out)
    if count < 0:
        raise damaged("its compressed data are damaged")
    return _enough(out[:count].tobytes(), least)


def _enough(found: bytes, least: int) -> bytes:
    if len(found) < least:
        raise damaged(f"its compressed data hold {len(found)} of {least} bytes")
    return found


@compiled(nogil=True)
def _lzw(data: Bytes, out: Bytes) -> int:  # pragma: no cover
    """Number of bytes written to ``out``; -1 for a code that can't be."""
    prefix = np.zeros(_MOST_CODES, np.int32)
    last = np.zeros(_MOST_CODES, np.uint8)
    first = np.zeros(_MOST_CODES, np.uint8)
    length = np.ones(_MOST_CODES, np.int32)
    for code in range(256):
        last[code] = first[code] = code
    free, width, old = _FIRST_CODE, 9, -1
    bits, n_bits, at = 0, 0, 0
    for byte in data:
        bits = (bits << 8) | int(byte)
        n_bits += 8
        if n_bits < width:
            continue
        n_bits -= width
        code = bits >> n_bits
        bits &= (1 << n_bits) - 1
        if code == _END or at == out.size:
            break
        if code == _CLEAR:
            free, width, old = _FIRST_CODE, 9, -1
            continue
        if old < 0:
            if code > 255:
                return -1
        else:
            if code > free or (code == free and free == _MOST_CODES):
                return -1
            if free < _MOST_CODES:
                prefix[free] = old
                first[free] = first[old]
                last[free] = first[code] if code < free else first[old]
                length[free] = length[old] + 1
                free += 1
                if free == (1 << width) - 1 and width < 12:
                    width += 1
        end = at + length[code]
        link, place = code, end - 1
        while place >= at:
            if place < out.size:
                out[place] = last[link]
            link = prefix[link]
            place -= 1
        at = min(end, out.size)
        old = code
    return at


@compiled(nogil=True)
def _packbits(data: Bytes, out: Bytes) -> int:  # pragma: no cover
    """Number of bytes written to ``out``; -1 if a run is cut."""
    i, at = 0, 0
    while i < data.size and at < out.size:
        head = int(data[i])
        i += 1
        if head == 128:
            continue
        if head < 128:
            count = head + 1
            if i + count > data.size:
                return -1
            for k in range(min(count, out.size - at)):
                out[at + k] = data[i + k]
            i += count
        else:
            count = 257 - head
            if i >= data.size:
                return -1
            for k in range(min(count, out.size - at)):
                out[at + k] = data[i]
            i += 1
        at = min(at + count, out.size)
    return at
