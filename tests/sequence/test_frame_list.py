from __future__ import annotations

import os
import socket
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from pv_inspect.errors import InspectionError
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.sequence.frame_files import FrameFile, read_tinted
from pv_inspect.sequence.frame_list import existing_image, list_frames
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from tests.image_files.making import tags, tiff

LIMITS = ReadLimits()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for k in range(3):
        write(tmp_path / "frames" / f"frame_{k}.tif", k)
    return tmp_path / "frames"


def write(path: Path, seed: int = 0, shape: tuple[int, int] = (40, 50)) -> Path:
    path.parent.mkdir(exist_ok=True)
    image = np.random.default_rng(seed).integers(100, 4000, shape).astype(np.uint16)
    tifffile.imwrite(path, image)
    return path


def complaint(source: object) -> str:
    with pytest.raises(InspectionError) as caught:
        list_frames(source, LIMITS)  # type: ignore[arg-type]
    return str(caught.value)


# -- links ----------------------------------------------------------------------------------


def test_a_link_to_a_frame_of_the_same_folder_counts_once_and_is_told(folder: Path) -> None:
    (folder / "frame_99.tif").symlink_to("frame_0.tif")
    found = list_frames(folder, LIMITS)
    assert found.names == ("frame_0.tif", "frame_1.tif", "frame_2.tif")
    assert found.warnings == (
        "frame_99.tif is a link to the same file as frame_0.tif: it counts once.",
    )
    assert FrameSequence.open(folder).warnings == found.warnings


def test_the_file_itself_is_kept_rather_than_a_link_before_it(folder: Path) -> None:
    (folder / "a.tif").symlink_to("frame_1.tif")
    assert list_frames(folder, LIMITS).names == ("frame_0.tif", "frame_1.tif", "frame_2.tif")


def test_two_names_of_one_file_count_once(folder: Path) -> None:
    for k in (7, 8):
        os.link(folder / "frame_0.tif", folder / f"frame_{k}.tif")
    found = list_frames(folder, LIMITS)
    assert found.names == ("frame_0.tif", "frame_1.tif", "frame_2.tif")
    assert "frame_7.tif is a link to the same file as frame_0.tif (and 1 more" in found.warnings[0]


def test_a_folder_of_links_has_the_names_of_the_links(folder: Path, tmp_path: Path) -> None:
    chosen = tmp_path / "chosen"
    chosen.mkdir()
    (chosen / "first.tif").symlink_to(folder / "frame_2.tif")
    (chosen / "second.tif").symlink_to(folder / "frame_0.tif")
    found = list_frames(chosen, LIMITS)
    assert found.names == ("first.tif", "second.tif")
    assert found.warnings == ()


def test_a_list_with_a_file_and_its_link_is_refused(folder: Path) -> None:
    (folder / "link.tif").symlink_to("frame_0.tif")
    said = complaint([folder / "frame_0.tif", folder / "link.tif"])
    assert "link.tif is in the list of frames twice" in said
    assert "frame_1.tif is in the list of frames twice" in complaint([folder / "frame_1.tif"] * 2)


def test_links_that_lead_nowhere_are_told(folder: Path, tmp_path: Path) -> None:
    (folder / "gone.tif").symlink_to("nothing.tif")
    assert "gone.tif is a link to nothing.tif, which is not there" in complaint(folder)
    (folder / "gone.tif").unlink()
    (folder / "circle.tif").symlink_to("circle.tif")
    assert "circle.tif is a link that leads back to itself" in complaint(folder)
    circle = tmp_path / "circle"
    circle.symlink_to(circle)
    assert "is a link that leads back to itself" in complaint(circle)
    assert "does not exist" in complaint(circle / "frames")


# -- what is no file ------------------------------------------------------------------------


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in the file system here")
def test_a_pipe_is_refused_and_never_waited_for(folder: Path) -> None:
    pipe = folder / "pipe.tif"
    os.mkfifo(pipe)
    for source in (folder, pipe, [pipe]):
        assert "pipe.tif is no file but a pipe: leave it out." in complaint(source)
    with pytest.raises(InspectionError, match="is no file but a pipe"):
        FrameSequence.open([folder / "frame_0.tif"], dark_frame=pipe)
    pipe.unlink()
    os.mkfifo(folder / "module.json")
    with pytest.raises(InspectionError, match=r"module\.json is no file but a pipe"):
        FrameSequence.open(folder)


