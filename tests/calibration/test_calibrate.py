from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pv_inspect.calibration.bundle_adjustment import Bundle, Fit, View
from pv_inspect.calibration.calibrate import Calibration, calibrate
from pv_inspect.calibration.focal_length import FOCAL_CONVENTION, focal_length, focal_length_source
from pv_inspect.detection.crossings import Crossings, FrameCrossings
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.settings import Settings

SHAPE = (512, 640)
LAYOUT = ModuleLayout(6, 10)
CAMERA = Camera(np.array([[800.0, 0, 313.5], [0, 800.0, 260.5], [0, 0, 1]]), -0.2)


def rotation(tilt: float, axis: float, roll: float) -> np.ndarray:
    def about(v: np.ndarray, angle: float) -> np.ndarray:
        X = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
        return np.eye(3) + np.sin(angle) * X + (1 - np.cos(angle)) * X @ X

    tilted = about(np.array([np.cos(axis), np.sin(axis), 0]), tilt)
    return tilted @ about(np.array([0, 0, 1.0]), roll)


def poses(n: int, layout: ModuleLayout, tilt_deg: float, seed: int = 0) -> np.ndarray:
    """Homographies of a module that fills most of the frame."""
    rng = np.random.default_rng(seed)
    width, height = layout.size
    found = []
    for _ in range(n):
        tilt = np.deg2rad(tilt_deg + rng.uniform(-2, 2))
        R = rotation(tilt, 0.7 + rng.uniform(-0.3, 0.3), 0.05 * rng.standard_normal())
        to = np.array([0.1, 0.1, 1.55 * max(width, 1.2 * height)]) * [*rng.normal(size=2), 1]
        t = to - R[:, :2] @ [width / 2, height / 2]
        found.append(np.column_stack([R[:, :2], t]))
    return np.array(found)


def observed(
    homographies: np.ndarray,
    camera: Camera = CAMERA,
    layout: ModuleLayout = LAYOUT,
    noise: float = 0.0,
    outliers: float = 0.0,
    seed: int = 0,
) -> Crossings:
    rng = np.random.default_rng(seed)
    frames = []
    for H in homographies:
        px = camera.project(H, layout.crossings())
        inside = ((px >= 0) & (px <= [SHAPE[1] - 1, SHAPE[0] - 1])).all(axis=1)
        points = px + noise * rng.standard_normal(px.shape)
        wrong = rng.random(len(px)) < outliers
        points[wrong] += rng.uniform(5, 40, (int(wrong.sum()), 2))
        sigma = np.full(len(px), noise or 0.1)
        frames.append(FrameCrossings(points, sigma, inside, ""))
    return Crossings(layout, tuple(frames))


def error_px(
    fit: Calibration,
    homographies: np.ndarray,
    camera: Camera = CAMERA,
    layout: ModuleLayout = LAYOUT,
) -> float:
    truth = [camera.project(H, layout.crossings()) for H in homographies]
    got = [fit.crossings_px(i) for i in range(len(homographies))]
    squared = np.sum((np.array(got) - truth) ** 2, axis=2)
    return float(np.sqrt(np.mean(squared[fit.used])))


def replaced(crossings: Crossings, i: int, frame: FrameCrossings) -> Crossings:
    frames = list(crossings.frames)
    frames[i] = frame
    return Crossings(crossings.layout, tuple(frames))


@pytest.mark.parametrize("kappa", [-0.3, -0.05, 0.0, 0.11])
def test_without_noise_the_truth_is_found(kappa: float) -> None:
    H = poses(6, LAYOUT, 15)
    camera = Camera(CAMERA.K, kappa)
    fit = calibrate(observed(H, camera), SHAPE, Settings())
    assert fit.used.all()
    assert error_px(fit, H, camera) < 1e-3
    assert fit.camera.kappa == pytest.approx(kappa, abs=1e-4)
    assert fit.rms_px.max() < 1e-3


def test_principal_point_and_focal_length_are_found_where_they_show() -> None:
    fit = calibrate(observed(poses(10, LAYOUT, 18)), SHAPE, Settings())
    assert not fit.focal_convention
    np.testing.assert_allclose(fit.camera.K, CAMERA.K, rtol=0, atol=0.5)


