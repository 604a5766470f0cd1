from __future__ import annotations

import json
import shutil
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.photometry.photometry import Photometry
from pv_inspect.photometry.vignetting import Vignetting
from pv_inspect.results.read import read_result
from pv_inspect.results.resume import reopen, resume
from pv_inspect.results.write import write_result
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings, Stage
from pv_inspect.simulate import SimulationSettings
from pv_inspect.simulate.daylight import Daylight, simulate_daylight
from tests.handmade import made_inspection


def same(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b, equal_nan=True)
    if isinstance(a, float):
        return bool(a == b or (np.isnan(a) and np.isnan(b)))
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    if hasattr(a, "__dataclass_fields__"):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    return bool(a == b)


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    folder = tmp_path / "plant" / "module"
    folder.mkdir(parents=True)
    rng = np.random.default_rng(3)
    for i in range(3):
        image = rng.integers(500, 4000, (40, 48)).astype(np.uint16)
        tifffile.imwrite(folder / f"frame_{i}.tif", image)
    return folder


def written(sequence: Any, out: Path) -> Inspection:
    inspection = made_inspection(sequence=sequence)
    write_result(inspection, out)
    return inspection


def test_every_part_comes_back_as_it_was_written(tmp_path: Path) -> None:
    inspection = made_inspection()
    write_result(inspection, tmp_path / "out")
    again = resume(read_result(tmp_path / "out"), inspection.sequence)
    assert again.complete
    assert same(again.crossings, inspection.crossings)
    assert same(again.calibration, inspection.calibration)
    assert same(again.reconstruction, inspection.reconstruction)
    assert same(again.tiles, inspection.tiles)
    assert again.registration is not None
    assert inspection.registration is not None
    used = inspection.registration.used
    for name in ("homographies", "gain", "offset", "rms"):
        got, want = getattr(again.registration, name), getattr(inspection.registration, name)
        np.testing.assert_array_equal(got[used], want[used])
    assert same(again.registration.camera, inspection.registration.camera)
    assert again.seconds == inspection.seconds


def test_what_was_found_out_about_the_sensor_comes_back(tmp_path: Path) -> None:
    """A live cell of a reopened result is corrected as the run was."""
    made = made_inspection()
    assert made.reconstruction is not None
    assert made.registration is not None
    height, width = made.sequence.shape
    rng = np.random.default_rng(2)
    vignetting = Vignetting((-0.2, 0.03), (0.01, 0.02))
    photometry = Photometry(
        rng.uniform(0.8, 1.2, (height, width)).astype(np.float32),
        rng.normal(0, 0.01, (len(made.sequence), width)).astype(np.float32),
        vignetting,
        vignetting.illumination(made.registration.camera, (height, width)),
        column_sums=rng.normal(0, 1, (2, 5, width)).astype(np.float32),
    )
    reconstruction = replace(made.reconstruction, photometry=photometry)
    write_result(replace(made, reconstruction=reconstruction), tmp_path / "out")
    again = resume(read_result(tmp_path / "out"), made.sequence)
    assert again.reconstruction is not None
    assert same(again.reconstruction.photometry, photometry)
    (tmp_path / "out" / "sensor_columns.tif").write_bytes(b"II")
    with pytest.raises(InspectionError, match=r"sensor_columns\.tif is damaged"):
        resume(read_result(tmp_path / "out"), made.sequence)


@pytest.mark.parametrize("guessed", [True, False])
def test_a_guessed_layout_is_still_guessed_when_the_result_is_taken_up(
    tmp_path: Path, guessed: bool
) -> None:
    other = ModuleLayout(6, 20, 0.5) if guessed else None
    made = made_inspection(layout_guessed=guessed, runner_up=other)
    write_result(made, tmp_path / "out")
    again = resume(read_result(tmp_path / "out"), made_inspection().sequence)
    assert again.layout_guessed is guessed
    assert again.runner_up == other


def test_another_lambda_needs_the_reconstruction_only(tmp_path: Path) -> None:
    inspection = made_inspection()
    write_result(inspection, tmp_path / "out")
    again = resume(read_result(tmp_path / "out"), inspection.sequence)
    assert again.stale(Settings()) == frozenset()
    assert again.stale(Settings(prior_weight=0.2)) == {
        Stage.RECONSTRUCT,
        Stage.CELLS,
        Stage.CRACKS,
    }


def test_a_result_without_geometry_starts_with_the_detection(tmp_path: Path) -> None:
    inspection = made_inspection()
    write_result(inspection, tmp_path / "out")
    (tmp_path / "out" / "geometry.json").unlink()
    again = resume(read_result(tmp_path / "out"), inspection.sequence)
    assert again.reconstruction is not None
    assert Stage.DETECT in again.stale(Settings())


