from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image, ImageOps

from pv_inspect.errors import InspectionError
from pv_inspect.image_files.jpeg import read_photo
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.image_files.orientation import exif_orientation, turned
from pv_inspect.sequence.frame_files import expand, read_frame
from pv_inspect.sequence.sequence import FrameSequence
from tests.image_files.making import scene

ORIENTATIONS = range(1, 9)


@pytest.mark.parametrize("orientation", ORIENTATIONS)
@pytest.mark.parametrize("how", ["raw", "tiff_lzw", "tiff_adobe_deflate"])
def test_a_tiff_is_turned_alike_however_it_is_stored(
    tmp_path: Path, orientation: int, how: str
) -> None:
    path, image = tmp_path / "x.tif", Image.fromarray(scene("uint16"))
    image.save(path, compression="tiff_lzw", tiffinfo={274: orientation})
    # Pillow turns what libtiff decodes the way that viewers do.
    shown = np.asarray(Image.open(path))
    image.save(path, compression=how, tiffinfo={274: orientation})
    (file,) = expand(path)
    assert file.shape == shown.shape
    assert file.picture.orientation == orientation
    np.testing.assert_array_equal(read_frame(file), shown)


@pytest.mark.parametrize("orientation", ORIENTATIONS)
@pytest.mark.parametrize("order", ["<", ">"])
def test_a_photo_is_turned_as_viewers_do(tmp_path: Path, orientation: int, order: str) -> None:
    path = tmp_path / "x.jpg"
    exif = Image.Exif()
    exif.endian = order
    exif[274] = orientation
    Image.fromarray(scene("uint8")).save(path, quality=95, exif=exif)
    shown = np.asarray(ImageOps.exif_transpose(Image.open(path)))
    (file,) = expand(path)
    assert file.shape == shown.shape
    assert np.abs(read_frame(file).astype(int) - shown).max() <= 1
    np.testing.assert_array_equal(read_photo(path, ReadLimits()), read_frame(file))


@pytest.mark.parametrize(
    "exif",
    [
        b"",
        b"Exif\0\0",
        b"Exif\0\0II*\0\xff\xff\xff\xff",
        b"Exif\0\0II*\0\x08\0\0\0\xff\xff\x12\x01",
        b"Exif\0\0XX" + bytes(30),
        b"Exif\0\0II*\0\x08\0\0\0\1\0" + struct.pack("<HHIHH", 274, 3, 1, 77, 0),
    ],
)
def test_a_broken_exif_part_turns_nothing(exif: bytes) -> None:
    segment = b"\xff\xe1" + (len(exif) + 2).to_bytes(2) + exif
    assert exif_orientation(b"\xff\xd8" + segment + b"\xff\xda") == 1
    assert exif_orientation(b"\xff\xd8\xff") == 1


def test_turning_twice_by_opposite_ways_is_nothing() -> None:
    image = scene("uint8")
    assert turned(image, 1) is image
    for one, other in ((2, 2), (3, 3), (4, 4), (5, 5), (6, 8), (7, 7)):
        np.testing.assert_array_equal(turned(turned(image, one), other), image)


def test_what_was_turned_is_said(tmp_path: Path) -> None:
    for k in range(3):
        image = np.random.default_rng(k).integers(0, 4000, (40, 50)).astype(np.uint16)
        tifffile.imwrite(tmp_path / f"f_{k}.tif", image, extratags=[(274, "H", 1, 6, True)])
    sequence = FrameSequence.open(tmp_path)
    assert sequence.shape == (50, 40)
    assert any("turned by 90 degrees clockwise" in text for text in sequence.warnings)
    tifffile.imwrite(tmp_path / "f_1.tif", image, extratags=[(274, "H", 1, 8, True)])
    told = FrameSequence.open(tmp_path).warnings
    assert any("different orientation tags" in text for text in told)
    tifffile.imwrite(tmp_path / "f_1.tif", image)
    with pytest.raises(InspectionError, match=r"f_1\.tif is 50 x 40, the sequence is 40 x 50"):
        FrameSequence.open(tmp_path)