def test_noise_is_averaged_and_outliers_do_not_count() -> None:
    H = poses(12, LAYOUT, 12)
    clean = calibrate(observed(H, noise=0.1), SHAPE, Settings())
    dirty = calibrate(observed(H, noise=0.1, outliers=0.05), SHAPE, Settings())
    # 8 parameters from 2 x 77 coordinates leave sqrt(16 / 154) of the noise per point.
    expected = 0.1 * np.sqrt(2) * np.sqrt(8 / 77)
    assert error_px(clean, H) < 1.2 * expected
    assert error_px(dirty, H) < 1.2 * error_px(clean, H)
    assert dirty.rms_px.max() < 0.2


def test_one_frame_in_which_a_third_of_the_crossings_is_wrong_is_held_by_the_rest() -> None:
    H = poses(5, LAYOUT, 12)
    crossings = observed(H, noise=0.05)
    points = crossings.frames[2].points_px.copy()
    points[::3] += [20.0, -11.0]
    spoiled = FrameCrossings(points, *_rest(crossings.frames[2]))
    fit = calibrate(replaced(crossings, 2, spoiled), SHAPE, Settings())
    assert fit.used.all()
    assert error_px(fit, H) < 0.1


def _rest(frame: FrameCrossings) -> tuple[np.ndarray, np.ndarray, str]:
    return frame.sigma_px, frame.measured, frame.why


def test_the_stated_deviation_of_kappa_is_the_observed_one() -> None:
    H = poses(4, LAYOUT, 12)
    given = Settings(focal_length_px=800.0)
    fits = [calibrate(observed(H, noise=0.2, seed=s), SHAPE, given) for s in range(14)]
    errors = np.array([fit.camera.kappa + 0.2 for fit in fits])
    stated = np.median([fit.kappa_std for fit in fits])
    assert 0.6 < np.sqrt(np.mean(errors**2)) / stated < 1.5


def test_errors_that_repeat_in_every_frame_count_once() -> None:
    H = poses(8, LAYOUT, 12)
    bias = 0.2 * np.random.default_rng(3).standard_normal((10, LAYOUT.n_crossings, 2))
    given = Settings(focal_length_px=800.0)
    fits = []
    for shift in bias:
        frames = [
            FrameCrossings(f.points_px + shift, *_rest(f)) for f in observed(H, noise=0.02).frames
        ]
        fits.append(calibrate(Crossings(LAYOUT, tuple(frames)), SHAPE, given))
    errors = np.array([fit.camera.kappa + 0.2 for fit in fits])
    stated = np.median([fit.kappa_std for fit in fits])
    assert 0.5 < np.sqrt(np.mean(errors**2)) / stated < 1.6


def test_head_on_the_focal_length_is_a_convention_and_moves_nothing() -> None:
    H = poses(5, LAYOUT, 0, seed=3)
    camera = Camera(np.array([[2400.0, 0, 319.5], [0, 2400.0, 255.5], [0, 0, 1]]), -1.0)
    H[:, 2] *= 3.0  # three times as far away
    crossings = observed(H, camera, noise=0.1)
    fit = calibrate(crossings, SHAPE, Settings())
    assert fit.focal_convention
    assert fit.camera.K[0, 0] == FOCAL_CONVENTION * 640
    other = calibrate(crossings, SHAPE, Settings(focal_length_px=1500.0))
    assert not other.focal_convention
    for i in range(len(H)):
        np.testing.assert_allclose(fit.crossings_px(i), other.crossings_px(i), rtol=0, atol=2e-3)
    ratio = (1500.0 / fit.camera.K[0, 0]) ** 2
    assert other.camera.kappa == pytest.approx(ratio * fit.camera.kappa, rel=0.01)


