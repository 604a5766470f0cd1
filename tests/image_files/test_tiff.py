from __future__ import annotations

import io
import tracemalloc
import zlib
from pathlib import Path
from time import process_time

import cv2
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image

from pv_inspect.errors import InspectionError
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.sequence.frame_files import expand, read_floats, read_frame
from tests.image_files.making import complaint_of, scene, tags, tiff

# -- the same pixels, however they are stored -----------------------------------------------


STORED: list[dict[str, object]] = [
    {},
    {"rowsperstrip": 7},
    {"tile": (32, 48), "bigtiff": True},
    {"predictor": True},
    {"predictor": True, "tile": (32, 48)},
    {"photometric": "rgb", "planarconfig": "separate"},
    {"photometric": "rgb", "planarconfig": "contig", "predictor": True, "rowsperstrip": 7},
]


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
@pytest.mark.parametrize(
    ("compression", "stored"),
    # Without compression there is no predictor.
    [(c, s) for c in (None, "zlib", "lzma") for s in STORED if c or "predictor" not in s],
    ids=str,
)
@pytest.mark.parametrize("order", ["<", ">"])
def test_pixels_are_those_that_tifffile_wrote(
    dtype: str, compression: str | None, stored: dict[str, object], order: str, tmp_path: Path
) -> None:
    image = scene(dtype)
    written = image
    if "photometric" in stored:
        axis = 0 if stored["planarconfig"] == "separate" else -1
        written = np.stack([image] * 3, axis=axis)
    else:
        stored = {**stored, "photometric": "minisblack"}
    path = tmp_path / "x.tif"
    tifffile.imwrite(path, written, compression=compression, byteorder=order, **stored)
    read = read_frame(expand(path)[0])
    assert read.dtype == image.dtype
    np.testing.assert_array_equal(read, image)


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
@pytest.mark.parametrize("coding", [1, 5, 8, 32773])
@pytest.mark.parametrize("kind", ["scene", "noise", "flat"])
def test_pixels_are_those_that_libtiff_wrote(
    dtype: str, coding: int, kind: str, tmp_path: Path
) -> None:
    # Noise fills LZW's table several times over; a flat picture has codes that are not there yet.
    image = scene(dtype, (160, 200))
    if kind == "noise":
        most = np.iinfo(image.dtype).max
        image = np.random.default_rng(1).integers(0, most, image.shape, image.dtype)
    elif kind == "flat":
        image = np.full_like(image, 77)
    path = tmp_path / "x.tif"
    assert cv2.imwrite(str(path), image, [cv2.IMWRITE_TIFF_COMPRESSION, coding])
    np.testing.assert_array_equal(read_frame(expand(path)[0]), image)


def test_a_jpeg_in_a_tiff_is_the_picture_that_the_decoder_makes_of_it(tmp_path: Path) -> None:
    image = scene("uint8", (64, 96))
    path = tmp_path / "x.tif"
    Image.fromarray(image).save(path, compression="jpeg")
    expected = np.asarray(Image.open(path))
    assert np.abs(read_frame(expand(path)[0]).astype(int) - expected).max() <= 1


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_floating_values_are_read_as_they_are(dtype: str, tmp_path: Path) -> None:
    image = scene(dtype)
    image[3, 4] = np.nan
    tifffile.imwrite(tmp_path / "x.tif", image, compression="zlib", byteorder=">")
    read = read_floats(expand(tmp_path / "x.tif")[0])
    assert read.dtype == image.dtype
    np.testing.assert_array_equal(read, image)


def test_bits_in_the_other_order_are_turned_round(tmp_path: Path) -> None:
    data = bytes([0b00000001, 0b10000000, 0b00010010])
    page = tags(1, 3, 8, 3, t266=(3, [2]))
    (tmp_path / "x.tif").write_bytes(tiff([page], data))
    read = read_frame(expand(tmp_path / "x.tif")[0])
    assert read.tolist() == [[0b10000000, 0b00000001, 0b01001000]]


