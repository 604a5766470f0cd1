from __future__ import annotations

import csv
import os
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from typer.testing import CliRunner, Result

from pv_inspect.cli import app as cli
from pv_inspect.cracks import single_cells as plain
from pv_inspect.cracks.single_cells import image_files, read_cell
from pv_inspect.errors import InspectionError
from pv_inspect.storage.reservations import reserved_files
from tests.cracks.test_network import cell


def called(*arguments: object) -> Result:
    return CliRunner().invoke(cli.app, ["cracks", *(str(a) for a in arguments)])


@pytest.fixture
def images(tmp_path: Path) -> Path:
    folder = tmp_path / "images"
    folder.mkdir()
    cracked, clean = cell(300, 300), cell(200, 180, crack=False)
    cv2.imwrite(str(folder / "cracked.png"), np.round(cracked * 255).astype(np.uint8))
    cv2.imwrite(str(folder / "grey.jpg"), np.round(cracked * 255).astype(np.uint8))
    tifffile.imwrite(folder / "clean.tif", np.round(clean * 65535).astype(np.uint16))
    tifffile.imwrite(folder / "floating.tiff", cracked)
    return folder


def test_each_image_gets_a_map_of_its_size_and_a_line_in_the_table(
    images: Path, tmp_path: Path
) -> None:
    result = called(images, "--out", tmp_path / "out", "--cell-width-mm", 156)
    assert result.exit_code == 0, result.output
    assert "cells     cracks suspected in 3 of 4 cells, 1 clean" in result.stdout
    for stem, shape in (("cracked", (300, 300)), ("clean", (200, 180)), ("floating", (300, 300))):
        found = tifffile.imread(tmp_path / "out" / f"{stem}.tif")
        assert (found.dtype, found.shape) == (np.float32, shape)
    with (tmp_path / "out" / "cells.csv").open(newline="") as file:
        lines = {line["file"]: line for line in csv.DictReader(file)}
    assert sorted(lines) == ["clean.tif", "cracked.tif", "floating.tif", "grey.tif"]
    assert lines["clean.tif"]["crack_class"] == "none"
    cracked = lines["cracked.tif"]
    assert cracked["crack_instances"] == "1"
    assert float(cracked["crack_length_cells"]) == pytest.approx(np.hypot(0.8, 0.4), rel=0.05)
    assert float(cracked["crack_length_mm"]) == pytest.approx(156 * np.hypot(0.8, 0.4), rel=0.05)
    # bit depth and format do not matter
    maps = [tifffile.imread(tmp_path / "out" / f"{s}.tif") for s in ("cracked", "floating")]
    assert np.abs(maps[0] - maps[1]).mean() < 0.002


def test_a_bad_image_is_told_and_the_others_are_done(images: Path, tmp_path: Path) -> None:
    (images / "broken.png").write_bytes(b"no image")
    tifffile.imwrite(images / "same.tif", np.full((50, 50), 7, np.uint16))
    result = called(images, "--out", tmp_path / "out", "--quiet")
    assert result.exit_code == 1
    assert [line.split()[1] for line in result.stderr.splitlines()] == ["broken.png", "same.tif"]
    assert len(list((tmp_path / "out").glob("*.tif"))) == 4


def test_what_is_no_file_is_told_and_the_others_are_done(images: Path, tmp_path: Path) -> None:
    (images / "gone.png").symlink_to("nothing.png")
    (images / "circle.jpg").symlink_to("circle.jpg")
    os.mkfifo(images / "pipe.tif")
    (images / "bomb.bmp").write_bytes(
        b"BM" + bytes(16) + b"\x30\x75\0\0\x30\x75\0\0\1\0\x18\0" + bytes(30)
    )
    (images / "clean.tif").rename(images / os.fsdecode(b"cl\x1b[31m\xff.tif"))
    result = called(images, "--out", tmp_path / "out", "--max-frame-mpx", 1)
    assert result.exit_code == 1
    assert [line.split(": ", 1)[1][:27] for line in result.stderr.splitlines()] == [
        "bomb.bmp is 30000 x 30000 p",
        "circle.jpg is a link that l",
        "gone.png is a link to nothi",
        "pipe.tif is no file but a p",
    ]
    table = (tmp_path / "out" / "cells.csv").read_text(encoding="utf-8")
    assert r"cl\x1b[31m\udcff.tif" in table
    assert len(table.splitlines()) == 5


