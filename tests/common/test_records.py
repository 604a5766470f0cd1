"""Result folders that somebody has changed: whole, or one sentence that names file and field."""

from __future__ import annotations

import copy
import json
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from pv_inspect.errors import LONGEST_SENTENCE, InspectionError
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.reconstruction.psf_estimate import PsfEstimate
from pv_inspect.results.read import read_result
from pv_inspect.results.resume import reopen, resume
from pv_inspect.results.write import write_result
from tests.handmade import made_inspection


@pytest.fixture(scope="module")
def inspection() -> Inspection:
    return made_inspection()


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory, inspection: Inspection) -> Path:
    out = tmp_path_factory.mktemp("records") / "out"
    write_result(inspection, out)
    return out


@pytest.fixture
def out(written: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(written, tmp_path / "out"))


def changed(path: Path, change: Callable[[Any], object]) -> None:
    record = json.loads(path.read_text())
    change(record)
    path.write_text(json.dumps(record))


def refusal(out: Path, inspection: Inspection) -> str:
    with pytest.raises(InspectionError) as error:
        resume(read_result(out), inspection.sequence)
    said = str(error.value)
    assert len(said) <= LONGEST_SENTENCE
    return said


def test_a_result_without_a_lambda_curve_has_an_empty_one(
    out: Path, inspection: Inspection
) -> None:
    changed(out / "result.json", lambda record: record.pop("lambda_curve"))
    reconstruction = resume(read_result(out), inspection.sequence).reconstruction
    assert reconstruction is not None
    assert reconstruction.lambda_curve == ()


def test_how_well_the_blur_is_known_is_read_again(out: Path, inspection: Inspection) -> None:
    says = {"error_lr_px": 0.02, "evidence": "borders", "shape": "disc"}
    changed(out / "result.json", lambda record: record.update(psf=says))
    reconstruction = resume(read_result(out), inspection.sequence).reconstruction
    assert reconstruction is not None
    sigma = reconstruction.psf_sigma_lr_px
    assert reconstruction.psf == PsfEstimate(sigma, 0.02, "borders", "disc")


