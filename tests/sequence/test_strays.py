from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from pv_inspect.errors import InspectionError
from pv_inspect.sequence.sequence import FrameSequence


def picture(
    seed: int, shape: tuple[int, int] = (60, 80), dtype: str = "uint16"
) -> np.ndarray[tuple[int, int], np.dtype[np.generic]]:
    most = np.iinfo(np.dtype(dtype)).max // 2
    return np.random.default_rng(seed).integers(10, most, shape).astype(dtype)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for k in range(4):
        tifffile.imwrite(tmp_path / f"frame_{k}.tif", picture(k))
    return tmp_path


def names_and_warnings(folder: Path) -> tuple[tuple[str, ...], str]:
    sequence = FrameSequence.open(folder)
    return sequence.names, " ".join(sequence.warnings)


FRAMES = tuple(f"frame_{k}.tif" for k in range(4))


@pytest.mark.parametrize("name", ["preview.png", "overview.tif", "Thumb.jpg", "a.bmp"])
def test_a_picture_of_another_size_and_name_is_left_out_and_said(folder: Path, name: str) -> None:
    cv2.imwrite(str(folder / name), picture(9, (30, 40), "uint8"))
    names, said = names_and_warnings(folder)
    assert names == FRAMES
    kind = {"png": "PNG", "tif": "TIFF", "jpg": "JPEG", "bmp": "BMP"}[name[-3:]]
    assert said == (
        f"{name} is left out: it is {kind} of 40 x 30 px, uint8, and not named like the frames."
    )


def test_a_coloured_rendering_of_the_same_size_is_left_out(folder: Path) -> None:
    grey = cv2.applyColorMap(picture(9, dtype="uint8").astype(np.uint8), cv2.COLORMAP_JET)
    cv2.imwrite(str(folder / "report.png"), grey)
    names, said = names_and_warnings(folder)
    assert names == FRAMES
    assert "report.png is left out: it is PNG of 80 x 60 px, colour" in said


def test_compressed_twins_of_frames_are_left_out(folder: Path) -> None:
    for k in range(4):
        cv2.imwrite(str(folder / f"frame_{k}.jpg"), picture(k, dtype="uint8"))
    names, said = names_and_warnings(folder)
    assert names == FRAMES
    assert said == (
        "frame_0.jpg, frame_1.jpg, frame_2.jpg and 1 more are left out: they have the names of "
        "frames that are stored without loss."
    )


def test_a_frame_of_another_size_that_is_named_like_the_others_is_no_stray(folder: Path) -> None:
    tifffile.imwrite(folder / "frame_4.tif", picture(9, (60, 90)))
    with pytest.raises(InspectionError, match=r"frame_4\.tif is 90 x 60, the sequence is 80 x 60"):
        FrameSequence.open(folder)


def test_where_no_kind_is_that_of_most_files_nothing_is_left_out(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", picture(0))
    tifffile.imwrite(tmp_path / "b.tif", picture(1, (60, 90)))
    with pytest.raises(InspectionError, match="the sequence is"):
        FrameSequence.open(tmp_path)


def test_what_is_given_by_name_is_never_left_out(folder: Path) -> None:
    cv2.imwrite(str(folder / "preview.png"), picture(9, (30, 40), "uint8"))
    with pytest.raises(InspectionError, match=r"preview\.png is 40 x 30"):
        FrameSequence.open(sorted(folder.iterdir()))


def test_a_damaged_picture_is_told_and_not_left_out(folder: Path) -> None:
    (folder / "preview.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    with pytest.raises(InspectionError, match=r"preview\.png can't be read"):
        FrameSequence.open(folder)
