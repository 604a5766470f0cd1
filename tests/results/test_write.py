from __future__ import annotations

import errno
import json
import os
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from pv_inspect.cracks import CellFeatures, CrackMap, OperatingPoint
from pv_inspect.errors import InspectionError
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.registration.registration import Registration
from pv_inspect.results.read import read_result
from pv_inspect.results.write import check_writable, tile_name, write_result
from pv_inspect.storage import folders
from tests.handmade import REASON, made_inspection, made_registration


def strict(path: Path) -> dict[str, Any]:
    def refuse(text: str) -> None:
        raise AssertionError(f"{text} is no JSON")

    loaded: dict[str, Any] = json.loads(path.read_text(), parse_constant=refuse)
    return loaded


def test_the_folder_holds_what_the_contract_says(tmp_path: Path) -> None:
    inspection = made_inspection()
    write_result(inspection, tmp_path / "out")
    names = {str(p.relative_to(tmp_path / "out")) for p in (tmp_path / "out").rglob("*")}
    tiles = {f"cells/{tile_name(i, j)}" for i in range(2) for j in range(3)}
    images = {"module_hr.tif", "support.tif", "consistency.tif", "cracks.tif"}
    records = {"result.json", "geometry.json"}
    assert names == images | tiles | records | {"cells.csv", "cells", "report.html"}
    assert tile_name(0, 9) == "r01_c10.tif"
    record = strict(tmp_path / "out" / "result.json")
    assert record["pixels_per_cell"] == [80.0, 80.0]
    assert record["origin_px"] == [11.5, 11.5]
    assert (record["rows"], record["cols"], record["magnification"]) == (2, 3, 4.0)
    assert record["camera"]["focal_length"] == "identified"
    assert record["seconds"] == {"load": 0.1, "detect": 1.0, "reconstruct": 2.0, "total": 3.1}
    first, rejected, _ = record["frames"]
    assert np.array(first["crossings_px"]).shape == (12, 2)
    assert np.array(first["H"]).shape == (3, 3)
    assert first["used"]
    assert rejected["why"] == REASON
    assert rejected["crossings_px"] is None


def test_no_file_is_left_beside_the_result(tmp_path: Path) -> None:
    for _ in range(2):
        write_result(made_inspection(), tmp_path / "out")
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_images_come_back_as_they_were_written(tmp_path: Path) -> None:
    inspection = made_inspection()
    write_result(inspection, tmp_path / "out")
    result = read_result(tmp_path / "out")
    assert inspection.cracks is not None
    made, read_back = inspection.need(Reconstruction), result.need(Reconstruction)
    found = result.need(CrackMap)
    np.testing.assert_array_equal(read_back.image, made.image)
    np.testing.assert_array_equal(read_back.support, made.support)
    np.testing.assert_array_equal(read_back.consistency, made.consistency)
    np.testing.assert_array_equal(found.probability, inspection.cracks.probability)
    assert read_back.grid == made.grid
    assert result.settings == inspection.settings
    assert result.warnings == inspection.warnings
    registration = result.need(Registration)
    assert registration.used.tolist() == [True, False, True]
    assert np.isnan(registration.rms[1])
    for read, written in zip(found.cells, inspection.cracks.cells, strict=True):
        assert (read.row, read.col) == (written.row, written.col)
        for spec in fields(CellFeatures):
            value = getattr(written, spec.name)
            assert getattr(read, spec.name) == pytest.approx(value, rel=1e-5, nan_ok=True)
    assert found.detector == inspection.cracks.detector
    assert found.least_extent_cells == inspection.cracks.least_extent_cells
    tile = tifffile.imread(tmp_path / "out" / "cells" / "r01_c02.tif")
    assert inspection.tiles is not None
    np.testing.assert_array_equal(tile, inspection.tiles.tile(0, 1))


def test_the_features_of_cells_are_in_the_record_with_their_class(tmp_path: Path) -> None:
    inspection = made_inspection()
    assert inspection.cracks is not None
    write_result(inspection, tmp_path / "out")
    record = strict(tmp_path / "out" / "result.json")
    cell = record["cells"][1]
    assert {spec.name for spec in fields(CellFeatures)} < set(cell)
    assert cell["crack_length_cells"] == inspection.cracks.cells[1].crack_length_cells
    assert cell["crack_length_mm"] is None
    assert (cell["crack_class"], cell["marked_class"]) == ("unknown", "unknown")
    assert any(line.startswith("can't be judged ") for line in record["class_rule"])
    head = (tmp_path / "out" / "cells.csv").read_text().splitlines()[0]
    assert head.endswith(
        "unsupported_share,unsure,weak_marks,novelty,cut_off_share,crack_detail,edge_blur,"
        "finger_interruptions,finger_interruption_length_cells,crack_class,marked_class"
    )


def test_a_result_that_does_not_say_the_least_extent_can_be_read(tmp_path: Path) -> None:
    write_result(made_inspection(), tmp_path / "out")
    path = tmp_path / "out" / "result.json"
    record = strict(path)
    del record["crack_least_extent_cells"]
    path.write_text(json.dumps(record))
    assert read_result(tmp_path / "out").need(CrackMap).least_extent_cells == (
        OperatingPoint.least_extent_cells
    )