def test_what_an_earlier_version_did_not_say_is_not_missed(
    out: Path, inspection: Inspection
) -> None:
    def change(record: dict[str, Any]) -> None:
        for name in ("doubts", "crack_least_extent_cells", "source", "lambda_curve", "psf"):
            record.pop(name)
        for frame in record["frames"]:
            for name in ("edits", "residual", "motion_px_deg"):
                frame.pop(name)

    changed(out / "result.json", change)
    again = resume(read_result(out), inspection.sequence)
    assert again.complete
    assert again.doubts == ()


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda r: r.update(crack_least_extent_cells=[1]), "crack_least_extent_cells is [1]"),
        (lambda r: r.update(origin_px=[1.0]), "origin_px[1] is missing"),
        (lambda r: r.update(origin_px=[1e300, 0]), "origin_px[0] is 1e+300"),
        (lambda r: r.update(origin_px=[500, 500]), "origin_px and pixels_per_cell put 2 x 3 cells"),
        (lambda r: r.update(origin_px=[-500, 11.5]), "beyond the image of"),
        (lambda r: r.update(pixels_per_cell=[0, 0]), "pixels_per_cell[0] is 0"),
        (lambda r: r.update(pixels_per_cell=[80, 40]), "pixels_per_cell"),
        (lambda r: r.update(magnification=-1), "magnification is -1"),
        (lambda r: r.update(crack_threshold=True), "crack_threshold is True"),
        (lambda r: r.update(crack_threshold=7), "crack_threshold is 7"),
        (lambda r: r.update(frames=[]), "frames is []"),
        (lambda r: r.update(frames={}), "frames is {}"),
        (lambda r: r["frames"][0].update(H=None), "frames[0] is"),
        (lambda r: r["frames"][0].update(H=[[0] * 3] * 3), "H that can't be inverted"),
        (lambda r: r["frames"][0].update(H=[[1, 0], [0, 1]]), "frames[0].H[0][2] is missing"),
        (lambda r: r["frames"][0].update(crossings_px=[[1, 2]]), "1 crossings_px in 'frame_0.tif'"),
        (lambda r: r["frames"][0].update(file="frame_2.tif"), "two frames with the same file"),
        (lambda r: r["frames"][0].update(file=5), "frames[0].file is 5"),
        (lambda r: r["frames"][0].update(used="no"), "frames[0].used is 'no'"),
        (lambda r: r["frames"][0].update(gain="much"), "frames[0].gain is 'much'"),
        (lambda r: r["frames"][0].update(motion_px_deg=[1]), "frames[0].motion_px_deg[1] is mis"),
        (lambda r: r["frames"][0].update(edits=[{"row": -1}]), "frames[0].edits[0].row is -1"),
        (lambda r: r["layout"].update(rows=10**12), "layout.rows is 1000000000000"),
        (lambda r: r["layout"].update(rows=3), "crossings_px"),
        (lambda r: r["layout"].update(cell_aspect="wide"), "layout.cell_aspect is 'wide'"),
        (lambda r: r["camera"].update(K=[[1, 0, 0]] * 3), "K must be 3 x 3"),
        (lambda r: r["camera"].update(kappa=None), "camera.kappa is None"),
        (lambda r: r["settings"].update(cls=1), "damaged"),
        (lambda r: r["settings"].update(prior_weight="x"), "prior_weight is 'x'"),
        (lambda r: r["settings"].update(more=1), "no setting 'more'"),
        (lambda r: r.pop("solver"), "solver is missing"),
        (lambda r: r.update(psf={"error_lr_px": -1, "evidence": "given"}), "psf.error_lr_px is -1"),
        (lambda r: r.update(lambda_curve=[1]), "lambda_curve[0] is 1"),
        (lambda r: r.update(seconds={"load": "long"}), "seconds.load is 'long'"),
        (lambda r: r.update(warnings="all"), "warnings is 'all'"),
        (lambda r: r.update(doubts=[1]), "doubts[0] is 1"),
        (lambda r: r.update(source={"path": {}}), "source.path"),
    ],
)
def test_a_wrong_entry_of_the_result_is_named(
    out: Path, inspection: Inspection, change: Callable[[Any], object], named: str
) -> None:
    changed(out / "result.json", change)
    said = refusal(out, inspection)
    assert "result.json is damaged or of another version" in said
    assert named in said


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda r: r.pop("camera"), "camera is missing"),
        (lambda r: r["crossings"].pop(), "crossings has 2 frames, the result has 3"),
        (lambda r: r["crossings"][0]["points_px"].pop(), "crossings[0].points_px has 11 entries"),
        (lambda r: r["crossings"][1]["measured"].append(True), "crossings[1].measured has 13"),
        (lambda r: r["crossings"][1].update(measured=12 * ["yes"]), "crossings[1].measured[0] is"),
        (lambda r: r["crossings"][1].update(edited=[True]), "crossings[1].edited has 1 entries"),
        (lambda r: r["crossings"][1].update(sigma_px=12 * [-1]), "crossings[1].sigma_px[0] is -1"),
        (lambda r: r["calibration"]["used"].pop(), "calibration.used has 2 entries"),
        (lambda r: r["calibration"].update(kappa_std=[]), "calibration.kappa_std is []"),
        (lambda r: r["calibration"]["homographies"][0][0].pop(), "calibration.homographies[0]"),
        (
            lambda r: r["calibration"]["homographies"].__setitem__(0, [[1.0] * 3] * 3),
            "calibration.homographies[0] can't be inverted",
        ),
        (lambda r: r["calibration"].update(crossing_sigma_px=[[1]] * 3), "crossing_sigma_px[0] ha"),
        (lambda r: r["camera"].update(kappa="x"), "camera.kappa is 'x'"),
    ],
)
def test_a_wrong_entry_of_the_geometry_is_named(
    out: Path, inspection: Inspection, change: Callable[[Any], object], named: str
) -> None:
    changed(out / "geometry.json", change)
    said = refusal(out, inspection)
    assert "geometry.json is damaged" in said
    assert named in said


