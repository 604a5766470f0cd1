from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import pv_inspect.registration.register as registration_module
from pv_inspect.calibration.calibrate import Calibration
from pv_inspect.common.work import result_of
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.registration.alignment import N_PARAMETERS, accumulate_frame, normal_equations
from pv_inspect.registration.module_mean import module_mean
from pv_inspect.registration.register import register
from pv_inspect.registration.registration import Registration, unregistered
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from pv_inspect.simulate import SimulatedSequence

LAYOUT = ModuleLayout(4, 6)


def _true_calibration(simulation: SimulatedSequence) -> Calibration:
    count = len(simulation.poses)
    camera = Camera(simulation.camera_matrix, simulation.settings.kappa)
    return Calibration(
        layout=LAYOUT,
        camera=camera,
        homographies=np.array([pose.H for pose in simulation.poses]),
        used=np.ones(count, bool),
        why=("",) * count,
        rms_px=np.full(count, 0.1),
        focal_convention=False,
        kappa_std=0.0,
    )


def _disturbed(calibration: Calibration, sigma_px: float, seed: int = 0) -> Calibration:
    """Move the corners of the module in every frame at random and refit the homographies."""
    rng = np.random.default_rng(seed)
    corners = np.array([[0.0, 0], [6, 0], [6, 4], [0, 4]])
    homographies = calibration.homographies.copy()
    for i, H in enumerate(homographies):
        pixels = calibration.camera.project(H, corners) + rng.normal(0, sigma_px, (4, 2))
        rays = calibration.camera.undistort(calibration.camera.to_normalised(pixels))
        homographies[i] = cv2.getPerspectiveTransform(
            corners.astype(np.float32), rays.astype(np.float32)
        )
    return replace(calibration, homographies=homographies)


def _interframe_px(registration: Registration, simulation: SimulatedSequence) -> float:
    """Spread over the frames of where the true crossings are put on the module."""
    found = np.array(
        [
            registration.camera.unproject(registration.homographies[i], simulation.crossings_px(i))
            for i in np.flatnonzero(registration.used)
        ]
    )
    spread = found - found.mean(axis=0)
    return float(registration.lr_px_per_unit * np.sqrt((spread**2).sum(axis=-1).mean()))


@pytest.fixture(scope="module")
def scene(small_sequence: tuple[SimulatedSequence, Path]) -> tuple[FrameSequence, Calibration, Any]:
    simulation, folder = small_sequence
    return FrameSequence.open(folder), _true_calibration(simulation), simulation


def test_poses_that_are_a_pixel_off_come_back_to_a_fiftieth(
    scene: tuple[FrameSequence, Calibration, Any],
) -> None:
    sequence, truth, simulation = scene
    start = _disturbed(truth, 1.0)
    before = _interframe_px(unregistered(start), simulation)
    registration = result_of(register(sequence, start, Settings()))
    assert registration.used.all()
    assert before > 0.5
    assert _interframe_px(registration, simulation) < 0.02