def test_a_given_kappa_is_kept_and_belongs_to_the_focal_length_found() -> None:
    H = poses(6, LAYOUT, 15)
    crossings = observed(H)
    free = calibrate(crossings, SHAPE, Settings())
    again = calibrate(crossings, SHAPE, Settings(kappa=free.camera.kappa))
    assert again.camera.kappa == free.camera.kappa
    assert again.kappa_std == 0.0
    assert error_px(again, H) < 1e-2
    wrong = calibrate(crossings, SHAPE, Settings(kappa=0.0, focal_length_px=800.0))
    assert wrong.camera.kappa == 0.0
    assert error_px(wrong, H) > 0.3


def test_a_single_frame_works() -> None:
    H = poses(1, LAYOUT, 15)
    fit = calibrate(observed(H, noise=0.05), SHAPE, Settings())
    assert fit.used.tolist() == [True]
    assert error_px(fit, H) < 0.1


def test_a_module_of_one_cell_has_no_kappa() -> None:
    layout = ModuleLayout(1, 1)
    H = poses(3, layout, 12)
    H[:, 2] *= 1.5
    fit = calibrate(observed(H, layout=layout, noise=0.1), SHAPE, Settings())
    assert fit.used.all()
    assert fit.camera.kappa == pytest.approx(0.0, abs=1e-6)
    assert fit.kappa_std > 0.1


def test_half_cut_cells_and_frames_cut_by_the_image_border_work() -> None:
    layout = ModuleLayout(20, 6, 2.0)
    H = poses(6, layout, 8)
    H[0] = H[0] @ np.array([[1, 0, -7.5], [0, 1, 0], [0, 0, 1]])
    crossings = observed(H, layout=layout, noise=0.1)
    assert not crossings.frames[0].measured.all()
    fit = calibrate(crossings, SHAPE, Settings())
    assert fit.used.all()
    assert error_px(fit, H, layout=layout) < 0.1


def test_frames_that_do_not_fit_are_rejected_with_the_reason() -> None:
    H = poses(7, LAYOUT, 12)
    crossings = observed(H, noise=0.1)
    rng = np.random.default_rng(0)
    n = LAYOUT.n_crossings
    sigma, measured, _ = _rest(crossings.frames[0])
    nonsense = FrameCrossings(rng.uniform(0, 500, (n, 2)), sigma, measured, "")
    few = FrameCrossings(crossings.frames[2].points_px, sigma, np.arange(n) < 5, "")
    none = FrameCrossings(np.full((n, 2), np.nan), sigma, measured, "")
    failed = FrameCrossings.failed(LAYOUT, "no module found")
    points = crossings.frames[5].points_px.reshape(7, 11, 2)[:, ::-1].reshape(-1, 2)
    mirrored = FrameCrossings(points, sigma, measured, "")
    for i, frame in enumerate([nonsense, few, none, failed, mirrored], start=1):
        crossings = replaced(crossings, i, frame)
    fit = calibrate(crossings, SHAPE, Settings())
    assert fit.used.tolist() == [True, False, False, False, False, False, True]
    assert "do not fit the module" in fit.why[1]
    assert fit.why[2] == "only 5 of 77 crossing points were measured"
    assert fit.why[3] == "crossing points not found"
    assert fit.why[4] == "no module found"
    assert fit.why[5] == "crossings are mirrored"
    assert fit.why[0] == fit.why[6] == ""
    assert np.isnan(fit.homographies[1:6]).all()
    assert np.isnan(fit.crossings_px(3)).all()
    assert error_px(fit, H) < 0.1


def test_points_on_a_line_are_rejected_not_a_crash() -> None:
    H = poses(3, LAYOUT, 12)
    crossings = observed(H)
    points, (sigma, _, _) = crossings.frames[1].points_px, _rest(crossings.frames[1])
    line = FrameCrossings(points, sigma, np.arange(LAYOUT.n_crossings) < 11, "")
    fit = calibrate(replaced(crossings, 1, line), SHAPE, Settings())
    assert fit.used.tolist() == [True, False, True]


def test_no_usable_frame_is_one_sentence_with_the_most_common_reason() -> None:
    failed = [FrameCrossings.failed(LAYOUT, why) for why in ("too dark", "no module", "too dark")]
    with pytest.raises(InspectionError, match=r"any of the 3 frames \(too dark in 2\): check"):
        calibrate(Crossings(LAYOUT, tuple(failed)), SHAPE, Settings())
    with pytest.raises(InspectionError, match="no frame to calibrate from"):
        calibrate(Crossings(LAYOUT, ()), SHAPE, Settings())