@pytest.mark.parametrize(
    ("image", "said"),
    [
        (np.zeros((20, 300), np.uint8), "is 300 x 20 px, but a cell needs at least 24 px"),
        (np.zeros((30, 300), np.uint8), "at most 6 times that on the longer"),
        (np.full((50, 50), 9, np.uint8), "has the same value"),
        (np.full((50, 50), np.nan, np.float32), "has 2500 pixels that are no numbers"),
        (np.zeros((2, 50, 50), np.float32), "has 2 pages"),
    ],
)
def test_what_is_no_cell_is_told_in_one_sentence(
    image: np.ndarray, said: str, tmp_path: Path
) -> None:
    tifffile.imwrite(tmp_path / "cell.tif", image, photometric="minisblack")
    with pytest.raises(InspectionError, match=said):
        read_cell(tmp_path / "cell.tif")


def test_a_coloured_photograph_is_no_cell(tmp_path: Path) -> None:
    image = np.zeros((60, 60, 3), np.uint8)
    image[..., 0] = 200
    cv2.imwrite(str(tmp_path / "cell.jpg"), image)
    with pytest.raises(InspectionError, match="is a colour image"):
        read_cell(tmp_path / "cell.jpg")


def test_images_that_would_share_a_map_are_told(images: Path) -> None:
    (images / "cracked.bmp").write_bytes(b"x")
    with pytest.raises(InspectionError, match=r"would both be written to cracked\.tif"):
        image_files([images])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere"], "does not exist: give images"),
        (["{images}", "--detector", "eye"], "Setting detector is 'eye'"),
        (["{images}", "--model", "gone.onnx"], r"gone\.onnx is missing"),
        (["{images}", "--model", "gone.onnx", "--detector", "ridge"], "leave out"),
    ],
)
def test_wrong_use_is_one_sentence(
    images: Path, tmp_path: Path, arguments: list[str], said: str
) -> None:
    given = [text.format(images=images) for text in arguments]
    result = called(*given, "--out", tmp_path / "out")
    assert result.exit_code == 1
    assert len(result.stderr.splitlines()) == 1
    assert re.search(said, result.stderr)
    assert not (tmp_path / "out").exists()


def test_the_images_themselves_are_never_replaced(images: Path) -> None:
    result = called(images, "--out", images)
    assert result.exit_code == 1
    assert "holds the images themselves" in result.stderr


def test_the_ridge_detector_needs_no_model(images: Path, tmp_path: Path) -> None:
    result = called(images / "cracked.png", "--out", tmp_path / "out", "--detector", "ridge")
    assert result.exit_code == 0, result.output
    assert "ridge filters" in result.stdout


def test_an_interrupt_says_how_many_maps_are_there(
    images: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, count = plain.read_plain_cell, 0

    def second_is_cut(*given: Any) -> Any:
        nonlocal count
        count += 1
        if count == 2:
            raise KeyboardInterrupt
        return real(*given)

    monkeypatch.setattr(plain, "read_plain_cell", second_is_cut)
    result = called(images, "--out", tmp_path / "out")
    assert result.exit_code == 130
    said = f"Interrupted; the maps of 1 of 4 images are in {tmp_path / 'out'}, without a table.\n"
    assert result.stderr == f"pv-inspect: {said}"
    assert len(list((tmp_path / "out").iterdir())) == 1  # no lock, nothing half-written


def test_two_commands_do_not_write_into_one_folder(images: Path, tmp_path: Path) -> None:
    with reserved_files(tmp_path / "out"):
        result = called(images, "--out", tmp_path / "out")
    assert result.exit_code == 1
    assert f"Another pv-inspect (process {os.getpid()}" in result.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("out", "said"), [("/", "is the root of the file system"), ("loop", "leads back to itself")]
)
def test_a_place_where_no_maps_can_be_is_one_sentence(
    images: Path, tmp_path: Path, out: str, said: str
) -> None:
    (tmp_path / "loop").symlink_to("loop")
    result = called(images, "--out", tmp_path / out)
    assert (result.exit_code, len(result.stderr.splitlines())) == (1, 1)
    assert said in result.stderr
