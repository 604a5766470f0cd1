"""The simulator: geometry, optics and electronics against closed forms; files; errors."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st

import pv_inspect.simulate
from pv_inspect.errors import InspectionError
from pv_inspect.simulate import (
    Scene,
    SimulatedSequence,
    SimulationSettings,
    check_target,
    simulate,
    simulated,
    write_sequence,
)
from pv_inspect.simulate import files as files_module
from pv_inspect.simulate.defects import cut_off
from pv_inspect.simulate.exposure import (
    Exposer,
    Pose,
    camera_matrix,
    choose_poses,
    project_points,
    undistorted_radius,
)

TINY = SimulationSettings(
    rows=3,
    cols=4,
    width=160,
    height=128,
    n_frames=2,
    pixels_per_unit=60,
    supersampling=4,
    kappa=-0.2,
)
SCORER = Path(__file__).parents[2] / "shared" / "tools" / "score_sequence.py"


def custom_scene(settings: SimulationSettings, radiance: np.ndarray, origin: float) -> Scene:
    image = radiance.astype(np.float32)
    cracks = np.zeros(image.shape, bool)
    return Scene(settings.layout, settings.pixels_per_unit, (origin, origin), image, cracks)


def module_coordinates(ppu: float, size: tuple[int, int], origin: float) -> tuple[np.ndarray, ...]:
    rows, cols = size
    y, x = np.mgrid[0:rows, 0:cols]
    return (x - origin) / ppu, (y - origin) / ppu


@pytest.fixture(scope="module")
def tiny() -> SimulatedSequence:
    return simulated(TINY)


# geometry


@given(st.floats(0.0, 1.2), st.floats(-1.0, 1.0))
def test_undistorted_radius_inverts_the_cubic_on_the_first_branch(
    radius: float, kappa: float
) -> None:
    slope = 1 + 3 * kappa * radius**2
    if slope < 1e-3:
        return
    found = undistorted_radius(np.array([radius + kappa * radius**3]), kappa)
    assert found[0] == pytest.approx(radius, abs=1e-15 / slope, rel=4e-15 / slope)


def test_no_ray_arrives_at_or_beyond_the_fold() -> None:
    kappa = -0.3
    fold = np.sqrt(-4 / (27 * kappa))
    radii = undistorted_radius(np.array([fold * (1 - 1e-9), fold * (1 + 1e-12), 10.0]), kappa)
    assert radii[0] == pytest.approx(np.sqrt(-1 / (3 * kappa)), rel=1e-4)
    assert np.isnan(radii[1:]).all()


def test_projection_is_the_stated_formula() -> None:
    K = camera_matrix(TINY)
    H = np.array([[1.0, 0.02, -2.0], [-0.01, 0.99, -1.5], [0.03, -0.02, 4.0]])
    x, y, w = H @ [3.0, 1.0, 1.0]
    u, v = x / w, y / w
    factor = 1 - 0.2 * (u**2 + v**2)
    expected = [K[0, 0] * u * factor + K[0, 2], K[1, 1] * v * factor + K[1, 2]]
    np.testing.assert_allclose(project_points(K, -0.2, H, np.array([[3.0, 1.0]]))[0], expected)


def test_the_module_spans_the_wanted_share_of_the_frame_and_is_centred() -> None:
    settings = replace(TINY.without_motion(), fill=0.8)
    (pose, *_) = choose_poses(settings, np.random.default_rng(0))
    sides = np.linspace(0, 1, 201)[:, None] * settings.layout.size
    outline = np.vstack(
        [sides * [1, 0], sides * [0, 1], sides * [1, 0] + [0, 3], sides * [0, 1] + [4, 0]]
    )
    pixels = project_points(camera_matrix(settings), settings.kappa, pose.H, outline)
    span = np.ptp(pixels, axis=0) / [settings.width, settings.height]
    assert span.max() == pytest.approx(0.8, abs=1e-3)
    middle = (pixels.max(axis=0) + pixels.min(axis=0)) / 2
    np.testing.assert_allclose(middle, [79.5, 63.5], atol=0.1)


@pytest.mark.parametrize("motion_px", [0.0, 2.6])
@pytest.mark.parametrize("place", [(1.0, 1.0), (3.5, 2.5), (0.4, 2.2)])
def test_a_bright_dot_appears_where_the_truth_says(
    place: tuple[float, float], motion_px: float
) -> None:
    settings = replace(TINY.without_motion().without_noise(), pixels_per_unit=120, supersampling=6)
    x, y = module_coordinates(120, (408, 528), 23.5)
    dot = np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / (2 * 0.02**2))
    (pose, *_) = choose_poses(settings, np.random.default_rng(1))
    pose = Pose(pose.H, 1.0, motion_px, 35.0)
    image = Exposer(settings, custom_scene(settings, dot, 23.5)).expose(pose)
    v, u = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    centroid = [(u * image).sum() / image.sum(), (v * image).sum() / image.sum()]
    truth = project_points(camera_matrix(settings), settings.kappa, pose.H, np.array([place]))[0]
    np.testing.assert_allclose(centroid, truth, atol=0.01)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_ramp_over_the_module_is_seen_at_the_pixel_centres(axis: int) -> None:
    settings = replace(TINY.without_motion().without_noise(), pixels_per_unit=100)
    ramp = module_coordinates(100, (500, 600), 99.5)[axis]
    (pose, *_) = choose_poses(settings, np.random.default_rng(2))
    image = Exposer(settings, custom_scene(settings, ramp + 2, 99.5)).expose(pose) - 2
    points = np.array([[0.7, 0.6], [2.0, 1.5], [3.3, 2.4]])
    pixels = project_points(camera_matrix(settings), settings.kappa, pose.H, points)
    seen = cv2.remap(
        image, *(pixels[None, :, k].astype(np.float32) for k in (0, 1)), cv2.INTER_LINEAR
    )
    # One LR pixel is 0.03 module units: this is a fortieth of it.
    np.testing.assert_allclose(seen[0], points[:, axis], atol=0.0008)


def test_optics_and_aperture_have_the_width_that_they_claim() -> None:
    sigma_dot, sigma = 0.02, 0.8
    settings = replace(
        TINY.without_motion().without_noise(),
        pixels_per_unit=120,
        supersampling=8,
        psf_sigma_px=sigma,
        kappa=0.0,
        tilt_deg=0.0,
        roll_deg=0.0,
    )
    x, y = module_coordinates(120, (408, 528), 23.5)
    dot = np.exp(-((x - 2) ** 2 + (y - 1.5) ** 2) / (2 * sigma_dot**2))
    (pose, *_) = choose_poses(settings, np.random.default_rng(0))
    image = Exposer(settings, custom_scene(settings, dot, 23.5)).expose(Pose(pose.H, 1.0, 3.0, 0.0))
    image = np.where(image > 1e-6, image, 0).astype(np.float64)
    scale = settings.focal_px / pose.H[2, 2]
    v, u = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    total = image.sum()
    var_u = (u**2 * image).sum() / total - ((u * image).sum() / total) ** 2
    var_v = (v**2 * image).sum() / total - ((v * image).sum() / total) ** 2
    aperture, motion = 1 / 12, 3.0**2 / 12
    expected = (sigma_dot * scale) ** 2 + sigma**2 + aperture
    assert var_v == pytest.approx(expected, rel=0.02)
    assert var_u == pytest.approx(expected + motion, rel=0.02)


def test_beyond_the_fold_the_frame_shows_no_scene() -> None:
    settings = replace(TINY.without_motion().without_noise(), kappa=-0.9, fill=0.3, n_frames=1)
    ones = np.ones((3000, 3000))
    frame = simulated(settings, custom_scene(settings, ones, 1400.0)).frames[0]
    cx, cy = camera_matrix(settings)[:2, 2]
    v, u = np.mgrid[0:128, 0:160]
    radius = np.hypot(u - cx, v - cy)
    fold = settings.focal_px * np.sqrt(4 / (27 * 0.9))
    assert (frame[radius > fold + 4] == settings.black_level_dn).all()
    assert np.ptp(frame[radius < 0.9 * fold]) <= 1


def test_a_module_that_the_distortion_folds_over_is_refused() -> None:
    with pytest.raises(InspectionError, match="folds over"):
        simulated(replace(TINY, kappa=-1.0, fill=1.4))


def edge_frame(**changed: object) -> np.ndarray:
    """One frame of a scene that is dark on the left and bright on the right."""
    settings = replace(
        TINY.without_noise().without_motion(), n_frames=1, tilt_deg=0.0, roll_deg=0.0
    )
    settings = replace(settings, kappa=0.0, supersampling=8, **changed)  # type: ignore[arg-type]
    radiance = np.zeros((1200, 1200))
    radiance[:, 600:] = 1.0
    frame = simulated(settings, custom_scene(settings, radiance, 500.0)).frames[0]
    return frame.astype(np.float64) - 64


@pytest.mark.parametrize("shape", ["gaussian", "disc"])
def test_both_shapes_of_the_blur_have_the_wanted_standard_deviation(shape: str) -> None:
    def variance(sigma: float) -> float:
        line = np.diff(edge_frame(psf_sigma_px=sigma, psf_shape=shape)[60])
        x = np.arange(len(line))
        mean = (line * x).sum() / line.sum()
        return float((line * (x - mean) ** 2).sum() / line.sum())

    # Sharper edges than these are not sampled finely enough for a second moment.
    assert variance(1.2) - variance(0.7) == pytest.approx(1.2**2 - 0.7**2, rel=0.02)


def test_a_disc_ends_where_a_gaussian_does_not() -> None:
    blurred = {
        kind: edge_frame(psf_sigma_px=1.5, psf_shape=kind)[60] for kind in ("disc", "gaussian")
    }
    share = {
        kind: (line > 0.002 * line.max()) & (line < 0.998 * line.max())
        for kind, line in blurred.items()
    }
    assert share["disc"].sum() + 2 <= share["gaussian"].sum()


def test_the_blur_of_the_scene_softens_outlines_and_the_spread_of_light_does_not() -> None:
    def steepest(**changed: float) -> float:
        made = replace(TINY, crack_share=0.0, pixels_per_unit=100, n_frames=1, rows=2, cols=2)
        scene = simulated(replace(made, **changed)).scene  # type: ignore[arg-type]
        middle = scene.radiance[scene.radiance.shape[0] // 3]
        return float(np.abs(np.diff(middle))[: int(scene.origin_px[0]) + 10].max())

    sharp = steepest()
    assert steepest(light_spread=0.02) == pytest.approx(sharp, rel=0.1)
    assert steepest(scene_blur=0.02) < 0.5 * sharp


def test_the_gap_between_wafers_has_its_width() -> None:
    def dark(gap: float) -> int:
        made = replace(TINY, wafer_gap=gap, pixels_per_unit=200, n_frames=1, dark_cell_share=0.0)
        scene = simulated(replace(made, crack_share=0.0)).scene
        x = round(scene.origin_px[0] + 200 + 0.5)
        line = scene.radiance[round(scene.origin_px[1]) + 60, x - 20 : x + 20]
        return int((line < 0.5 * np.median(line)).sum())

    assert dark(0.04) - dark(0.02) == pytest.approx(4, abs=1)


# sensor


def flat(settings: SimulationSettings, level: float) -> Scene:
    return custom_scene(settings, np.full((1200, 1200), level), 500.0)


def test_an_ideal_sensor_reads_black_level_plus_signal() -> None:
    settings = replace(TINY.without_noise(), exposure=0.5)
    frames = simulated(settings, flat(settings, 0.8)).frames
    assert (frames == 64 + 0.5 * 0.8 * 4095).all()


def test_noise_has_the_variance_of_its_electrons() -> None:
    settings = replace(
        TINY.without_motion().without_noise(),
        n_frames=60,
        shot_noise=True,
        read_noise_e=40.0,
        full_well_e=25000.0,
        exposure=0.5,
        supersampling=1,
    )
    frames = simulated(settings, flat(settings, 0.8)).frames.astype(np.float64)
    electrons = 0.4 * settings.full_well_e
    expected = (electrons + 40.0**2) * (4095 / settings.full_well_e) ** 2 + 1 / 12
    assert frames.var(axis=0, ddof=1).mean() == pytest.approx(expected, rel=0.01)
    assert frames.mean() == pytest.approx(64 + 0.4 * 4095, abs=0.05)


def test_fixed_pattern_stays_and_noise_does_not() -> None:
    settings = replace(TINY, n_frames=6, hot_share=0.01, dead_share=0.01, column_offset_e=300.0)
    settings = replace(settings, black_level_dn=400)
    frames = simulated(settings, flat(settings, 0.0)).frames.astype(np.float64)
    assert 0.005 < (frames == 0).all(axis=0).mean() < 0.015
    assert 0.005 < (frames > 1500).all(axis=0).mean() < 0.015
    columns = np.median(frames, axis=1)
    assert np.corrcoef(columns)[0, 1:].min() > 0.95
    assert not np.array_equal(frames[0], frames[1])


def test_vignetting_darkens_the_corner_by_its_share() -> None:
    settings = replace(TINY.without_noise(), vignetting=0.4)
    frame = simulated(settings, flat(settings, 1.0)).frames[0].astype(np.float64) - 64
    far = np.hypot(160, 128) / 2
    cx, cy = camera_matrix(settings)[:2, 2]
    fall = 0.4 * np.hypot(cx, cy) ** 2 / far**2
    assert frame[0, 0] / frame[round(cy), round(cx)] == pytest.approx(1 - fall, abs=0.002)


# module


def test_truth_crossings_lie_in_the_dark_gaps(tiny: SimulatedSequence) -> None:
    inner = np.ones((4, 5), bool)
    inner[[0, -1]] = inner[:, [0, -1]] = False
    for i, frame in enumerate(tiny.frames):
        blurred = cv2.GaussianBlur(frame.astype(np.float32), (0, 0), 0.7)
        crossings = tiny.crossings_px(i)[inner.ravel()]
        for x, y in crossings:
            col, row = round(x), round(y)
            around = blurred[row - 9 : row + 10, col - 9 : col + 10]
            assert blurred[row, col] < 0.6 * np.percentile(around, 80)


@pytest.mark.parametrize(("aspect", "shape"), [(2.0, (114, 264)), (0.5, (384, 264))])
def test_half_cut_cells_have_their_shape(aspect: float, shape: tuple[int, int]) -> None:
    settings = replace(TINY, cell_aspect=aspect, n_frames=1, dark_cell_share=0.0, crack_share=0.0)
    scene = simulated(settings).scene
    assert scene.radiance.shape == shape
    (ox, oy), pitch = scene.origin_px, 60 / aspect
    centre = scene.radiance[:, round(ox + 20)]  # between busbars if they run along y
    for line in (1, 2):
        gap = round(oy + line * pitch)
        assert centre[gap] < 0.6 * centre[gap + round(0.3 * pitch)]


def test_monocrystalline_cells_have_dark_diamonds_at_the_crossings() -> None:
    kind = {"n_frames": 1, "crack_share": 0.0, "dark_cell_share": 0.0, "pixels_per_unit": 120}
    dark = {}
    for wafer in ("mono", "multi"):
        scene = simulated(replace(TINY, wafer=wafer, **kind)).scene
        x, y = (round(scene.origin_px[k] + 120) for k in (0, 1))
        dark[wafer] = (scene.radiance[y - 6 : y + 6, x - 6 : x + 6] < 0.25).mean()
    assert dark["mono"] > dark["multi"] + 0.2


def test_cracks_are_darker_than_the_same_module_without_them() -> None:
    base = replace(TINY, n_frames=1, pixels_per_unit=120, dark_cell_share=0.0, crack_share=1.0)
    scene = simulated(base).scene
    assert 0.005 < scene.cracks.mean() < 0.3
    light = scene.radiance
    around = cv2.medianBlur(light, 5)
    on_cell = around > 0.4
    contrast = light / np.maximum(around, 1e-3)
    assert contrast[scene.cracks & on_cell].mean() < contrast[~scene.cracks & on_cell].mean() - 0.01


def test_a_module_without_cracks_has_an_empty_mask() -> None:
    assert not simulated(replace(TINY, n_frames=1, crack_share=0.0)).scene.cracks.any()


def test_what_a_crack_cuts_off_from_every_busbar_is_dark() -> None:
    # Two busbars, at rows 10 and 30 of 40.
    barrier = np.zeros((40, 3), np.float32)
    barrier[5, 0] = 1.0  # beyond the outer busbar: all from the crack to the edge is lost
    barrier[20, 1] = 1.0  # between busbars: either side is still fed by its own
    barrier[[15, 25], 2] = 1.0  # two cracks between busbars: what lies between them is lost
    lost = cut_off(barrier, busbars=2)
    assert (lost[:6, 0] == 1).all()
    assert (lost[6:, 0] == 0).all()
    assert lost[:20, 1].max() <= 0.12 + 1e-6
    assert lost[21:, 1].max() <= 0.12 + 1e-6
    assert (lost[15:26, 2] == 1).all()
    assert lost[:15, 2].max() < 0.2


# streams and files


def test_the_seed_determines_everything(tiny: SimulatedSequence) -> None:
    again = simulated(TINY)
    np.testing.assert_array_equal(again.frames, tiny.frames)
    np.testing.assert_array_equal(again.scene.cracks, tiny.scene.cracks)
    other = simulated(replace(TINY, seed=1))
    assert not np.array_equal(other.frames, tiny.frames)


def test_more_frames_leave_the_module_and_the_first_frames_as_they_are(
    tiny: SimulatedSequence,
) -> None:
    longer = simulated(replace(TINY, n_frames=3))
    np.testing.assert_array_equal(longer.frames[:2], tiny.frames)
    np.testing.assert_array_equal(longer.scene.radiance, tiny.scene.radiance)


def test_frames_move_by_fractions_of_pixels(tiny: SimulatedSequence) -> None:
    shift = tiny.crossings_px(1) - tiny.crossings_px(0)
    assert 0.2 < np.abs(shift.mean(axis=0)).max() < 15
    assert shift.std(axis=0).max() > 0.01  # tilt and roll change, too


def test_progress_rises_to_one() -> None:
    fractions = [step.fraction for step in simulate(TINY)]
    assert fractions == sorted(fractions)
    assert fractions[0] > 0
    assert fractions[-1] == pytest.approx(1.0)


def test_written_files_say_what_was_simulated(tiny: SimulatedSequence, tmp_path: Path) -> None:
    write_sequence(tiny, tmp_path / "one")
    frames = sorted((tmp_path / "one" / "frames").iterdir())
    assert [path.name for path in frames] == ["frame_000.tif", "frame_001.tif"]
    for path, frame in zip(frames, tiny.frames, strict=True):
        np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), frame)
        np.testing.assert_array_equal(tifffile.imread(path), frame)
    module = json.loads((tmp_path / "one" / "module.json").read_text())
    assert module == {"rows": 3, "cols": 4, "cell_aspect": 1.0}
    truth = json.loads((tmp_path / "one" / "truth" / "truth.json").read_text())
    np.testing.assert_allclose(truth["frames"][1]["H"], tiny.poses[1].H)
    np.testing.assert_allclose(truth["frames"][1]["crossings_px"], tiny.crossings_px(1), atol=1e-5)
    hr = cv2.imread(str(tmp_path / "one" / "truth" / "hr.png"), cv2.IMREAD_UNCHANGED)
    step = 32 * truth["hr"]["value_scale"]
    np.testing.assert_allclose(
        hr * truth["hr"]["value_scale"], tiny.scene.radiance.clip(0, 1.499), atol=step / 2 + 1e-6
    )
    cracks = cv2.imread(str(tmp_path / "one" / "truth" / "cracks.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(cracks > 0, tiny.scene.cracks)


def test_a_folder_with_something_in_it_is_left_alone(
    tiny: SimulatedSequence, tmp_path: Path
) -> None:
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(InspectionError, match="not an empty folder: remove it or give another"):
        write_sequence(tiny, tmp_path)
    with pytest.raises(InspectionError, match="not an empty folder"):
        check_target(tmp_path)
    check_target(tmp_path / "new")
    assert [path.name for path in tmp_path.iterdir()] == ["note.txt"]


def test_an_empty_folder_is_filled(tiny: SimulatedSequence, tmp_path: Path) -> None:
    (tmp_path / "new").mkdir()
    write_sequence(tiny, tmp_path / "new")
    assert {path.name for path in (tmp_path / "new").iterdir()} == {
        "frames",
        "module.json",
        "truth",
    }


def test_a_disk_that_fills_up_leaves_nothing_behind(
    tiny: SimulatedSequence, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files_module, "_write_png", full)
    with pytest.raises(InspectionError, match=r"can't be written \(No space left on device\)"):
        write_sequence(tiny, tmp_path / "one")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not SCORER.exists(), reason="needs ../shared/tools/score_sequence.py")
def test_the_scorer_gives_the_truth_full_marks(tiny: SimulatedSequence, tmp_path: Path) -> None:
    write_sequence(tiny, tmp_path / "one")
    result = tmp_path / "result"
    result.mkdir()
    tifffile.imwrite(result / "module_hr.tif", tiny.scene.radiance)
    tifffile.imwrite(result / "cracks.tif", tiny.scene.cracks.astype(np.float32))
    frames = [
        {"file": name, "used": True, "crossings_px": tiny.crossings_px(i).tolist()}
        for i, name in enumerate(tiny.frame_names)
    ]
    content = {
        "pixels_per_cell": [60, 60],
        "origin_px": list(tiny.scene.origin_px),
        "magnification": 2,
        "camera": {"K": tiny.camera_matrix.tolist(), "kappa": TINY.kappa},
        "frames": frames,
        "seconds": {},
    }
    (result / "result.json").write_text(json.dumps(content))
    command = [sys.executable, str(SCORER), str(tmp_path / "one"), str(result)]
    score = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
    assert score["geometry"]["crossing_rmse_px"]["max"] < 1e-4
    assert score["hr"]["raw"]["psnr_db"] > 55
    assert score["cracks"]["max"]["segmentation"]["f1"] == pytest.approx(1.0)


# settings


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("rows", 0, "rows is 0 [cells], but a whole number from 1 to 60 is expected"),
        ("rows", 2.5, "rows is 2.5 [cells], but a whole number"),
        ("cols", True, "cols is True [cells], but a whole number"),
        ("kappa", float("nan"), "kappa is nan [1], but a number from -1 to 1"),
        ("exposure", "bright", "exposure is 'bright' [full scale], but a number"),
        ("wafer", "poly", "wafer is 'poly': use one of multi, mono"),
        ("shot_noise", 1, "shot_noise is 1: give True or False"),
        ("pixels_per_unit", 1000, "million samples"),
        ("black_level_dn", 300, "8 bits end at 255 DN"),
    ],
)
def test_a_wrong_setting_is_named_in_one_sentence(name: str, value: object, sentence: str) -> None:
    base = {"bit_depth": 8} if name == "black_level_dn" else {"rows": 12, "cols": 12}
    base |= {"black_level_dn": 10} if name != "black_level_dn" else {}
    with pytest.raises(InspectionError) as error:
        SimulationSettings(**{**base, name: value})  # type: ignore[arg-type]
    assert sentence in str(error.value)
    assert str(error.value).count(". ") == 0


def test_the_simulator_shares_no_model_with_the_inspection() -> None:
    """Frames made with the code under test would prove nothing (inverse crime)."""
    allowed = {"pv_inspect.errors", "pv_inspect.common.work", "pv_inspect.geometry.layout"}
    # How widths are written and where files go is no model.
    allowed |= {
        "pv_inspect.common.gap_text",
        "pv_inspect.storage.output_paths",
        "pv_inspect.storage.reservations",
        "pv_inspect.storage.temporaries",
    }
    for path in Path(pv_inspect.simulate.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            modules = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            modules += [a.name for a in node.names] if isinstance(node, ast.Import) else []
            for module in modules:
                if module.startswith("pv_inspect."):
                    assert module in allowed or module.startswith("pv_inspect.simulate")


def test_sequences_with_one_sensor_seed_are_of_one_camera() -> None:
    """Its pattern and dead pixels stay, the noise does not."""
    pattern = {"n_frames": 1, "dead_share": 0.02, "column_offset_e": 300.0, "black_level_dn": 400}
    settings = replace(TINY, **pattern)
    one, other, alone = (
        simulated(replace(each, sensor_seed=sensor), flat(each, 0.0)).frames[0].astype(float)
        for each, sensor in (
            (replace(settings, seed=1), 5),
            (replace(settings, seed=2), 5),
            (replace(settings, seed=2), -1),
        )
    )
    np.testing.assert_array_equal(one == 0, other == 0)
    assert ((one == 0) != (alone == 0)).any()
    columns = [np.median(frame, axis=0) for frame in (one, other, alone)]
    assert np.corrcoef(columns)[0, 1] > 0.9
    assert abs(np.corrcoef(columns)[0, 2]) < 0.5
    assert (one != other).mean() > 0.5