def test_a_socket_and_a_device_are_refused(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)  # the path of a socket is short
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind("socket.tif")
        assert "socket.tif is no file but a socket" in complaint(folder)
    device = tmp_path / "device.tif"
    device.symlink_to("/dev/zero")
    assert "device.tif is no file but a device" in complaint(device)


def test_a_folder_is_no_reference_frame(folder: Path) -> None:
    with pytest.raises(InspectionError, match="is no file but a folder"):
        existing_image(folder)


# -- names ----------------------------------------------------------------------------------


def test_names_are_printable_and_can_be_given_back(folder: Path) -> None:
    write(folder / "bad\x1b[31m\n\u202e.tif", 9)
    sequence = FrameSequence.open(folder)
    shown = r"bad\x1b[31m\n\u202e.tif"
    assert sequence.names[0] == shown
    assert sequence.indices([shown]) == sequence.indices(["bad\x1b[31m\n\u202e.tif"]) == [0]


def test_names_that_are_no_text_can_be_written(folder: Path) -> None:
    (folder / "frame_0.tif").rename(folder / os.fsdecode(b"\xff\xfe.tif"))
    found = list_frames(folder, LIMITS)
    assert r"\udcff\udcfe.tif" in found.names
    "".join(found.names).encode()


def test_names_that_only_look_the_same_are_numbered(folder: Path) -> None:
    write(folder / "a\n.tif", 5)
    write(folder / r"a\n.tif", 6)
    names = list_frames(folder, LIMITS).names
    assert len(set(names)) == 5


# -- too much, changed, gone ----------------------------------------------------------------


def test_too_many_frames_are_refused_before_they_are_read(folder: Path) -> None:
    with pytest.raises(
        InspectionError, match=r"There are more than 2 frames in .*raise max_frames"
    ):
        list_frames(folder, ReadLimits(max_frames=2))


def test_small_files_that_unfold_to_very_much_are_refused_by_their_headers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Each page is within the limits, and all of them share one strip.
    page = tags(5000, 6000, 8, 4)
    (tmp_path / "x.tif").write_bytes(tiff([page] * 300, b"\1\2\3\4"))
    monkeypatch.setattr("pv_inspect.sequence.opening.read_frame", None)
    with pytest.raises(InspectionError, match=r"unfold from 0\.0\d+ MB to 9000 MB"):
        FrameSequence.open(tmp_path / "x.tif")


def test_the_limits_are_settings(folder: Path) -> None:
    limits = Settings(max_frame_mpx=0.01, max_frames=3).read_limits
    assert len(FrameSequence.open(folder, limits=limits)) == 3
    with pytest.raises(InspectionError, match="raise max_frame_mpx"):
        FrameSequence.open([write(folder / "big.tif", shape=(200, 200))], limits=limits)


def test_frames_of_other_sizes_are_refused_before_anything_is_decoded(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(folder / "frame_9.tif", shape=(60, 50))
    monkeypatch.setattr("pv_inspect.sequence.opening.read_tinted", None)
    with pytest.raises(InspectionError, match=r"frame_9\.tif is 50 x 60, the sequence is 50 x 40"):
        FrameSequence.open(folder)


def test_a_frame_that_changes_or_vanishes_is_told(folder: Path) -> None:
    sequence = FrameSequence.open(folder)
    write(folder / "frame_0.tif", 77)
    os.utime(folder / "frame_0.tif", ns=(0, 1))
    with pytest.raises(InspectionError, match=r"frame_0\.tif has changed since it was opened"):
        sequence.frame(0)
    (folder / "frame_1.tif").unlink()
    with pytest.raises(InspectionError, match=r"frame_1\.tif is no longer there"):
        sequence.frame(1)
    (folder / "frame_2.tif").unlink()
    (folder / "frame_2.tif").mkdir()
    with pytest.raises(InspectionError, match=r"frame_2\.tif is no file but a folder"):
        sequence.frame(2)


def test_a_name_that_is_too_long_or_holds_a_null_is_one_sentence(tmp_path: Path) -> None:
    assert "can't be read (File name too long)" in complaint(tmp_path / ("x" * 300))
    assert r"\x00.tif does not exist" in complaint(tmp_path / "\0.tif")
    assert r"\x00.tif is no existing file" in complaint([tmp_path / "\0.tif"])


def test_opening_decodes_every_frame_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    decoded: list[str] = []

    def counted(file: FrameFile) -> Any:
        decoded.append(str(file))
        return read_tinted(file)

    monkeypatch.setattr("pv_inspect.sequence.opening.read_tinted", counted)
    sequence = FrameSequence.open(folder)
    assert len(decoded) == len(set(decoded)) == len(sequence)
