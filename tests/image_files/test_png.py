from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from pv_inspect.sequence.frame_files import expand, read_frame
from tests.image_files.making import PNG_SIGNATURE, complaint_of, png, scene


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_pixels_are_those_that_were_written(tmp_path: Path, dtype: str) -> None:
    image = scene(dtype)
    assert cv2.imwrite(str(tmp_path / "x.png"), image)
    np.testing.assert_array_equal(read_frame(expand(tmp_path / "x.png")[0]), image)


@pytest.mark.parametrize("mode", ["L", "LA", "RGB", "RGBA", "P"])
def test_grey_in_other_clothes_is_grey(tmp_path: Path, mode: str) -> None:
    image = scene("uint8")
    grey = Image.fromarray(image)
    if mode == "P":
        grey.putpalette([value for level in range(256) for value in (level,) * 3])
    else:
        grey = grey.convert(mode)
    grey.save(tmp_path / "x.png")
    np.testing.assert_array_equal(read_frame(expand(tmp_path / "x.png")[0]), image)


def test_an_interlaced_picture_is_read(tmp_path: Path) -> None:
    # A picture of one value: each of the 7 passes holds lines of it.
    h, w = 11, 13
    lines = b""
    for x, y, right, down in (
        (0, 0, 8, 8),
        (4, 0, 8, 8),
        (0, 4, 4, 8),
        (2, 0, 4, 4),
        (0, 2, 2, 4),
        (1, 0, 2, 2),
        (0, 1, 1, 2),
    ):
        lines += (b"\0" + b"\x4d" * len(range(x, w, right))) * len(range(y, h, down))
    data = bytearray(png(h, w, lines))
    data[28] = 1
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    (tmp_path / "x.png").write_bytes(data)
    read = read_frame(expand(tmp_path / "x.png")[0])
    assert read.shape == (h, w)
    assert np.all(read == 0x4D)


LINES = bytes(11) * 10


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (png(10, 10, LINES[:-5]), "compressed data hold 105 of 110 bytes"),
        (png(10, 10, bytes([7]) + LINES[1:]), "filtered in an unknown way"),
        (png(10, 10, LINES, bits=7), "its PNG header is wrong"),
        (png(0, 10, LINES), "its size is 10 x 0"),
        (png(10, 10, LINES, colour=3), "its palette is wrong"),
        (png(10, 10, LINES, extra=[(b"ABCD", b"")]), "unknown part that is needed"),
        (png(10, 10, LINES).replace(b"IDAT", b"iDAT"), "compressed data"),
        (png(10, 10, LINES)[:-12], "the file ends too early"),
        (png(10, 10, LINES)[:20], "the file ends too early"),
        (b"\xff\xd8\xff\xe0 a JPEG", "no PNG signature"),
        (png(30000, 30000, LINES), r"900 Mpx), more than the 64 Mpx that are read"),
        (png(7000, 7000, LINES, bits=16, colour=6), "of 8 bytes each, more than the 64 Mpx"),
    ],
)
def test_what_is_wrong_is_said_and_nothing_reaches_the_terminal(
    tmp_path: Path, data: bytes, said: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert said in complaint_of(tmp_path / "x.png", data)
    assert capfd.readouterr() == ("", "")


def test_notes_beside_the_picture_are_not_looked_at(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    # libpng would print a warning for each of them.
    wrong = [(b"iCCP", b"sRGB\0\0broken"), (b"gAMA", b"\0"), (b"tEXt", b"x" * 5000)]
    (tmp_path / "x.png").write_bytes(png(10, 10, LINES, extra=wrong))
    assert read_frame(expand(tmp_path / "x.png")[0]).shape == (10, 10)
    assert capfd.readouterr() == ("", "")


def test_a_stream_that_unfolds_to_more_than_its_picture_is_cut(tmp_path: Path) -> None:
    (tmp_path / "x.png").write_bytes(png(10, 10, LINES + bytes(50_000_000)))
    assert read_frame(expand(tmp_path / "x.png")[0]).shape == (10, 10)


def test_a_picture_in_very_many_parts_is_refused(tmp_path: Path) -> None:
    whole = png(10, 10, LINES)
    empty = struct.pack(">I4sI", 0, b"IDAT", zlib.crc32(b"IDAT"))
    data = whole[:33] + empty * 2**18 + whole[33:]
    assert whole.startswith(PNG_SIGNATURE)
    assert "is cut into more than" in complaint_of(tmp_path / "x.png", data)