def test_unknown_deviations_do_no_harm() -> None:
    H = poses(4, LAYOUT, 12)
    crossings = observed(H, noise=0.1)
    frame = crossings.frames[0]
    sigma = frame.sigma_px.copy()
    sigma[:5] = [np.nan, 0.0, -1.0, np.inf, 1e-9]
    spoiled = FrameCrossings(frame.points_px, sigma, frame.measured, "")
    assert error_px(calibrate(replaced(crossings, 0, spoiled), SHAPE, Settings()), H) < 0.1


def test_a_frame_that_is_much_noisier_than_it_says_does_not_spoil_the_others() -> None:
    H = poses(5, LAYOUT, 12)
    crossings = observed(H, noise=0.05)
    frame = crossings.frames[1]
    points = frame.points_px + 0.6 * np.random.default_rng(2).standard_normal((77, 2))
    points[7] += 40.0
    spoiled = FrameCrossings(points, *_rest(frame))
    fit = calibrate(replaced(crossings, 1, spoiled), SHAPE, Settings())
    assert fit.used.all()
    errors = [fit.crossings_px(i) - CAMERA.project(h, LAYOUT.crossings()) for i, h in enumerate(H)]
    rms = np.sqrt(np.mean(np.sum(np.square(errors), axis=2), axis=1))
    assert rms[1] < 0.5
    assert np.delete(rms, 1).max() < 0.06


def test_crossings_that_are_pure_noise_end_in_one_sentence() -> None:
    rng = np.random.default_rng(4)
    n = LAYOUT.n_crossings
    frames = [
        FrameCrossings(rng.uniform(0, 500, (n, 2)), np.full(n, 0.1), np.ones(n, bool), "")
        for _ in range(4)
    ]
    with pytest.raises(InspectionError, match="could not be located in any of the 4 frames"):
        calibrate(Crossings(LAYOUT, tuple(frames)), SHAPE, Settings())


def test_the_order_of_frames_does_not_matter() -> None:
    H = poses(5, LAYOUT, 12)
    crossings = observed(H, noise=0.1)
    back = Crossings(LAYOUT, crossings.frames[::-1])
    first, second = (calibrate(c, SHAPE, Settings()) for c in (crossings, back))
    for i in range(5):
        np.testing.assert_allclose(
            first.crossings_px(i), second.crossings_px(4 - i), rtol=0, atol=1e-3
        )


def small_fit(kappa: float | None = None) -> Fit:
    H = poses(3, LAYOUT, 15)
    crossings = observed(H, noise=0.3)
    to_plane = np.array([[5.0, 0, 5], [0, 5, 3], [0, 0, 1]])
    points = (LAYOUT.crossings() - [5, 3]) / 5
    views = {
        3 * i: View(
            np.flatnonzero(f.measured),
            points[f.measured],
            f.points_px[f.measured],
            f.sigma_px[f.measured],
        )
        for i, f in enumerate(crossings.frames)
    }
    starts = {3 * i: h @ to_plane / (h @ to_plane)[2, 2] for i, h in enumerate(H)}
    bundle = Bundle(views, 800.0, (319.5, 255.5), 10.0, kappa)
    inliers = {i: np.ones(len(v.px), bool) for i, v in views.items()}
    return Fit(bundle, starts, np.array([-0.17, 315.0, 259.0]), inliers, scale=1.3)