def test_the_module_image_states_its_resolution_in_pixels_per_cell_width(tmp_path: Path) -> None:
    write_result(made_inspection(), tmp_path / "out")
    with tifffile.TiffFile(tmp_path / "out" / "module_hr.tif") as tif:
        page = tif.pages[0]
        assert page.dtype == np.float32
        assert page.tags["XResolution"].value == (80, 1)
        assert page.tags["ResolutionUnit"].value == 1
        assert "80 x 80 pixels per cell" in page.tags["ImageDescription"].value


def test_what_is_not_a_number_becomes_null(tmp_path: Path) -> None:
    registration = made_registration()
    registration = replace(registration, rms=np.array([np.nan, np.nan, np.inf]))
    write_result(made_inspection(registration=registration), tmp_path / "out")
    assert strict(tmp_path / "out" / "result.json")["frames"][0]["rms"] is None


def test_an_earlier_result_is_replaced_and_foreign_files_in_it_are_kept(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write_result(made_inspection(), out)
    (out / "review.sqlite").write_text("verdicts")
    (out / "notes").mkdir()
    (out / "notes" / "mine.txt").write_text("x")
    (out / "cells" / "r99_c01.tif").write_text("a tile of an earlier layout")
    (out / "cells" / "remarks.txt").write_text("y")
    held = (out / "review.sqlite").open("a")
    write_result(made_inspection(warnings=("second",)), out)
    with held:
        held.write(" and more")
    assert strict(out / "result.json")["warnings"] == ["second"]
    assert (out / "review.sqlite").read_text() == "verdicts and more"
    assert (out / "notes" / "mine.txt").read_text() == "x"
    assert (out / "cells" / "remarks.txt").read_text() == "y"
    assert not (out / "cells" / "r99_c01.tif").exists()


def snapshot(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.parametrize("after", [0, 3, 8])
def test_a_full_disk_leaves_the_earlier_result_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: int
) -> None:
    out = tmp_path / "out"
    write_result(made_inspection(), out)
    before, count, real = snapshot(tmp_path), 0, folders._write_file

    def full(path: Path, content: bytes) -> None:
        nonlocal count
        count += 1
        if count > after:
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(content[: len(content) // 2])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(path, content)

    monkeypatch.setattr(folders, "_write_file", full)
    with pytest.raises(InspectionError, match="the disk is full; free some space"):
        write_result(made_inspection(warnings=("second",)), out)
    assert snapshot(tmp_path) == before


def test_a_full_disk_leaves_nothing_where_nothing_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, content: bytes) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(folders, "_write_file", full)
    with pytest.raises(InspectionError, match="the disk is full"):
        write_result(made_inspection(), tmp_path / "a" / "b" / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_cut_between_the_two_renames_is_healed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    write_result(made_inspection(), out)
    before = snapshot(out)
    out.rename(tmp_path / ".out.previous")
    assert snapshot(read_result(out).source) == before


def test_an_interrupt_while_writing_leaves_the_earlier_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    write_result(made_inspection(), out)
    before = snapshot(tmp_path)
    real = Path.rename

    def cut(self: Path, target: Path) -> Path:
        if self.name.startswith(".out.partial-"):
            raise KeyboardInterrupt
        return real(self, target)

    monkeypatch.setattr(Path, "rename", cut)
    with pytest.raises(KeyboardInterrupt):
        write_result(made_inspection(warnings=("second",)), out)
    assert snapshot(tmp_path) == before


def test_a_folder_with_other_files_is_refused_and_not_touched(tmp_path: Path) -> None:
    (tmp_path / "report.html").write_text("mine")
    with pytest.raises(InspectionError, match=r"not empty and holds no earlier result"):
        check_writable(tmp_path)
    with pytest.raises(InspectionError):
        write_result(made_inspection(), tmp_path)
    assert snapshot(tmp_path) == {"report.html": b"mine"}


def test_an_empty_folder_and_a_link_to_one_are_fine(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    write_result(made_inspection(), tmp_path / "link")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real" / "result.json").exists()


def test_a_file_or_a_place_where_nothing_can_be_made_is_refused_before_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InspectionError, match="is a file: give a folder"):
        check_writable(tmp_path / "file")
    with pytest.raises(InspectionError, match="is a file, so that there can't be"):
        check_writable(tmp_path / "file" / "out")

    def denied(self: Path) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "mkdir", denied)
    with pytest.raises(InspectionError, match=r"is read-only \(Permission denied\); allow"):
        check_writable(tmp_path / "out")


def test_an_incomplete_inspection_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(InspectionError, match="not complete"):
        write_result(made_inspection(cracks=None), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("result.json", "{", "result.json is damaged"),
        ("result.json", "{}", "layout is missing"),
        ("support.tif", "II", "support.tif is damaged"),
        ("cells.csv", "row,col\n1,1\n", "cells.csv is damaged"),
        ("cracks.tif", None, "cracks.tif is missing"),
        ("result.json", None, "is no result folder"),
    ],
)
def test_a_damaged_result_is_told_in_one_sentence(
    tmp_path: Path, name: str, content: str | None, said: str
) -> None:
    write_result(made_inspection(), tmp_path / "out")
    path = tmp_path / "out" / name
    path.unlink() if content is None else path.write_text(content)
    with pytest.raises(InspectionError, match=said):
        read_result(tmp_path / "out")


def test_a_name_that_is_too_long_for_a_folder_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InspectionError, match=r"can't be read \(File name too long\)"):
        read_result(tmp_path / ("a b " * 200))
