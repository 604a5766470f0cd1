from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from scipy.fft import idctn

from pv_inspect.calibration.calibrate import Calibration
from pv_inspect.detection.crossings import Crossings, FrameCrossings
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.pose import Pose
from pv_inspect.module_choice.cell_details import CellDetails, noise_spectrum
from pv_inspect.module_choice.choice import choose_module
from pv_inspect.module_choice.detail_agreement import compare_details
from pv_inspect.module_choice.frame_agreement import _Clusters, group_frames
from pv_inspect.pipeline import inspect_steps
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings, Stage
from pv_inspect.simulate import (
    Scene,
    SimulatedMixture,
    SimulationSettings,
    mirrored,
    modules_of_one_make,
    simulate_mixture,
    upside_down,
)

MADE = SimulationSettings(
    seed=7,
    rows=4,
    cols=6,
    width=288,
    height=216,
    kappa=-0.15,
    pixels_per_unit=80,
    supersampling=3,
    wafer="mono",
)


@pytest.fixture(scope="module")
def modules() -> tuple[Scene, ...]:
    """Three modules of one make, the first one mirrored, and the first one upside down."""
    plain = modules_of_one_make(MADE, 3)
    return (*plain, mirrored(plain[0]), upside_down(plain[0]))


def _opened(
    folder: Path,
    modules: tuple[Scene, ...],
    shown: tuple[int, ...],
    made: SimulationSettings = MADE,
) -> tuple[FrameSequence, Calibration]:
    """Write the frames; their poses are those of the truth, half a pixel off."""
    mixture = simulate_mixture(made, modules, shown)
    for i, frame in enumerate(mixture.frames):
        tifffile.imwrite(folder / f"frame_{i:03d}.tif", frame)
    return FrameSequence.open(folder), _calibration(mixture)


def _calibration(mixture: SimulatedMixture) -> Calibration:
    from pv_inspect.simulate.exposure import camera_matrix

    made, count = mixture.settings, len(mixture.shown)
    camera = Camera(camera_matrix(made), made.kappa)
    rng = np.random.default_rng(0)
    corners = np.array([[0.0, 0], [made.cols, 0], [made.cols, made.rows], [0, made.rows]])
    homographies = []
    for pose in mixture.poses:
        pixels = camera.project(pose.H, corners) + rng.normal(0, 0.5, (4, 2))
        rays = camera.undistort(camera.to_normalised(pixels))
        homographies.append(cv2.findHomography(corners, rays, 0)[0])
    return Calibration(
        layout=made.layout,
        camera=camera,
        homographies=np.array(homographies),
        used=np.ones(count, bool),
        why=("",) * count,
        rms_px=np.full(count, 0.1),
        focal_convention=False,
        kappa_std=0.0,
    )


def test_frames_of_other_modules_are_left_out_and_named(
    tmp_path: Path, modules: tuple[Scene, ...]
) -> None:
    shown = (0, 1, 0, 0, 2, 0, 3)
    sequence, calibration = _opened(tmp_path, modules, shown)
    choice = choose_module(sequence, calibration, Settings())
    assert [not reason for reason in choice.why] == [k == 0 for k in shown]
    assert choice.why[1].startswith(
        "it shows another module than the 4 frames of the largest group (agreement "
    )
    assert choice.comparable
    left = choice.of_calibration(calibration)
    np.testing.assert_array_equal(left.used, [k == 0 for k in shown])
    assert left.why[4] == choice.why[4]


def test_where_no_module_is_shown_by_most_the_run_is_refused_with_their_number(
    tmp_path: Path, modules: tuple[Scene, ...]
) -> None:
    sequence, calibration = _opened(tmp_path, modules, (0, 1, 2, 0, 1, 2))
    with pytest.raises(
        InspectionError,
        match=r"These 6 frames look like 3 modules \(frame_000\.tif and 1 more; frame_001\.tif "
        r"and 1 more; frame_002\.tif and 1 more\): run each module by itself, or name a frame",
    ):
        choose_module(sequence, calibration, Settings())