@pytest.mark.parametrize("robust", [False, True])
@pytest.mark.parametrize("kappa", [None, -0.17])
def test_the_normal_equations_hold_the_gradient_of_the_cost(
    robust: bool, kappa: float | None
) -> None:
    fit = small_fit(kappa)
    equations = fit.normal_equations(robust)
    zero_h, zero_c = np.zeros_like(equations.a), np.zeros_like(equations.c)

    def slope(dh: np.ndarray, dc: np.ndarray) -> float:
        h = 1e-6
        ahead, behind = (fit.stepped(s * dh, s * dc).cost(robust) for s in (h, -h))
        return (ahead - behind) / (2 * h)

    for k, parameter in np.ndindex(equations.a.shape):
        dh = zero_h.copy()
        dh[k, parameter] = 1.0
        expected = slope(dh, zero_c)
        assert -2 * equations.a[k, parameter] == pytest.approx(expected, rel=1e-4, abs=0.05)
    for parameter in range(len(zero_c)):
        dc = zero_c.copy()
        dc[parameter] = 1.0
        expected = slope(zero_h, dc)
        assert -2 * equations.c[parameter] == pytest.approx(expected, rel=1e-4, abs=0.05)


def test_the_schur_complement_solves_the_full_normal_equations() -> None:
    equations = small_fit().normal_equations()
    n, m = len(equations.a), len(equations.c)
    full = np.zeros((8 * n + m, 8 * n + m))
    for k in range(n):
        rows = slice(8 * k, 8 * k + 8)
        full[rows, rows] = equations.A[k]
        full[rows, 8 * n :] = equations.B[k]
        full[8 * n :, rows] = equations.B[k].T
    full[8 * n :, 8 * n :] = equations.C
    steps, common = equations.solve(0.0)
    expected = np.linalg.solve(full, np.concatenate([equations.a.ravel(), equations.c]))
    np.testing.assert_allclose(np.append(steps, common), expected, rtol=1e-6, atol=1e-12)
    covariance = np.linalg.inv(full)[8 * n :, 8 * n :]
    np.testing.assert_allclose(equations.common_covariance(), covariance, rtol=1e-5)


def test_another_focal_length_moves_no_pixel() -> None:
    fit = small_fit()
    other = fit.with_focal_length(1234.0)
    for i in fit.homographies:
        np.testing.assert_allclose(other.distances_px(i), fit.distances_px(i), rtol=0, atol=1e-9)


def test_the_focal_length_comes_with_an_honest_deviation() -> None:
    ratios = []
    for seed in range(8):
        H = poses(8, LAYOUT, 14, seed)
        fit = small_fit().bundle
        crossings = observed(H, noise=0.2, seed=seed)
        points = (LAYOUT.crossings() - [5, 3]) / 5
        views = {
            i: View(np.arange(77), points, f.points_px, f.sigma_px)
            for i, f in enumerate(crossings.frames)
        }
        to_plane = np.array([[5.0, 0, 5], [0, 5, 3], [0, 0, 1]])
        starts = {i: h @ to_plane / (h @ to_plane)[2, 2] for i, h in enumerate(H)}
        bundle = Bundle(views, 768.0, fit.centre, 10.0, None)
        gauge = np.diag([800 / 768, 800 / 768, 1.0])
        found = focal_length(bundle.fit({i: gauge @ h for i, h in starts.items()}))
        assert found is not None
        ratios.append(np.log(found[0] / 800) / found[1])
    assert 0.4 < np.sqrt(np.mean(np.square(ratios))) < 1.8


@pytest.mark.parametrize("name", ["D2", "D3", "D5"])
def test_true_crossings_of_the_simulated_sequences_are_met(shared_sequences, name: str) -> None:
    truth = json.loads((shared_sequences / name / "truth" / "truth.json").read_text())
    layout = ModuleLayout(truth["rows"], truth["cols"], truth["cell_aspect"])
    camera = Camera(np.array(truth["K"]), truth["kappa"])
    H = np.array([frame["H"] for frame in truth["frames"] if frame["valid"]])
    fit = calibrate(observed(H, camera, layout), SHAPE, Settings())
    assert error_px(fit, H, camera, layout) < 1e-3
    assert not fit.focal_convention
    np.testing.assert_allclose(fit.camera.K, camera.K, rtol=0, atol=1.0)


