"""Bytes that are damaged, and TIFF files whose directories do not say the truth."""

from __future__ import annotations

import struct
import zlib

import hypothesis.strategies as st

from tests.fuzz import seeds

__all__ = ["BOMB", "NUMBERS", "damaged", "numbers", "tiffs"]

# Where sizes, counts and signs go wrong.
NUMBERS = (
    *(0, 1, 2, 3, 4, 5, 7, 8, 9, 12, 16, 17, 24, 31, 32, 33, 47, 48, 59, 60, 61, 64, 80, 127, 128),
    *(255, 256, 1000, 32767, 32768, 40000, 65535, 65536, 10**6, 2**24, 2**30, 2**31 - 1, 2**31),
    *(2**32 - 2, 2**32 - 1, 2**32, 2**48, 2**62, 2**63 - 1, 2**63, 2**64 - 1),
)
numbers = st.sampled_from(NUMBERS)


def _bomb() -> bytes:
    squeeze = zlib.compressobj(9)
    return b"".join([*(squeeze.compress(bytes(2**20)) for _ in range(64)), squeeze.flush()])


BOMB = _bomb()
"""Little that becomes much: 64 MiB of zeros."""


@st.composite
def damaged(draw: st.DrawFn, data: bytes, most: int = 3) -> bytes:
    """Bytes with up to ``most`` damages that know nothing of the format."""
    changed = bytearray(data)
    for _ in range(draw(st.integers(1, most))):
        at = draw(st.integers(0, max(len(changed) - 1, 0)))
        kind = draw(st.sampled_from(("bit", "byte", "number", "cut", "drop", "double", "splice")))
        if kind == "cut":
            del changed[at:]
        elif kind == "drop":
            del changed[at : at + draw(st.integers(1, 64))]
        elif kind == "double":
            changed[at:at] = changed[at : at + draw(st.integers(1, 64))]
        elif kind == "splice":
            other = draw(st.integers(0, max(len(changed) - 1, 0)))
            size = draw(st.integers(1, 64))
            changed[at : at + size] = changed[other : other + size]
        elif changed[at : at + 1]:
            if kind == "bit":
                changed[at] ^= 1 << draw(st.integers(0, 7))
            elif kind == "byte":
                changed[at] = draw(st.integers(0, 255))
            else:
                size = draw(st.sampled_from((2, 4, 8)))
                order = draw(st.sampled_from(("little", "big")))
                number = draw(numbers) % 2 ** (8 * size)
                changed[at : at + size] = number.to_bytes(size, order)
    return bytes(changed)


def _fields(data: bytes) -> tuple[str, list[tuple[int, int]]]:
    """Byte order, and (offset, size) of every number in the directories of a TIFF."""
    order = "<" if data[:2] == b"II" else ">"
    big = struct.unpack(order + "H", data[2:4])[0] == 43
    n_code, o_code = ("Q", "Q") if big else ("H", "I")
    n_size, o_size = struct.calcsize(n_code), struct.calcsize(o_code)
    found = [(2, 2), (8 if big else 4, o_size)]

    def number(at: int, code: str) -> int:
        return int(struct.unpack_from(order + code, data, at)[0])

    at = number(found[1][0], o_code)
    while at:
        count = number(at, n_code)
        found.append((at, n_size))
        entry = at + n_size
        for _ in range(count):
            found += [(entry, 2), (entry + 2, 2), (entry + 4, o_size)]
            kind, n = number(entry + 2, "H"), number(entry + 4, o_code)
            size = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 16: 8}.get(kind, 1)
            value = entry + 4 + o_size
            if n * size <= o_size:
                found.append((value, size))
            else:
                found.append((value, o_size))
                beside = number(value, o_code)
                found += [(beside + k * size, min(size, 8)) for k in range(min(n, 8))]
            entry += 4 + 2 * o_size
        found.append((entry, o_size))
        at = number(entry, o_code)
    return order, [(at, size) for at, size in found if at + size <= len(data)]


_TIFF_FIELDS = [_fields(data) for data in seeds.tiffs()]