@pytest.mark.parametrize("text", ["{", "{}", '{"crossings": [{"points_px": [1]}]}'])
def test_a_damaged_geometry_is_one_sentence(tmp_path: Path, text: str) -> None:
    inspection = made_inspection()
    write_result(inspection, tmp_path / "out")
    (tmp_path / "out" / "geometry.json").write_text(text)
    with pytest.raises(InspectionError, match=r"geometry\.json is damaged"):
        resume(read_result(tmp_path / "out"), inspection.sequence)


def test_the_frames_are_found_where_they_were(frames: Path, tmp_path: Path) -> None:
    sequence = FrameSequence.open(frames)
    written(sequence, tmp_path / "out")
    assert reopen(read_result(tmp_path / "out")).names == sequence.names


def test_a_list_of_frames_is_found_again_in_its_order(frames: Path, tmp_path: Path) -> None:
    sequence = FrameSequence.open([frames / f"frame_{i}.tif" for i in (2, 0, 1)])
    written(sequence, tmp_path / "out")
    assert reopen(read_result(tmp_path / "out")).names == sequence.names


def test_frames_and_result_may_move_together(frames: Path, tmp_path: Path) -> None:
    written(FrameSequence.open(frames), tmp_path / "plant" / "result")
    shutil.move(tmp_path / "plant", tmp_path / "archive")
    found = reopen(read_result(tmp_path / "archive" / "result"))
    assert found.source == tmp_path / "archive" / "module"


def test_frames_that_went_away_are_one_sentence_with_their_place(
    frames: Path, tmp_path: Path
) -> None:
    written(FrameSequence.open(frames), tmp_path / "out")
    shutil.rmtree(frames)
    with pytest.raises(InspectionError, match=f"no longer at {frames}"):
        reopen(read_result(tmp_path / "out"))


def test_other_frames_at_the_same_place_are_refused(frames: Path, tmp_path: Path) -> None:
    written(FrameSequence.open(frames), tmp_path / "out")
    (frames / "frame_1.tif").rename(frames / "frame_7.tif")
    with pytest.raises(InspectionError, match="other frames"):
        reopen(read_result(tmp_path / "out"))


def test_a_result_of_an_earlier_version_does_not_know_its_frames(
    frames: Path, tmp_path: Path
) -> None:
    written(FrameSequence.open(frames), tmp_path / "out")
    path = tmp_path / "out" / "result.json"
    record = json.loads(path.read_text())
    del record["source"]
    path.write_text(json.dumps(record))
    with pytest.raises(InspectionError, match="no longer"):
        reopen(read_result(tmp_path / "out"))


def test_the_dark_frame_of_the_settings_is_used_again(frames: Path, tmp_path: Path) -> None:
    dark = tmp_path / "dark.tif"
    tifffile.imwrite(dark, np.full((40, 48), 300, np.uint16))
    inspection = made_inspection(
        sequence=FrameSequence.open(frames, dark), settings=Settings(dark_frame=dark)
    )
    write_result(replace(inspection), tmp_path / "out")
    assert reopen(read_result(tmp_path / "out")).black_level == 300.0


def test_a_result_of_the_first_format_keeps_its_settings_under_their_new_names(
    tmp_path: Path,
) -> None:
    write_result(made_inspection(), tmp_path / "out")
    path = tmp_path / "out" / "result.json"
    record = json.loads(path.read_text())
    assert (record.pop("format"), record["settings"]["prior"]) == (2, "learned")
    record["settings"] |= {"prior": "wbtv", "second_look": False}
    del record["settings"]["second_pass"]
    path.write_text(json.dumps(record))
    assert read_result(tmp_path / "out").settings == Settings(
        prior="sparse_curvature", second_pass=False
    )


@pytest.mark.parametrize("name", ["result.json", "geometry.json"])
def test_a_file_of_a_newer_version_is_told_from_a_damaged_one(tmp_path: Path, name: str) -> None:
    inspection = made_inspection()
    write_result(inspection, tmp_path / "out")
    path = tmp_path / "out" / name
    path.write_text(json.dumps({**json.loads(path.read_text()), "format": 99}))
    with pytest.raises(InspectionError, match=r"newer version of pv-inspect \(format 99"):
        resume(read_result(tmp_path / "out"), inspection.sequence)


def test_frames_by_daylight_are_opened_again_as_differences(tmp_path: Path) -> None:
    settings = SimulationSettings(
        rows=2, cols=3, width=128, height=96, fill=0.7, pixels_per_unit=40, supersampling=2
    )
    day = Daylight((1.0, 0.0, 1.0), el_share=0.3, drift=0.0)
    (tmp_path / "frames").mkdir()
    for k, frame in enumerate(simulate_daylight(settings, day).frames):
        tifffile.imwrite(tmp_path / "frames" / f"frame_{k}.tif", frame)
    # Three frames are too few to be taken for it unasked.
    assert FrameSequence.open(tmp_path / "frames").lock_in is None
    written(FrameSequence.open(tmp_path / "frames", lock_in=True), tmp_path / "out")
    again = reopen(read_result(tmp_path / "out"))
    assert again.lock_in is not None
    assert set(again.lock_in.pairs) == {0, 2}
