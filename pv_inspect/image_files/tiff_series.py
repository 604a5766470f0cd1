"""The pictures of a TIFF file: its pages, pages that stand for several, and series of them.

Programs say in the text of a page which pages belong together (OME-XML, tifffile's shapes), and
that one header stands for several pictures that follow without gaps (ImageJ, tifffile).
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO
from xml.parsers.expat import ExpatError, ParserCreate

from numpy.typing import NDArray

from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.image_files.picture import Listing, Picture
from pv_inspect.image_files.problems import ImageFileError
from pv_inspect.image_files.regular import FileState, open_regular
from pv_inspect.image_files.series import Series, chosen_series, left_out
from pv_inspect.image_files.tiff import TiffPage, page_at, page_offsets
from pv_inspect.image_files.tiff_pixels import page_pixels
from pv_inspect.image_files.tiff_tags import entries_at, layout_of, text_of

__all__ = ["decoded_tiff", "listed_tiff"]

_DESCRIPTION = 270
# Of the first page, which may tell of all others; of another one.
_LONGEST_TEXT, _LONGEST_NOTE = 2**20, 2**12
_IMAGEJ = re.compile(rb"^images=(\d{1,9})\s*$", re.MULTILINE)
_LABELS = re.compile(r"\b(label|macro|thumbnail|overview|preview)\b", re.IGNORECASE)


@dataclass
class _Part:
    """Pages that belong together."""

    pages: list[int]
    name: str = ""


def listed_tiff(path: Path, state: FileState, limits: ReadLimits, series: str | None) -> Listing:
    """List the pictures of a TIFF file; see `ImageFormat`."""
    with open_regular(path, state) as file:
        offsets = page_offsets(file, limits.max_frames)
        pages = [page_at(file, offset, limits) for offset in offsets]
        texts = [
            _text(file, offset, _LONGEST_NOTE if k else _LONGEST_TEXT)
            for k, offset in enumerate(offsets)
        ]
    planes = _planes(texts[0], pages[0])
    if planes > limits.max_frames:
        raise ImageFileError(
            f"has {planes} pictures, more than the {limits.max_frames} that are read "
            "as one sequence: take some of them, or raise max_frames."
        )
    if planes > 1 and len(pages) == 1:
        return Listing(tuple(_picture(pages[0], offsets[0], plane) for plane in range(planes)))
    if texts[0].startswith(b"ImageJ=") and planes > len(pages):
        raise ImageFileError(
            f"says that it has {planes} pictures, but has {len(pages)} pages: save it again, or "
            "every picture as a page."
        )
    parts = _parts(pages, texts)
    found = [
        Series(
            part.name, len(part.pages), page.shape, page.dtype.newbyteorder("="), _coloured(page)
        )
        for part in parts
        for page in (pages[part.pages[0]],)
    ]
    chosen = chosen_series(found, series)
    pictures = tuple(_picture(pages[k], offsets[k]) for k in parts[chosen].pages)
    return Listing(pictures, left_out(found, chosen))


def decoded_tiff(
    path: Path, state: FileState, picture: Picture, limits: ReadLimits
) -> NDArray[Any]:
    """Decode a picture of a TIFF file; see `ImageFormat`."""
    offset, plane = map(int, picture.place)
    with open_regular(path, state) as file:
        return page_pixels(file, offset, limits, plane)


def _picture(page: TiffPage, offset: int, plane: int = 0) -> Picture:
    return Picture(
        page.shape,
        page.dtype.newbyteorder("="),
        (offset, plane),
        page.bits if page.packed else 0,
        _coloured(page),
        page.lossy,
        page.orientation,
    )


def _coloured(page: TiffPage) -> bool:
    return page.samples > 1


def _text(file: BinaryIO, offset: int, most: int) -> bytes:
    layout = layout_of(file)
    entries, _ = entries_at(file, layout, offset)
    return text_of(file, layout, entries.get(_DESCRIPTION), most)


def _planes(text: bytes, page: TiffPage) -> int:
    """How many pictures the first header stands for, 1 if it does not say."""
    if text.startswith(b"ImageJ="):
        images = _IMAGEJ.search(text)
        return max(1, int(images[1])) if images else 1
    about = _shaped(text)
    if about is None or not about.get("truncated"):
        return 1
    values = math.prod(map(int, about["shape"]))
    return max(1, values // (page.height * page.width * page.samples))


def _shaped(text: bytes) -> dict[str, Any] | None:
    """What tifffile notes of a series, None if it has not."""
    if not text.startswith(b'{"shape":'):
        return None
    try:
        about = json.loads(text.rstrip(b"\0"))
    except (ValueError, RecursionError):
        return None
    shape = about.get("shape") if isinstance(about, dict) else None
    if not isinstance(shape, list) or not 2 <= len(shape) <= 8:
        return None
    if not all(type(n) is int and 0 < n < 2**32 for n in shape):
        return None
    return dict(about)


def _parts(pages: list[TiffPage], texts: list[bytes]) -> list[_Part]:
    """Group the pages: by what the texts say, and in any case by size and type."""
    split: list[_Part] = []
    for part in _noted(pages, texts):
        of_kind: dict[object, _Part] = {}
        for k in part.pages:
            of_kind.setdefault(_kind(pages[k]), _Part([], part.name)).pages.append(k)
        split += of_kind.values()
    # Frames that were written one by one are one series, whatever they are called.
    several = [part for part in split if len(part.pages) > 1]
    joined: dict[object, _Part] = {}
    for part in split:
        kind = _kind(pages[part.pages[0]])
        alike = [other for other in several if _kind(pages[other.pages[0]]) == kind]
        if len(part.pages) == 1 and len(alike) <= 1 and not _LABELS.search(part.name):
            joined.setdefault(kind, _Part([])).pages += part.pages
        elif len(alike) == 1 and part is alike[0]:
            joined.setdefault(kind, _Part([])).pages += part.pages
            joined[kind].name = part.name
        else:
            joined[id(part)] = part
    return sorted(joined.values(), key=lambda part: min(part.pages))


def _kind(page: TiffPage) -> object:
    return page.shape, page.dtype, page.bits, page.samples


def _noted(pages: list[TiffPage], texts: list[bytes]) -> list[_Part]:
    """Series that the texts tell of; all pages in one if they tell of none."""
    everything = list(range(len(pages)))
    counts = _ome_images(texts[0])
    if counts and sum(n for _, n in counts) == len(pages):
        found, first = [], 0
        for name, n in counts:
            found.append(_Part(everything[first : first + n], name))
            first += n
        return found
    starts = [k for k, text in enumerate(texts) if _shaped(text) is not None]
    if starts[:1] == [0]:
        return [
            _Part(everything[first:last])
            for first, last in zip(starts, [*starts[1:], len(pages)], strict=True)
        ]
    return [_Part(everything)]


def _ome_images(text: bytes) -> list[tuple[str, int]]:
    """(name, number of planes) of every image that an OME-XML text tells of."""
    if b"OME" not in text[:2000]:
        return []
    images: list[tuple[str, list[int]]] = []

    def started(element: str, given: dict[str, str]) -> None:
        name = element.rpartition(":")[2]
        if name == "Image":
            images.append((given.get("Name", ""), [1, 1]))
        elif name == "Pixels" and images:
            sizes = (given.get(key, "1") for key in ("SizeZ", "SizeC", "SizeT"))
            images[-1][1][0] = math.prod(_small(size) for size in sizes)
        elif name == "Channel" and images:
            images[-1][1][1] = max(1, _small(given.get("SamplesPerPixel", "1")))

    def refused(*_: object) -> None:  # entities of a document type can fill the memory
        raise ValueError("document type")

    parser = ParserCreate()
    parser.StartElementHandler = started
    parser.StartDoctypeDeclHandler = refused
    try:
        parser.Parse(text.rstrip(b"\0"), True)
    except (ExpatError, ValueError):
        return []
    return [(name, max(1, planes // samples)) for name, (planes, samples) in images]


def _small(number: str) -> int:
    return int(number) if number.isdecimal() and number.isascii() and len(number) < 8 else 0