@pytest.mark.parametrize("bits", range(9, 16))
@pytest.mark.parametrize("width", [93, 64])
@pytest.mark.parametrize("packing", ["strips", "deflate", "tiles", "white is zero"])
def test_packed_values_are_unpacked(tmp_path: Path, bits: int, width: int, packing: str) -> None:
    height = 40
    values = np.random.default_rng(bits).integers(0, 2**bits, (height, width), np.uint16)
    high, wide = (16, 32) if packing == "tiles" else (13, width)
    parts = []
    for top in range(0, height, high):
        for left in range(0, width, wide):
            part = np.zeros((high, wide), np.uint16)
            here = values[top : top + high, left : left + wide]
            part[: here.shape[0], : here.shape[1]] = here
            rows = part if packing == "tiles" else part[: here.shape[0]]
            parts.append(b"".join(packed_line(row, bits) for row in rows))
    if packing == "deflate":
        parts = [zlib.compress(part) for part in parts]
    at = np.cumsum([8, *map(len, parts)])[:-1].tolist()
    page = tags(height, width, 8, 0, t258=(3, [bits]), t273=(4, at), t278=(4, [high]))
    page |= {279: (4, [len(part) for part in parts])}
    if packing == "tiles":
        page |= {324: page.pop(273), 325: page.pop(279), 322: (4, [wide]), 323: (4, [high])}
    elif packing == "deflate":
        page[259] = (3, [8])
    elif packing == "white is zero":
        page[262], values = (3, [0]), (2**bits - 1) - values
    (tmp_path / "x.tif").write_bytes(tiff([page], b"".join(parts)))
    (file,) = expand(tmp_path / "x.tif")
    assert (file.dtype, file.picture.bits) == (np.uint16, bits)
    np.testing.assert_array_equal(read_frame(file), values)


def packed_line(row: NDArray[np.uint16], bits: int) -> bytes:
    text = "".join(f"{value:0{bits}b}" for value in row.tolist())
    return bytes(int(text[k : k + 8].ljust(8, "0"), 2) for k in range(0, len(text), 8))


def test_packed_values_that_end_early_are_told(tmp_path: Path) -> None:
    page = tags(10, 9, 8, 139, t258=(3, [12]))
    said = complaint_of(tmp_path / "x.tif", tiff([page], bytes(139)))
    assert "a part of its pixels has 139 of 140 bytes" in said


def test_thumbnails_are_no_frames(tmp_path: Path) -> None:
    data = bytes(range(12))
    pages = [tags(3, 4, 8, 12), tags(1, 2, 8, 2, t254=(4, [1])), tags(3, 4, 8, 12)]
    (tmp_path / "x.tif").write_bytes(tiff(pages, data))
    assert [file.label("x.tif") for file in expand(tmp_path / "x.tif")] == ["x.tif[0]", "x.tif[1]"]


def test_pictures_that_share_one_header_are_all_frames(tmp_path: Path) -> None:
    stack = np.stack([scene("uint16") + np.uint16(k) for k in range(5)])
    path = tmp_path / "x.tif"
    tifffile.imwrite(path, stack, imagej=True, truncate=True)
    files = expand(path)
    assert [file.label("x.tif") for file in files] == [f"x.tif[{k}]" for k in range(5)]
    np.testing.assert_array_equal(np.stack([read_frame(file) for file in files]), stack)
    path.write_bytes(path.read_bytes()[:-3])
    with pytest.raises(InspectionError, match=r"x\.tif\[4\] can't be read \(the file ends"):
        read_frame(expand(path)[4])


def test_pictures_that_only_a_note_tells_of_are_not_lost_in_silence(tmp_path: Path) -> None:
    path = tmp_path / "x.tif"
    note = "ImageJ=1.11a\nimages=3\n"
    tifffile.imwrite(path, scene("uint16"), compression="zlib", description=note, metadata=None)
    with pytest.raises(InspectionError, match="several pictures follow its first one"):
        [read_frame(file) for file in expand(path)]
    tifffile.imwrite(path, scene("uint16"), description=f"{note[:-1]}000000\n", metadata=None)
    with pytest.raises(InspectionError, match="has 3000000 pictures, more than the 1000"):
        expand(path)