@st.composite
def tiffs(draw: st.DrawFn) -> bytes:
    """TIFF files: damaged, with wrong numbers in their directories, or made up."""
    kind = draw(st.sampled_from(("whole", "damaged", "field", "field", "field", "made", "made")))
    if kind == "made":
        return draw(_made_up_tiffs())
    which = draw(st.integers(0, len(seeds.tiffs()) - 1))
    data = seeds.tiffs()[which]
    if kind == "whole":
        return data
    if kind == "damaged":
        return draw(damaged(data))
    order, fields = _TIFF_FIELDS[which]
    changed = bytearray(data)
    for _ in range(draw(st.integers(1, 3))):
        at, size = draw(st.sampled_from(fields))
        other = draw(st.sampled_from(fields))[0]  # for offsets that lead back
        old = int.from_bytes(changed[at : at + size], "little" if order == "<" else "big")
        number = draw(
            st.one_of(
                numbers,
                st.sampled_from((old + 1, abs(old - 1), 2 * old, len(data), len(data) - 1, other)),
                st.integers(250, 340),  # tags
            )
        )
        wrong = (number % 2 ** (8 * size)).to_bytes(size, "little" if order == "<" else "big")
        changed[at : at + size] = wrong
    return bytes(changed)


_SIZES = st.one_of(
    st.sampled_from((1, 2, 31, 32, 33, 48, 60, 80, 100)),
    st.sampled_from((0, 1000, 20000, 65535, 100000, 2**31 - 1, 2**32 - 1)),
)


@st.composite
def _made_up_tiffs(draw: st.DrawFn) -> bytes:
    """A TIFF of directories whose entries need not agree with each other or with the pixels."""
    order = draw(st.sampled_from("<>"))
    body = bytearray(b"II*\0" if order == "<" else b"MM\0*") + bytearray(4)
    plain = bytes(range(256)) * draw(st.sampled_from((0, 1, 8, 19, 75)))
    packed = draw(st.sampled_from(("plain", "deflate", "bomb")))
    pixels = {"plain": plain, "deflate": zlib.compress(plain), "bomb": BOMB}[packed]
    pixels_at = len(body)
    body += pixels
    starts, links = [], [4]
    for _ in range(draw(st.integers(1, 4))):
        width, height = draw(_SIZES), draw(_SIZES)
        bits = draw(st.sampled_from((8, 16, 16, 1, 2, 4, 10, 12, 14, 24, 32, 64, 0, 65535)))
        samples = draw(st.sampled_from((1, 1, 1, 2, 3, 4, 0, 65535)))
        entries: dict[int, tuple[str, list[int]]] = {
            254: ("I", [draw(st.sampled_from((0, 0, 0, 1, 2, 4, 2**32 - 1)))]),
            256: ("I", [width]),
            257: ("I", [height]),
            258: ("H", [bits] * min(max(samples, 1), 4)),
            259: (
                "H",
                [draw(st.sampled_from((1, 8, 8, 5, 7, 6, 2, 3, 4, 32773, 50000, 34925, 0, 9)))],
            ),
            262: ("H", [draw(st.sampled_from((0, 1, 1, 2, 3, 6, 8, 32844, 65535)))]),
            277: ("H", [samples]),
            284: ("H", [draw(st.sampled_from((1, 1, 2, 0, 7)))]),
            317: ("H", [draw(st.sampled_from((1, 1, 2, 3, 34892, 0)))]),
            339: ("H", [draw(st.sampled_from((1, 1, 2, 3, 4, 5, 6, 0)))]),
        }
        n = draw(st.sampled_from((1, 1, 1, 2, 8, 0)))
        length = draw(st.sampled_from((len(pixels), len(pixels) // max(n, 1), 0, 1, 2**32 - 1)))
        at = draw(st.sampled_from((pixels_at, pixels_at, 0, 1, 2**32 - 1)))
        if draw(st.booleans()):
            entries |= {273: ("I", [at] * n), 279: ("I", [length] * n)}
            entries[278] = ("I", [draw(st.one_of(st.just(height), _SIZES))])
        else:
            entries |= {324: ("I", [at] * n), 325: ("I", [length] * n)}
            entries |= {322: ("I", [draw(_SIZES)]), 323: ("I", [draw(_SIZES)])}
        for tag in draw(st.lists(st.sampled_from(sorted(entries)), max_size=2)):
            entries.pop(tag, None)
        directory = bytearray(struct.pack(order + "H", len(entries)))
        for tag, (code, values) in sorted(entries.items()):
            content = struct.pack(order + code * len(values), *values)
            if len(content) > 4:
                content, beside = struct.pack(order + "I", len(body)), content
                body += beside
            head = struct.pack(order + "HHI", tag, 3 if code == "H" else 4, len(values))
            directory += head + content.ljust(4, b"\0")
        starts.append(len(body))
        links.append(len(body) + len(directory))
        body += directory + bytearray(4)
    for link, start in zip(links, starts, strict=False):
        body[link : link + 4] = struct.pack(order + "I", start)
    last = draw(st.sampled_from((0, 0, 0, *starts, 2, len(body))))
    body[links[-1] : links[-1] + 4] = struct.pack(order + "I", last)
    return bytes(body)