def test_the_stated_deviation_of_the_crossings_is_the_observed_one() -> None:
    H = poses(4, LAYOUT, 12)
    truth = np.array([CAMERA.project(h, LAYOUT.crossings()) for h in H])
    fits = [calibrate(observed(H, noise=0.2, seed=s), SHAPE, Settings()) for s in range(40)]
    squared = [(np.array([f.crossings_px(i) for i in range(4)]) - truth) ** 2 for f in fits]
    rms = np.sqrt(np.mean(squared, axis=(0, 3)))
    stated = np.array([f.crossing_sigma_px for f in fits])
    assert stated.shape == (40, 4, LAYOUT.n_crossings)
    ratio = rms / np.median(stated, axis=0)
    assert 0.85 < np.median(ratio) < 1.15
    assert 0.6 < ratio.min() < ratio.max() < 1.6


def test_points_far_from_measured_ones_are_less_certain() -> None:
    H = poses(3, LAYOUT, 12)
    crossings = observed(H, noise=0.1)
    frame = crossings.frames[1]
    half = frame.measured & (LAYOUT.crossings()[:, 0] < 5)
    crossings = replaced(crossings, 1, FrameCrossings(frame.points_px, frame.sigma_px, half, ""))
    sigma = calibrate(crossings, SHAPE, Settings()).crossing_sigma_px
    assert sigma is not None
    edge = LAYOUT.crossings()[:, 0] == 10
    assert sigma[1][edge].min() > 3 * sigma[0][edge].max()
    failed = replaced(crossings, 2, FrameCrossings.failed(LAYOUT, "black"))
    sigma = calibrate(failed, SHAPE, Settings()).crossing_sigma_px
    assert sigma is not None
    assert np.isnan(sigma[2]).all()


def calibration_file(path: Path, K: np.ndarray, kappa: float | None) -> Path:
    entries = {"K": K.tolist(), **({} if kappa is None else {"kappa": kappa})}
    path.write_text(json.dumps(entries))
    return path


def test_the_camera_of_a_calibration_file_is_kept(tmp_path: Path) -> None:
    # Pixels that are not square: no fit would find that.
    camera = Camera(np.array([[800.0, 0, 310.0], [0, 830.0, 262.0], [0, 0, 1]]), -0.2)
    H = poses(4, LAYOUT, 12)
    path = calibration_file(tmp_path / "camera.json", camera.K, camera.kappa)
    settings = Settings(calibration_file=path)
    fit = calibrate(observed(H, camera), SHAPE, settings)
    np.testing.assert_allclose(fit.camera.K, camera.K, rtol=1e-15)
    assert fit.camera.kappa == -0.2
    assert fit.kappa_std == 0.0
    assert not fit.focal_convention
    assert focal_length_source(fit.camera, SHAPE, settings) == "given"
    assert error_px(fit, H, camera) < 1e-4


def test_a_file_without_distortion_leaves_kappa_to_the_fit_and_a_given_kappa_wins(
    tmp_path: Path,
) -> None:
    H = poses(4, LAYOUT, 12)
    settings = Settings(calibration_file=calibration_file(tmp_path / "c.json", CAMERA.K, None))
    fit = calibrate(observed(H), SHAPE, settings)
    np.testing.assert_array_equal(fit.camera.K, CAMERA.K)
    assert fit.camera.kappa == pytest.approx(-0.2, abs=1e-4)
    assert calibrate(observed(H), SHAPE, settings.changed(kappa=-0.19)).camera.kappa == -0.19


def test_a_file_and_a_focal_length_contradict_each_other(tmp_path: Path) -> None:
    settings = Settings(
        calibration_file=calibration_file(tmp_path / "c.json", CAMERA.K, None),
        focal_length_px=700.0,
    )
    with pytest.raises(InspectionError, match=r"Both a focal length \(700 px\) and a calibration"):
        calibrate(observed(poses(3, LAYOUT, 12)), SHAPE, settings)


def test_where_the_focal_length_comes_from_is_said() -> None:
    found = calibrate(observed(poses(10, LAYOUT, 18)), SHAPE, Settings())
    assert focal_length_source(found.camera, SHAPE, Settings()) == "identified"
    alone = calibrate(observed(poses(1, LAYOUT, 0), noise=0.1), SHAPE, Settings())
    assert focal_length_source(alone.camera, SHAPE, Settings()) == "convention"
    assert focal_length_source(found.camera, SHAPE, Settings(focal_length_px=800.0)) == "given"