def test_poses_stay_registered_where_there_are_too_few_frames_to_straighten(
    scene: tuple[FrameSequence, Calibration, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    sequence, truth, simulation = scene
    used = np.arange(8) < 4
    few = replace(_disturbed(truth, 1.0), used=used)
    starts: list[np.ndarray] = []
    align = registration_module._align

    def watched(*arguments: Any) -> Any:
        starts.append(arguments[6][0])
        return align(*arguments)

    monkeypatch.setattr(registration_module, "_align", watched)
    registration = result_of(register(sequence, few, Settings()))
    last = replace(registration, homographies=np.array([*starts[-4:], *starts[-4:]]))
    assert _interframe_px(last, simulation) < 0.1
    assert _interframe_px(registration, simulation) < 0.03


def test_the_crossings_end_where_the_gaps_are(
    scene: tuple[FrameSequence, Calibration, Any],
) -> None:
    sequence, truth, simulation = scene
    start = _disturbed(truth, 0.5, seed=4)
    camera = Camera(truth.camera.K, truth.camera.kappa + 0.01)
    start = replace(start, camera=camera, kappa_std=0.01)
    registration = result_of(register(sequence, start, Settings()))
    errors = [registration.crossings_px(i) - simulation.crossings_px(i) for i in range(8)]
    before = [start.crossings_px(i) - simulation.crossings_px(i) for i in range(8)]
    assert np.sqrt(np.square(before).sum(axis=-1).mean()) > 0.5
    assert np.sqrt(np.square(errors).sum(axis=-1).mean()) < 0.1


def test_gains_follow_the_flicker_of_the_light(
    scene: tuple[FrameSequence, Calibration, Any],
) -> None:
    sequence, truth, simulation = scene
    registration = result_of(register(sequence, truth, Settings()))
    gains = np.array([pose.gain for pose in simulation.poses])
    gains /= np.exp(np.log(gains).mean())
    np.testing.assert_allclose(registration.gain, gains, atol=0.01)
    assert np.all(registration.rms < 3)


def test_a_camera_out_of_a_file_stays_as_it_is(
    scene: tuple[FrameSequence, Calibration, Any],
) -> None:
    sequence, truth, _ = scene
    start = replace(truth, kappa_std=0.05)
    settings = Settings(calibration_file=Path("camera.yml"))
    fixed = result_of(register(sequence, start, settings)).camera
    free = result_of(register(sequence, start, Settings())).camera
    assert fixed.kappa == pytest.approx(truth.camera.kappa, abs=1e-9)
    assert abs(free.kappa - truth.camera.kappa) > 1e-6


class _Swapped:
    """The sequence with one frame replaced."""

    def __init__(self, sequence: FrameSequence, index: int, image: np.ndarray) -> None:
        self._sequence, self._index, self._image = sequence, index, image
        self.shape, self.noise, self.names = sequence.shape, sequence.noise, sequence.names

        self.indices, self.no_measurements = sequence.indices, sequence.no_measurements

    def __len__(self) -> int:
        return len(self._sequence)

    def frame(self, index: int) -> Any:
        frame = self._sequence.frame(index)
        return replace(frame, image=self._image) if index == self._index else frame


def _mirrored(calibration: Calibration, frame: int, shape: tuple[int, int]) -> np.ndarray:
    """Homographies with one fitted to the crossing points of the mirrored frame."""
    order = np.arange(LAYOUT.n_crossings).reshape(LAYOUT.rows + 1, -1)[:, ::-1].ravel()
    pixels = calibration.crossings_px(frame)[order]
    pixels[:, 0] = shape[1] - 1 - pixels[:, 0]
    rays = calibration.camera.undistort(calibration.camera.to_normalised(pixels))
    homographies = calibration.homographies.copy()
    homographies[frame], _ = cv2.findHomography(LAYOUT.crossings(), rays, 0)
    return homographies


def test_a_frame_of_another_module_is_rejected_with_its_reason(
    scene: tuple[FrameSequence, Calibration, Any],
) -> None:
    sequence, truth, _ = scene
    # The same outline and gaps with the cells of the module mirrored: another module.
    other = np.ascontiguousarray(sequence.frame(3).image[:, ::-1])
    calibration = replace(truth, homographies=_mirrored(truth, 3, sequence.shape))
    registration = result_of(register(_Swapped(sequence, 3, other), calibration, Settings()))
    assert not registration.used[3]
    assert registration.why[3].startswith(
        "it shows another module than the 7 frames of the largest group (agreement "
    )
    assert registration.used.sum() == 7
    assert np.isnan(registration.rms[3])


def test_a_person_may_keep_and_leave_out_frames(
    scene: tuple[FrameSequence, Calibration, Any],
) -> None:
    sequence, truth, _ = scene
    other = np.ascontiguousarray(sequence.frame(3).image[::-1, ::-1])
    swapped = _Swapped(sequence, 3, other)
    settings = Settings(keep_frames=("frame_003.tif",), skip_frames=("frame_001.tif",))
    registration = result_of(register(swapped, truth, settings))
    assert registration.used[3]
    assert not registration.used[1]
    assert registration.why[1] == "left out as the settings say"
    with pytest.raises(InspectionError, match=r"no frame 'x\.tif' .* frame_000\.tif to"):
        result_of(register(sequence, truth, Settings(skip_frames=("x.tif",))))


def test_a_frame_taken_upside_down_is_turned_and_used(
    scene: tuple[FrameSequence, Calibration, Any],
) -> None:
    sequence, truth, _ = scene
    upside_down = np.ascontiguousarray(sequence.frame(3).image[::-1, ::-1])
    # As the detection may have it: the outline alone does not say which way up.
    pixels = np.array([sequence.shape[1] - 1, sequence.shape[0] - 1]) - truth.crossings_px(3)[::-1]
    rays = truth.camera.undistort(truth.camera.to_normalised(pixels))
    homographies = truth.homographies.copy()
    homographies[3], _ = cv2.findHomography(LAYOUT.crossings(), rays, 0)
    calibration = replace(truth, homographies=homographies)
    registration = result_of(register(_Swapped(sequence, 3, upside_down), calibration, Settings()))
    assert registration.used.all()
    # The top left crossing of the module is now at the bottom right of that frame.
    np.testing.assert_allclose(registration.crossings_px(3)[-1], pixels[0], atol=1.0)


def test_one_frame_is_registered_to_itself(scene: tuple[FrameSequence, Calibration, Any]) -> None:
    sequence, truth, _ = scene
    used = np.zeros(8, bool)
    used[0] = True
    registration = result_of(register(sequence, replace(truth, used=used), Settings()))
    moved = registration.crossings_px(0) - truth.crossings_px(0)
    assert registration.gain[0] == 1
    assert np.abs(moved).max() < 0.05


def test_nothing_to_register_is_said_in_one_sentence(
    scene: tuple[FrameSequence, Calibration, Any],
) -> None:
    sequence, truth, _ = scene
    none = replace(truth, used=np.zeros(8, bool), why=("black",) * 8)
    with pytest.raises(InspectionError, match=r"No frame is left to register \(black\)"):
        result_of(register(sequence, none, Settings()))


def test_the_module_mean_of_ramps_is_a_ramp() -> None:
    camera = Camera(np.array([[300.0, 0, 99.5], [0, 300, 79.5], [0, 0, 1]]), -0.2)
    H = np.array([[0.1, 0.01, -0.3], [-0.01, 0.1, -0.2], [0.01, 0.0, 1.0]])
    grid = HrGrid.covering(LAYOUT, 30, 1.5)
    rows, cols = np.mgrid[0:160, 0:200].astype(np.float32)
    image = 0.3 + 0.001 * cols - 0.002 * rows
    total, weight = np.zeros((2, *grid.shape), np.float32)
    valid = np.ones(image.shape, bool)
    accumulate_frame(total, weight, image, valid, H @ grid.matrix, camera.K, -0.2, 2.0, 0.1)
    row, col = np.argwhere(weight > 0)[::500].T
    pixels = camera.project(H, grid.to_module(np.column_stack([col, row]).astype(float)))
    expected = (0.3 + 0.001 * pixels[:, 0] - 0.002 * pixels[:, 1] - 0.1) / 2
    np.testing.assert_allclose(total[row, col], expected, atol=2e-6)


def test_the_normal_equations_are_the_gradient_of_the_squared_residual() -> None:
    rng = np.random.default_rng(1)
    shape, grid_shape = (60, 70), (90, 110)
    module = cv2.GaussianBlur(rng.normal(0.5, 1.0, grid_shape).astype(np.float32), (0, 0), 4)
    image = cv2.GaussianBlur(rng.normal(0.5, 1.0, shape).astype(np.float32), (0, 0), 4)
    rays = np.stack(np.mgrid[0:60, 0:70][::-1], axis=-1).astype(np.float64)
    rays[0, 0] = np.nan
    precision = rng.uniform(0.5, 2, shape).astype(np.float32)
    # Away from the border, so that steps do not change which pixels take part.
    precision[:8] = precision[-8:] = 0
    precision[:, :8] = precision[:, -8:] = 0
    covered = np.ones(grid_shape, bool)
    to_grid = np.array([[1.2, 0.05, 10.0], [-0.03, 1.3, 4.0], [1e-4, -2e-4, 1.0]])
    size = 55.0
    half = np.array([109 / 2, 89 / 2])
    scale = np.array([[1 / size, 0, -half[0] / size], [0, 1 / size, -half[1] / size], [0, 0, 1]])

    def equations(p: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, float]:
        D = np.append(p[:8], 0.0).reshape(3, 3)
        moved = np.linalg.inv(scale) @ (np.eye(3) + D) @ scale @ to_grid
        result: tuple[np.ndarray, np.ndarray, float, float] = normal_equations(
            image, precision, rays, module, covered, moved, size,
            1.3 + p[8], 0.2 + p[9], 1e9, 1,
        )  # fmt: skip
        return result

    A, b, _, count = equations(np.zeros(N_PARAMETERS))
    assert count == (60 - 16) * (70 - 16)
    np.testing.assert_allclose(A, A.T)
    step = 1e-5
    for k in range(N_PARAMETERS):
        direction = step * np.eye(N_PARAMETERS)[k]
        slope = (equations(direction)[2] - equations(-direction)[2]) / (2 * step)
        assert slope == pytest.approx(-2 * b[k], rel=2e-3, abs=1e-3 * np.abs(b).max())


def test_the_module_mean_marks_what_no_frame_sees(
    scene: tuple[FrameSequence, Calibration, Any],
) -> None:
    sequence, truth, _ = scene
    state = unregistered(truth)
    grid = HrGrid.covering(LAYOUT, state.lr_px_per_unit, 1.0, margin=3.0)
    mean, covered = module_mean(sequence, state, grid)
    assert not covered.all()
    assert np.all(mean[~covered] == 0)


def test_a_frame_whose_equations_are_singular_is_left_out_with_its_reason(
    scene: tuple[FrameSequence, Calibration, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    sequence, truth, _ = scene
    align, calls = registration_module._align, 0

    def failing(*arguments: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == 2:
            raise np.linalg.LinAlgError("Singular matrix")
        return align(*arguments)

    monkeypatch.setattr(registration_module, "_align", failing)
    found = result_of(register(sequence, truth, Settings()))
    assert found.why[1] == "registration did not converge"
    assert list(np.flatnonzero(~found.used)) == [1]
    assert np.isfinite(found.homographies[found.used]).all()


def test_crossings_that_a_frame_does_not_show_say_nothing_of_the_common_homography() -> None:
    # The first frame shows the left, the second the right; between them a column is in neither.
    homographies = np.array([[[1.0, 0, -x], [0, 1, -2], [0, 0, 10]] for x in (1.0, 5.0)])
    camera = Camera(np.array([[300.0, 0, 50], [0, 300, 60], [0, 0, 1]]), -0.1)
    calibration = Calibration(
        LAYOUT, camera, homographies, np.ones(2, bool), ("", ""), np.zeros(2), False, 0.0
    )
    other = replace(unregistered(calibration), camera=Camera(camera.K, 0.1))
    found = registration_module._mean_crossings(other, calibration, (121, 101))
    found = found.reshape(LAYOUT.rows + 1, LAYOUT.cols + 1, 2)
    for side, H in ((slice(0, 3), homographies[0]), (slice(4, 7), homographies[1])):
        points = LAYOUT.crossings().reshape(*found.shape)[:, side].reshape(-1, 2)
        there = other.camera.unproject(H, camera.project(H, points))
        np.testing.assert_allclose(found[:, side].reshape(-1, 2), there, atol=1e-9)
    assert np.isnan(found[:, 3]).all()