# -- what is refused ------------------------------------------------------------------------


@pytest.mark.parametrize("back_to", [0, 1, 2])
def test_a_chain_of_pages_that_leads_back_is_told(tmp_path: Path, back_to: int) -> None:
    page = tags(2, 2, 8, 4)
    size = 2 + 12 * len(page) + 4
    data = tiff([page] * 3, b"\1\2\3\4", following=12 + back_to * size)
    assert "leads back to itself after 3 pages" in complaint_of(tmp_path / "x.tif", data)


def test_sub_directories_that_lead_back_are_not_followed(tmp_path: Path) -> None:
    path = tmp_path / "x.tif"
    path.write_bytes(tiff([tags(2, 2, 8, 4, t330=(4, [12]), t34665=(4, [12]))], b"\1\2\3\4"))
    assert read_frame(expand(path)[0]).tolist() == [[1, 2], [3, 4]]


def test_a_chain_that_leads_out_of_the_file_is_told(tmp_path: Path) -> None:
    data = tiff([tags(2, 2, 8, 4)], b"\1\2\3\4", following=10**6)
    assert "leads out of the file" in complaint_of(tmp_path / "x.tif", data)


@pytest.mark.parametrize(("offset", "count"), [(0, 4), (8, 0), (0, 0)])
def test_strips_that_are_declared_but_absent_are_told(
    tmp_path: Path, offset: int, count: int
) -> None:
    page = tags(4, 2, 8, 4, t273=(4, [8, offset]), t278=(4, [2]), t279=(4, [4, count]))
    said = complaint_of(tmp_path / "x.tif", tiff([page], b"\1\2\3\4"))
    assert "1 of its 2 strips are declared but absent" in said


def test_tiles_that_are_declared_but_absent_are_told(tmp_path: Path) -> None:
    page = tags(32, 16, 8, 256, t322=(4, [16]), t323=(4, [16]))
    del page[273], page[278], page[279]
    page |= {324: (4, [8, 0]), 325: (4, [256, 0])}
    said = complaint_of(tmp_path / "x.tif", tiff([page], bytes(256)))
    assert "1 of its 2 tiles are declared but absent" in said
    page |= {324: (4, [8]), 325: (4, [256])}
    assert "it lists 1 of its 2 tiles" in complaint_of(tmp_path / "x.tif", tiff([page], bytes(256)))


@pytest.mark.parametrize(
    ("coding", "data"),
    [
        (1, bytes(50)),
        (8, zlib.compress(bytes(50))),
        (8, zlib.compress(bytes(100))[:-2]),
        (32773, b"\xcf\x07"),
        (32773, b"\x63abc"),
        (5, b"\x80\x00\x00\x10\x10"),
    ],
)
def test_pixels_that_are_missing_are_never_filled(tmp_path: Path, coding: int, data: bytes) -> None:
    page = tags(10, 10, 8, len(data), t259=(3, [coding]))
    assert "can't be read (" in complaint_of(tmp_path / "x.tif", tiff([page], data))


@pytest.mark.parametrize(
    ("page", "said"),
    [
        ({258: (3, [1])}, "1-bit values, but frames have at least 8 bits"),
        ({258: (3, [12]), 259: (3, [5]), 317: (3, [2])}, "differences of kind 2 between 12-bit"),
        ({258: (3, [24])}, "uint values of 24 bits, which needs a decoder that is not installed"),
        ({339: (3, [6]), 258: (3, [64])}, "complex64 values, but frames are whole or floating"),
        ({277: (3, [7])}, "has 7 channels, but a frame is height x width"),
        ({32997: (4, [5])}, "holds a volume"),
        ({259: (3, [50000])}, "Zstandard (compression 50000), which needs a decoder"),
        ({259: (3, [34712])}, "JPEG 2000 (compression 34712), which needs a decoder"),
        ({259: (3, [999])}, "TIFF (compression 999), which needs a decoder"),
        ({259: (3, [5]), 317: (3, [3])}, "differences of kind 3"),
        ({256: (4, [0])}, "its size is 0 x 10"),
        ({256: (4, [200_000])}, "is 200000 x 10 px, but no side may be longer than 100000 px"),
        ({256: (2, [10])}, "tag 256 of its header has a wrong type"),
    ],
)
def test_other_kinds_are_named_and_not_called_damaged(
    tmp_path: Path, page: dict[int, tuple[int, list[int]]], said: str
) -> None:
    wrong = {256: (1, [10])} if page.get(256, (0,))[0] == 2 else page
    data = tiff([tags(10, 10, 8, 100) | wrong], bytes(100))
    if wrong is not page:  # a text instead of a number
        data = data.replace(b"\0\1\1\0\1\0\0\0\n", b"\0\1\2\0\1\0\0\0\n")
    told = complaint_of(tmp_path / "x.tif", data)
    assert said in told
    assert told.startswith("x.tif ")


