"""Small image files, whole and hostile, made tag by tag."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.sequence.frame_files import expand, read_frame

Tags = dict[int, tuple[int, list[int]]]

_LETTERS = {1: "B", 3: "H", 4: "I"}
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def scene(dtype: str = "uint16", shape: tuple[int, int] = (67, 93)) -> NDArray[np.generic]:
    """Smooth picture with noise, so that predictors and compressions have something to do."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    values = (np.sin(x / 9) + np.cos(y / 7) + 2) / 4.5
    values += np.random.default_rng(0).uniform(0, 0.05, shape)
    kind = np.dtype(dtype)
    return values.astype(kind) if kind.kind == "f" else (values * np.iinfo(kind).max).astype(kind)


def tags(height: int, width: int, data_at: int, size: int, **more: tuple[int, list[int]]) -> Tags:
    """Tags of a grey page of 8 bits in one strip; ``t322=(4, [16])`` sets tag 322."""
    found: Tags = {
        256: (4, [width]),
        257: (4, [height]),
        258: (3, [8]),
        259: (3, [1]),
        262: (3, [1]),
        273: (4, [data_at]),
        277: (3, [1]),
        278: (4, [height]),
        279: (4, [size]),
    }
    found.update({int(name[1:]): value for name, value in more.items()})
    return found


def tiff(pages: Iterable[Tags], data: bytes = b"", following: int | None = None) -> bytes:
    """TIFF with ``data`` at byte 8 and the pages after it.

    ``following`` takes the place of the end of the chain.
    """
    out = bytearray(struct.pack("<2sHI", b"II", 42, 8 + len(data)) + data)
    pages = list(pages)
    for k, page in enumerate(pages):
        head = bytearray(struct.pack("<H", len(page)))
        beyond = bytearray()
        start = len(out) + 2 + 12 * len(page) + 4
        for tag, (kind, values) in sorted(page.items()):
            field = struct.pack(f"<{len(values)}{_LETTERS[kind]}", *values)
            if len(field) > 4:
                where = start + len(beyond)
                beyond += field
                field = struct.pack("<I", where)
            head += struct.pack("<HHI", tag, kind, len(values)) + field.ljust(4, b"\0")
        last = k + 1 == len(pages)
        after = (following or 0) if last else start + len(beyond)
        out += head + struct.pack("<I", after) + beyond
    return bytes(out)


def png(
    height: int,
    width: int,
    lines: bytes,
    bits: int = 8,
    colour: int = 0,
    extra: Iterable[tuple[bytes, bytes]] = (),
) -> bytes:
    """PNG of unfiltered or filtered lines, with further chunks before the picture."""
    head = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    chunks = [(b"IHDR", head), *extra, (b"IDAT", zlib.compress(lines)), (b"IEND", b"")]
    return PNG_SIGNATURE + b"".join(
        struct.pack(">I4s", len(data), kind) + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )


def complaint_of(path: Path, data: bytes, limits: ReadLimits | None = None) -> str:
    """What is said of the first frame of a file with this content; fails if it can be read."""
    path.write_bytes(data)
    try:
        read_frame(expand(path, limits)[0])
    except InspectionError as error:
        return str(error)
    raise AssertionError(f"{path.name} was read")