@pytest.mark.parametrize("name", ["result.json", "geometry.json"])
@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "no JSON"),
        ("[]", "the whole is []"),
        ("7", "the whole is 7"),
        (200_000 * "[", "too deep"),
        (200_000 * '{"a":', "too deep"),
        ('{"camera": NaN}', "NaN, which is no number"),
        ('{"camera": -Infinity}', "-Infinity, which is no number"),
        ('{"camera": 1e400}', "1e400, which is beyond any number"),
        (f'{{"camera": {5000 * "9"}}}', "a number of 5000 digits"),
        ('{"camera": 1, "camera": 2}', "'camera' twice"),
    ],
)
def test_what_is_no_plain_json_is_one_sentence(
    out: Path, inspection: Inspection, name: str, text: str, named: str
) -> None:
    (out / name).write_text(text)
    said = refusal(out, inspection)
    assert name in said
    assert named in said


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Every place in a nested value, of lists the first and the last entry."""
    if path:
        yield path
    if isinstance(value, dict):
        for key, item in value.items():
            yield from places(item, (*path, key))
    elif isinstance(value, list):
        for k in sorted({0, len(value) - 1}) if value else ():
            yield from places(value[k], (*path, k))


@pytest.mark.parametrize("name", ["result.json", "geometry.json"])
def test_no_value_at_any_place_ends_in_anything_but_a_sentence(
    out: Path, inspection: Inspection, name: str
) -> None:
    """A text, a huge number, a list, an object and nothing, at every place of the record."""
    path = out / name
    record = json.loads(path.read_text())
    rng = np.random.default_rng(12)
    values: list[Any] = ["x", 10**30, -1, 1e15, [], [1], {}, None, True]
    refused = 0
    for place in places(record):
        mutated = copy.deepcopy(record)
        holder = mutated
        for key in place[:-1]:
            holder = holder[key]
        holder[place[-1]] = values[int(rng.integers(len(values)))]
        path.write_text(json.dumps(mutated))
        try:
            resume(read_result(out), inspection.sequence)
        except InspectionError:
            refused += 1
    assert refused > 50


@pytest.mark.parametrize("place", [1000 * "x", "a\0b", ["a", 300 * "/y"], "~/../\ud800"])
def test_frames_at_a_place_that_is_none_are_frames_that_went_away(out: Path, place: object) -> None:
    changed(out / "result.json", lambda r: r.update(source={"path": place, "relative": place}))
    with pytest.raises(InspectionError):
        reopen(read_result(out))


def cut_tiles(path: Path) -> None:
    """A picture that declares itself and holds nothing."""
    shape = tifffile.imread(path).shape
    tifffile.imwrite(path, np.zeros(shape, np.float32), compression="zlib", metadata=None)
    with tifffile.TiffFile(path, mode="r+b") as tif:
        tif.pages[0].aspage().tags["StripByteCounts"].overwrite(0)


@pytest.mark.parametrize(
    ("name", "change", "named"),
    [
        ("cracks.tif", lambda p: tifffile.imwrite(p, np.zeros((5, 5), np.float32)), "another size"),
        ("module_hr.tif", lambda p: tifffile.imwrite(p, np.zeros((5, 5), "f4")), "beyond the ima"),
        ("support.tif", lambda p: tifffile.imwrite(p, np.zeros((5, 5, 5), "f4")), "it has 5 pages"),
        ("cracks.tif", cut_tiles, "strips are declared but absent"),
        (
            "module_hr.tif",
            lambda p: tifffile.imwrite(p, np.full(tifffile.imread(p).shape, np.nan, "f4")),
            "pixels that are no numbers",
        ),
        (
            "module_hr.tif",
            lambda p: tifffile.imwrite(p, np.zeros(tifffile.imread(p).shape, "c16")),
            "holds complex128 values in 1 channels",
        ),
    ],
)
def test_an_image_that_does_not_go_with_the_record_is_named(
    out: Path, inspection: Inspection, name: str, change: Callable[[Path], object], named: str
) -> None:
    change(out / name)
    assert named in refusal(out, inspection)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda lines: lines[:-1], "one line for each of 2 x 3 cells"),
        (lambda lines: [*lines, lines[-1]], "one line for each of 2 x 3 cells"),
        (lambda lines: [lines[0], lines[2], lines[1], *lines[3:]], "row by row"),
        (lambda lines: [line.replace(",", ";") for line in lines], "cells.csv"),
        (lambda lines: [lines[0], lines[1].replace("0.", "nan", 1), *lines[2:]], "cells.csv"),
        (lambda lines: [*lines[:-1], 200_000 * "x"], "cells.csv"),
    ],
)
def test_a_table_that_is_not_that_of_the_module_is_named(
    out: Path, inspection: Inspection, change: Callable[[list[str]], list[str]], named: str
) -> None:
    path = out / "cells.csv"
    path.write_text("\n".join(change(path.read_text().splitlines())) + "\n")
    assert named in refusal(out, inspection)


def test_a_pipe_in_the_place_of_a_record_is_not_waited_for(
    out: Path, inspection: Inspection
) -> None:
    (out / "geometry.json").unlink()
    os.mkfifo(out / "geometry.json")
    assert "it is no file" in refusal(out, inspection)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in the file system here")
def test_a_pipe_in_place_of_an_image_is_not_waited_for(out: Path, inspection: Inspection) -> None:
    (out / "support.tif").unlink()
    os.mkfifo(out / "support.tif")
    assert "it is no file but a pipe" in refusal(out, inspection)