def test_a_frame_may_name_the_module(tmp_path: Path, modules: tuple[Scene, ...]) -> None:
    sequence, calibration = _opened(tmp_path, modules, (0, 1, 0, 1, 0))
    choice = choose_module(sequence, calibration, Settings(module_of="frame_003.tif"))
    assert [not reason for reason in choice.why] == [False, True, False, True, False]
    assert "another module than the 2 frames of the module that was asked for" in choice.why[0]
    lost = replace(
        calibration,
        used=np.array([True, True, True, False, True]),
        why=("", "", "", "black", ""),
    )
    with pytest.raises(InspectionError, match=r"frame_003\.tif .* can't be used \(black\)"):
        choose_module(sequence, lost, Settings(module_of="frame_003.tif"))


def test_a_person_may_keep_frames_of_another_module(
    tmp_path: Path, modules: tuple[Scene, ...]
) -> None:
    sequence, calibration = _opened(tmp_path, modules, (0, 1, 0, 1))
    kept = Settings(keep_frames=("frame_001.tif", "frame_003.tif"))
    assert not any(choose_module(sequence, calibration, kept).why)
    one = Settings(keep_frames=("frame_001.tif",), skip_frames=("frame_003.tif",))
    assert not any(choose_module(sequence, calibration, one).why)


def test_frames_upside_down_are_of_the_same_module_and_turned(
    tmp_path: Path, modules: tuple[Scene, ...]
) -> None:
    sequence, calibration = _opened(tmp_path, modules, (0, 0, 4, 0, 4))
    choice = choose_module(sequence, calibration, Settings())
    assert not any(choice.why)
    assert [placement.turn for placement in choice.placements] == [0, 0, 2, 0, 2]
    turned = choice.of_calibration(calibration)
    for frame, placement in enumerate(choice.placements):
        order = -1 if placement.turn else 1
        np.testing.assert_allclose(
            turned.crossings_px(frame), calibration.crossings_px(frame)[::order], atol=1e-6
        )
    points = Crossings(
        calibration.layout,
        tuple(
            FrameCrossings(calibration.crossings_px(i), np.ones(35), np.ones(35, bool))
            for i in range(5)
        ),
    )
    found = choice.of_crossings(points)
    np.testing.assert_array_equal(found.frames[2].points_px, points.frames[2].points_px[::-1])


@pytest.mark.parametrize(("rows", "cols", "turn"), [(1, 0, 0), (0, -1, 0), (0, 1, 2)])
def test_a_grid_that_lies_a_line_of_cells_beside_the_others_is_moved_back(
    tmp_path: Path, modules: tuple[Scene, ...], rows: int, cols: int, turn: int
) -> None:
    sequence, truth = _opened(tmp_path, modules, (0, 0, 0, 0, 1))
    layout = truth.layout
    wrong = truth.homographies.copy()
    for frame in (1, 2):
        pose = Pose(truth.camera, wrong[frame]).turned(layout.size, layout.size, turn)
        wrong[frame] = pose.homography @ np.array([[1, 0, cols], [0, 1, rows], [0, 0, 1.0]])
    calibration = replace(truth, homographies=wrong)
    choice = choose_module(sequence, calibration, Settings())
    assert [bool(reason) for reason in choice.why] == [False, False, False, False, True]
    mended = choice.of_calibration(calibration)
    for frame in range(4):
        np.testing.assert_allclose(mended.crossings_px(frame), truth.crossings_px(frame), atol=1e-6)
    points = Crossings(
        layout,
        tuple(
            FrameCrossings(calibration.crossings_px(i), np.ones(35), np.ones(35, bool))
            for i in range(5)
        ),
    )
    found = choice.of_crossings(points).frames[1]
    assert found.measured.sum() == 35 - (5 if cols else 7)
    np.testing.assert_allclose(
        found.points_px[found.measured], truth.crossings_px(1)[found.measured], atol=1e-6
    )


