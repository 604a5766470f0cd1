from __future__ import annotations

import os
import threading
from pathlib import Path

import cv2
import numpy as np
import pytest

from pv_inspect.cracks.single_cells import read_cell
from pv_inspect.errors import InspectionError
from pv_inspect.image_files.jpeg import read_photo
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.image_files.native_output import heard_on_stderr, silent_opencv
from tests.image_files.making import scene


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    assert cv2.imwrite(str(tmp_path / "x.jpg"), scene("uint8"))
    return tmp_path / "x.jpg"


def complaint(path: Path, limits: ReadLimits | None = None) -> str:
    with pytest.raises(InspectionError) as caught:
        read_cell(path, limits)
    return str(caught.value)


def test_a_photo_is_what_opencv_reads(photo: Path, tmp_path: Path) -> None:
    expected = cv2.imread(str(photo), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(read_photo(photo, ReadLimits()), expected)
    assert cv2.imwrite(str(tmp_path / "x.bmp"), scene("uint8"))
    np.testing.assert_array_equal(read_photo(tmp_path / "x.bmp", ReadLimits()), scene("uint8"))


def test_damage_that_the_decoder_only_prints_is_told(
    photo: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    data = bytearray(photo.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 40] = bytes(40)
    photo.write_bytes(data)
    assert "x.jpg can't be read (Corrupt JPEG data" in complaint(photo)
    photo.write_bytes(data[:middle])
    assert complaint(photo).startswith("x.jpg can't be read (")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "it is no JPEG"),
        (b"\xff\xd8", "JPEG header is damaged"),
        (b"\xff\xd8\xff\xc0\0\x0b\x0c\0\x10\0\x10\1\1\x11\0", "more than 8 bits"),
        (b"\xff\xd8\xff\xc0\0\x0b\x08\x75\x30\x75\x30\1\1\x11\0", "900 Mpx), more than the 64 Mpx"),
        (b"\x89PNG\r\n\x1a\n", "it is no JPEG"),
        (b"BM" + bytes(60), "its size is 0 x 0"),
        (b"BM" + bytes(16) + b"\x30\x75\0\0\x30\x75\0\0\1\0\x18\0" + bytes(30), "900 Mpx"),
        (b"BM" + bytes(16) + b"\x30\0\0\0\x30\0\0\0\1\0\x18\0" + bytes(30), "ends too early"),
    ],
)
def test_a_header_is_looked_at_before_anything_is_decoded(
    photo: Path, data: bytes, said: str, capfd: pytest.CaptureFixture[str]
) -> None:
    photo.write_bytes(data)
    assert said in complaint(photo)
    assert capfd.readouterr() == ("", "")


def test_a_picture_of_very_many_scans_is_refused(photo: Path) -> None:
    data = photo.read_bytes()
    photo.write_bytes(data[:-2] + b"\xff\xda\0\2" * 200 + data[-2:])
    assert "scans" in complaint(photo)


def test_what_other_threads_print_meanwhile_is_not_lost(capfd: pytest.CaptureFixture[str]) -> None:
    begun, printed = threading.Event(), threading.Event()

    def other() -> None:
        begun.wait()
        os.write(2, b"from elsewhere\n")
        printed.set()

    def action() -> int:
        begun.set()
        printed.wait()
        os.write(2, b"ours\n")
        return 5

    thread = threading.Thread(target=other)
    thread.start()
    result = heard_on_stderr(action, lambda line: line.startswith("ours"))
    thread.join()
    assert result == (5, ["ours"])
    assert capfd.readouterr().err == "from elsewhere\n"


def test_more_than_a_pipe_holds_does_not_block() -> None:
    def action() -> None:
        for _ in range(3000):
            try:
                os.write(2, b"x" * 99 + b"\n")
            except BlockingIOError:
                return

    assert len(heard_on_stderr(action, lambda _: True)[1]) >= 600


def test_opencv_is_silent_as_long_as_anyone_wants_it() -> None:
    before = cv2.utils.logging.getLogLevel()
    with silent_opencv():
        with silent_opencv():
            pass
        assert cv2.utils.logging.getLogLevel() == cv2.utils.logging.LOG_LEVEL_SILENT
    assert cv2.utils.logging.getLogLevel() == before
