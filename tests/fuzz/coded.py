"""PNG files whose checksums are right and whose chunks are not; JPEG and BMP with wrong heads."""

from __future__ import annotations

import struct
import zlib

import hypothesis.strategies as st

from tests.fuzz import seeds
from tests.fuzz.raw import BOMB, damaged, numbers

__all__ = ["jpegs", "png_of", "pngs"]


def _chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    found, at = [], 8
    while at < len(data):
        size = int.from_bytes(data[at : at + 4])
        found.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + size]))
        at += 12 + size
    return found


def _joined(chunks: list[tuple[bytes, bytes]]) -> bytes:
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        len(content).to_bytes(4) + name + content + zlib.crc32(name + content).to_bytes(4)
        for name, content in chunks
    )


def png_of(width: int, height: int, pixels: bytes) -> bytes:
    """Return a PNG with these compressed pixels, whether or not they are enough."""
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return _joined([(b"IHDR", head), (b"IDAT", pixels), (b"IEND", b"")])


_ICC = b"name\0\0" + zlib.compress(b"\0" * 128)
_EXTRA = (
    (b"PLTE", bytes(768)),
    (b"PLTE", b"\1\2"),
    (b"tRNS", b"\0\1"),
    (b"gAMA", b"\0\0\0\0"),
    (b"cHRM", bytes(32)),
    (b"sBIT", b"\xff"),
    (b"iCCP", _ICC),
    (b"tEXt", b"Comment\0" + b"x" * 5000),
    (b"zTXt", b"Comment\0\0" + BOMB),
    (b"eXIf", b"MM\0*" + b"\0" * 20),
    (b"acTL", struct.pack(">II", 2**31 - 1, 0)),
    (b"fcTL", struct.pack(">IIIIIHHBB", 0, 80, 60, 2**31, 2**31, 0, 0, 9, 9)),
    (b"fdAT", b"\0\0\0\1abc"),
    (b"IDAT", b""),
    (b"IDAT", BOMB),
    (b"IHDR", struct.pack(">IIBBBBB", 80, 60, 8, 0, 0, 0, 0)),
    (b"IEND", b""),
    (b"XXXX", b"unknown"),
)


@st.composite
def pngs(draw: st.DrawFn) -> bytes:
    """PNG files whose checksums are right and whose chunks are not."""
    data = draw(st.sampled_from(seeds.pngs()))
    if draw(st.integers(0, 3)) == 0:
        return draw(damaged(data))
    chunks = _chunks(data)
    for _ in range(draw(st.integers(0, 3))):
        where = draw(st.integers(0, len(chunks) - 1)) if chunks else 0
        kind = draw(st.sampled_from(("header", "header", "add", "drop", "swap", "content")))
        if kind == "header" and chunks and len(chunks[0][1]) == 13:
            head = list(struct.unpack(">IIBBBBB", chunks[0][1]))
            at = draw(st.integers(0, 6))
            head[at] = draw(numbers) % (2**32 if at < 2 else 20)
            chunks[0] = (chunks[0][0], struct.pack(">IIBBBBB", *head))
        elif kind == "add":
            chunks.insert(where, draw(st.sampled_from(_EXTRA)))
        elif kind == "drop" and chunks:
            del chunks[where]
        elif kind == "swap" and chunks:
            other = draw(st.integers(0, len(chunks) - 1))
            chunks[where], chunks[other] = chunks[other], chunks[where]
        elif kind == "content" and chunks and chunks[where][1]:
            chunks[where] = (chunks[where][0], draw(damaged(chunks[where][1], 1)))
    return _joined(chunks)


@st.composite
def jpegs(draw: st.DrawFn) -> bytes:
    """JPEG and BMP files, most of them with wrong numbers in their heads."""
    data = draw(st.sampled_from(seeds.jpegs()))
    changed = bytearray(data)
    if data[:2] == b"BM":
        at, size, order = draw(st.integers(0, 60)), draw(st.sampled_from((2, 4))), "little"
    else:
        segments = [i for i in range(len(data) - 9) if data[i] == 0xFF and data[i + 1] >= 0xC0]
        at = draw(st.sampled_from(segments)) + draw(st.integers(0, 9))
        size, order = draw(st.sampled_from((1, 2))), "big"
    number = draw(numbers) % 2 ** (8 * size)
    changed[at : at + size] = number.to_bytes(size, order)
    return bytes(changed) if draw(st.booleans()) else draw(damaged(bytes(changed)))