def test_lzw_of_the_first_days_is_no_damage(tmp_path: Path) -> None:
    page = tags(10, 10, 8, 4, t259=(3, [5]))
    assert "needs a decoder" in complaint_of(tmp_path / "x.tif", tiff([page], b"\0\1\2\3"))


# -- what claims to be large ----------------------------------------------------------------


@pytest.mark.parametrize(
    "page",
    [
        tags(30000, 30000, 8, 4),
        tags(90000, 99000, 8, 4),
        tags(6000, 6000, 8, 4, t258=(3, [16] * 4), t277=(3, [4])),
        tags(100, 100, 8, 4, t322=(4, [60000]), t323=(4, [60000]), t324=(4, [8]), t325=(4, [4])),
    ],
)
def test_a_huge_picture_is_refused_by_its_header(
    page: dict[int, tuple[int, list[int]]], tmp_path: Path
) -> None:
    tracemalloc.start()
    said = complaint_of(tmp_path / "x.tif", tiff([page], b"\1\2\3\4"))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert "the 64 Mpx" in said
    assert "raise max_frame_mpx" in said
    assert peak < 2**20


def test_the_limit_on_the_size_is_a_setting(tmp_path: Path) -> None:
    data = tiff([tags(200, 200, 8, 40000)], bytes(40000))
    said = complaint_of(tmp_path / "x.tif", data, ReadLimits(max_frame_mpx=0.03))
    assert "is 200 x 200 px (0.04 Mpx), more than the 0.03 Mpx" in said
    assert read_frame(expand(tmp_path / "x.tif", ReadLimits(0.05))[0]).shape == (200, 200)


@pytest.mark.parametrize("coding", ["zlib", "lzma"])
def test_a_strip_that_unfolds_to_more_than_its_picture_takes_no_more_memory(
    tmp_path: Path, coding: str
) -> None:
    whole = io.BytesIO()
    tifffile.imwrite(whole, np.zeros((4096, 8192), np.uint8), compression=coding, rowsperstrip=4096)
    whole.seek(0)
    with tifffile.TiffFile(whole) as file:
        page = file.pages[0]
        at, size = page.dataoffsets[0], page.databytecounts[0]
        packed, number = whole.getvalue()[at : at + size], int(page.compression)
    small = tags(16, 16, 8, size, t259=(3, [number]))
    (tmp_path / "x.tif").write_bytes(tiff([small], packed))
    tracemalloc.start()
    read_frame(expand(tmp_path / "x.tif")[0])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 16 * 2**20  # LZMA has a dictionary of 8 MiB


def test_many_pages_are_listed_fast_and_too_many_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.tif"
    path.write_bytes(tiff([tags(2, 2, 8, 4)] * 5000, b"\1\2\3\4"))
    begun = process_time()
    with pytest.raises(InspectionError, match=r"more than 1000 pages.*raise max_frames"):
        expand(path)
    files = expand(path, ReadLimits(max_frames=5000))
    assert len(files) == 5000
    assert read_frame(files[4999]).tolist() == [[1, 2], [3, 4]]
    # 0.5 s here; a chain that is followed anew for every page takes minutes.
    assert process_time() - begun < 10