@pytest.mark.parametrize(
    "changed",
    [
        {"read_noise_e": 250.0, "full_well_e": 12000.0, "exposure": 0.3},
        {"motion_blur_px": 5.0, "flicker": 0.2},
        {"dark_cell_share": 0.3, "vignetting": 0.4},
    ],
    ids=["noise", "motion and flicker", "dark cells and vignetting"],
)
def test_frames_of_one_module_stay_together(tmp_path: Path, changed: dict[str, float]) -> None:
    made = SimulationSettings(**{**vars(MADE), **changed})
    sequence, calibration = _opened(tmp_path, modules_of_one_make(made, 1), (0,) * 4, made)
    found = group_frames(sequence, calibration, [0, 1, 2, 3])
    assert found.groups == ((0, 1, 2, 3),)
    assert found.comparable
    assert found.agreement[0, 0] > 0.6


def _random_details(rng: np.random.Generator, truth: np.ndarray, noise: float) -> CellDetails:
    spread = np.sqrt(noise_spectrum(*truth.shape[2:]))
    values = truth + noise * idctn(
        spread * rng.standard_normal(truth.shape), axes=(2, 3), norm="ortho"
    )
    values = values - values.mean(axis=0, keepdims=True)
    values = values - values.mean(axis=1, keepdims=True)
    rows, cols = truth.shape[:2]
    return CellDetails(values, np.ones((rows, cols), bool), np.full((rows, cols), noise**2))


def test_the_standard_error_by_chance_is_that_of_the_agreement_of_different_modules() -> None:
    rng = np.random.default_rng(3)
    scale = np.array([3.0, 1.0, 1.0, 0.5]).reshape(2, 2)
    frames = [
        _random_details(rng, scale * rng.standard_normal((5, 6, 2, 2)), 0.2) for _ in range(60)
    ]
    pairs = compare_details(frames, (0, 2))
    others = ~np.eye(60, dtype=bool)
    z = pairs.agreement[0][others] / np.sqrt(pairs.variance[0][others])
    # 1770 independent values: the standard error of their rms is 1.7 %, the error's own is more.
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.12)


def test_frames_of_noise_are_not_split_and_it_is_said() -> None:
    rng = np.random.default_rng(5)
    truth = [0.02 * rng.standard_normal((5, 6, 2, 2)) for _ in range(2)]
    frames = [_random_details(rng, truth[k % 2], 1.0) for k in range(8)]
    found = _Clusters(compare_details(frames, (0, 2)), (0, 2)).result(list(range(8)))
    assert found.groups == (tuple(range(8)),)
    assert not found.comparable


def test_what_one_noisy_pair_does_not_tell_the_groups_tell() -> None:
    rng = np.random.default_rng(8)
    truth = [rng.standard_normal((5, 6, 4, 4)) for _ in range(2)]
    frames = [_random_details(rng, truth[k % 2], 2.0) for k in range(16)]
    pairs = compare_details(frames, (0, 2))
    same = np.equal.outer(np.arange(16) % 2, np.arange(16) % 2) & ~np.eye(16, dtype=bool)
    # Single pairs of the two kinds are not separated: the groups below are more than a threshold.
    assert pairs.agreement[0][same].min() < pairs.agreement[0][~same].max() + 0.5
    found = _Clusters(pairs, (0, 2)).result(list(range(16)))
    assert sorted(found.groups) == [tuple(range(0, 16, 2)), tuple(range(1, 16, 2))]


def test_a_single_frame_needs_no_comparison(tmp_path: Path, modules: tuple[Scene, ...]) -> None:
    sequence, calibration = _opened(tmp_path, modules, (0,))
    choice = choose_module(sequence, calibration, Settings())
    assert choice.why == ("",)
    assert choice.of_calibration(calibration) is calibration


@pytest.mark.parametrize("model", ["camera", "homography"])
def test_a_run_on_two_modules_ends_before_anything_is_fused(
    tmp_path: Path, modules: tuple[Scene, ...], model: str
) -> None:
    sequence, _ = _opened(tmp_path, modules, (0, 1, 0, 1))
    settings = Settings(rows=4, cols=6, registration_model=model)
    seen: list[Stage] = []
    with pytest.raises(InspectionError, match="These 4 frames look like 2 modules"):
        seen.extend(step.stage for step in inspect_steps(sequence, settings))
    assert seen[-1] is Stage.CALIBRATE
