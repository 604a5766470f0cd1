"""Crossing points set by hand: what the fit makes of them, and that they are kept."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pv_inspect.calibration.calibrate import calibrate
from pv_inspect.calibration.camera_file import read_camera, write_camera
from pv_inspect.calibration.refit import refit_frame, residual_over_kappa
from pv_inspect.detection.crossings import Crossings, FrameCrossings
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.results.read import read_result
from pv_inspect.results.resume import resume
from pv_inspect.results.write import write_result
from pv_inspect.settings import Settings
from tests.handmade import made_crossings, made_inspection

SHAPE = (512, 640)
LAYOUT = ModuleLayout(6, 10)
CAMERA = Camera(np.array([[800.0, 0, 319.5], [0, 800.0, 255.5], [0, 0, 1]]), -0.2)
NOISE = 0.05


def homographies(n: int) -> np.ndarray:
    """Tilted views of a module that fills most of the frame."""
    found = []
    for k in range(n):
        a, b = 0.25 * np.sin(k), 0.25 * np.cos(2 * k)
        turn = np.array([[1, 0], [0, 1], [a, b]])
        found.append(np.column_stack([turn, [-5.0 + 0.1 * k, -3.0, 15.0]]))
    return np.array(found)


def observed(n: int = 8, seed: int = 0) -> Crossings:
    rng = np.random.default_rng(seed)
    frames = []
    for H in homographies(n):
        px = CAMERA.project(H, LAYOUT.crossings())
        px = px + rng.normal(0.0, NOISE, px.shape)
        frames.append(FrameCrossings(px, np.full(len(px), NOISE), np.ones(len(px), bool)))
    return Crossings(LAYOUT, tuple(frames))


def edited(crossings: Crossings, i: int, k: int, by: tuple[float, float]) -> Crossings:
    """Move point k of frame i by hand."""
    x, y = crossings.frames[i].points_px[k] + by
    frames = list(crossings.frames)
    frames[i] = frames[i].with_edits({k: (float(x), float(y))})
    return replace(crossings, frames=tuple(frames))


def test_no_fit_takes_a_point_set_by_hand_for_an_outlier() -> None:
    crossings = observed()
    before = calibrate(crossings, SHAPE, Settings())
    by_hand = edited(crossings, 2, 30, (6.0, 0.0))
    forgotten = replace(
        by_hand, frames=tuple(replace(frame, edited=None) for frame in by_hand.frames)
    )
    ignored = calibrate(forgotten, SHAPE, Settings())
    kept = calibrate(by_hand, SHAPE, Settings())
    shift = kept.crossings_px(2)[30] - before.crossings_px(2)[30]
    assert shift[0] > 0.1
    assert np.abs(ignored.crossings_px(2)[30] - before.crossings_px(2)[30]).max() < 0.02
    # 77 points, one of them about 6 px off.
    assert kept.rms_px[2] == pytest.approx(6.0 / np.sqrt(77), rel=0.15)
    assert kept.used.all()


def test_a_point_far_off_by_hand_hardly_moves_the_other_frames() -> None:
    crossings = observed()
    before = calibrate(crossings, SHAPE, Settings())
    after = calibrate(edited(crossings, 2, 30, (10.0, 0.0)), SHAPE, Settings())
    assert after.used.all()
    for i in (0, 1, 3, 4, 5, 6, 7):
        assert np.abs(after.crossings_px(i) - before.crossings_px(i)).max() < 0.15
        assert after.rms_px[i] < 2 * before.rms_px[i]


def test_removed_points_are_not_measured_and_turn_with_the_others() -> None:
    frame = observed(1).frames[0].with_edits({3: None, 5: (1.0, 2.0)})
    assert not frame.measured[3]
    assert frame.measured[5]
    np.testing.assert_array_equal(np.flatnonzero(frame.by_hand), [3, 5])
    np.testing.assert_array_equal(frame.points_px[5], [1.0, 2.0])
    half = frame.turned(LAYOUT, 2)
    np.testing.assert_array_equal(np.flatnonzero(half.by_hand), [76 - 5, 76 - 3])


def test_a_frame_that_was_given_up_can_be_set_by_hand() -> None:
    crossings = observed()
    truth = crossings.frames[4].points_px
    given_up = FrameCrossings.failed(LAYOUT, "no module found")
    frames = (*crossings.frames[:4], given_up, *crossings.frames[5:])
    without = replace(crossings, frames=frames)
    assert not calibrate(without, SHAPE, Settings()).used[4]
    corners = {k: (float(truth[k, 0]), float(truth[k, 1])) for k in range(0, 77, 7)}
    frames = (*crossings.frames[:4], given_up.with_edits(corners), *crossings.frames[5:])
    fit = calibrate(replace(crossings, frames=frames), SHAPE, Settings())
    assert fit.used[4]
    assert np.abs(fit.crossings_px(4) - truth).max() < 1.0


def test_refitting_one_frame_finds_its_pose_and_touches_no_other() -> None:
    crossings = observed()
    fit = calibrate(crossings, SHAPE, Settings())
    again = refit_frame(fit, crossings, 3)
    np.testing.assert_allclose(again.crossings_px(3), fit.crossings_px(3), atol=0.02)
    np.testing.assert_array_equal(again.homographies[:3], fit.homographies[:3])
    assert again.camera is fit.camera
    moved = refit_frame(fit, edited(crossings, 3, 0, (3.0, 0.0)), 3)
    assert moved.crossings_px(3)[0, 0] > fit.crossings_px(3)[0, 0] + 0.1


def test_refitting_a_frame_with_too_few_points_says_why() -> None:
    crossings = observed()
    fit = calibrate(crossings, SHAPE, Settings())
    frame = crossings.frames[1].with_edits(dict.fromkeys(range(72)))
    few = replace(crossings, frames=(crossings.frames[0], frame, *crossings.frames[2:]))
    again = refit_frame(fit, few, 1)
    assert not again.used[1]
    assert again.why[1] == "only 5 of 77 crossing points were measured"
    assert again.used[0]


def test_the_residual_is_smallest_at_the_fitted_kappa_and_grows_away_from_it() -> None:
    crossings = observed()
    fit = calibrate(crossings, SHAPE, Settings())
    kappa = fit.camera.kappa
    kappas = [kappa + d for d in (-0.2, -0.1, -0.05, 0.0, 0.05, 0.1, 0.2)]
    residual = residual_over_kappa(crossings, fit, kappas)
    assert int(np.argmin(residual)) == 3
    assert residual[3] == pytest.approx(NOISE * np.sqrt(2), rel=0.1)
    assert (np.diff(residual[:4]) < 0).all()
    assert (np.diff(residual[3:]) > 0).all()
    # The order in which they are asked for does not matter.
    np.testing.assert_allclose(residual_over_kappa(crossings, fit, kappas[::-1]), residual[::-1])


def test_edits_are_in_the_result_folder_and_come_back(tmp_path: Path) -> None:
    crossings = made_crossings()
    frame = crossings.frames[2].with_edits({5: (12.5, 7.25), 6: None})
    crossings = replace(crossings, frames=(*crossings.frames[:2], frame))
    inspection = made_inspection(crossings=crossings)
    write_result(inspection, tmp_path / "out")
    again = resume(read_result(tmp_path / "out"), inspection.frames).need(Crossings)
    assert not again.frames[0].by_hand.any()
    assert np.flatnonzero(again.frames[2].by_hand).tolist() == [5, 6]
    np.testing.assert_array_equal(again.frames[2].points_px[5], (12.5, 7.25))
    assert again.frames[2].measured[[5, 6]].tolist() == [True, False]
    record = json.loads((tmp_path / "out" / "result.json").read_text())
    assert record["frames"][2]["edits"][0] == {"row": 1, "col": 1, "px": [12.5, 7.25]}


@pytest.mark.parametrize("name", ["camera.yaml", "camera.json", "camera.xml", "camera"])
def test_a_written_camera_is_read_back(tmp_path: Path, name: str) -> None:
    write_camera(tmp_path / name, CAMERA, SHAPE)
    known = read_camera(tmp_path / name, SHAPE)
    np.testing.assert_allclose(known.K, CAMERA.K)
    assert known.kappa == pytest.approx(CAMERA.kappa)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_camera_that_can_not_be_written_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InspectionError, match="can't be written"):
        write_camera(tmp_path / "missing" / "camera.yaml", CAMERA, SHAPE)
