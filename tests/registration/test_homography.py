from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
import pytest

from pv_inspect.calibration.calibrate import calibrate
from pv_inspect.common.work import result_of
from pv_inspect.detection.crossings import Crossings, FrameCrossings
from pv_inspect.detection.detect import detect
from pv_inspect.errors import InspectionError
from pv_inspect.registration import homography as homography_registration
from pv_inspect.registration.homography import register_by_homography
from pv_inspect.registration.register import register
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from pv_inspect.simulate import (
    SimulatedSequence,
    SimulationSettings,
    simulated,
    write_sequence,
)

T = TypeVar("T")


def finish(generator: Generator[float, None, T]) -> T:
    fractions: list[float] = []
    result = result_of(generator, lambda step: fractions.append(step.fraction))
    assert fractions == sorted(fractions)
    assert all(0 <= f <= 1 for f in fractions)
    return result


@dataclass(frozen=True)
class Scene:
    simulation: SimulatedSequence
    sequence: FrameSequence
    crossings: Crossings
    plain: Registration

    def interframe_px(self, registration: Registration) -> float:
        """Spread over the frames of where the true crossings are put on the module."""
        found = np.array(
            [
                registration.camera.unproject(H, self.simulation.crossings_px(i))
                for i, H in enumerate(registration.homographies)
            ]
        )
        spread = found - found.mean(axis=0)
        return float(registration.lr_px_per_unit * np.sqrt((spread**2).sum(axis=-1).mean()))

    def error_px(self, registration: Registration) -> float:
        """RMS distance of the crossings from the true ones."""
        moved = [registration.crossings_px(i) - self.simulation.crossings_px(i) for i in range(5)]
        return float(np.sqrt(np.mean(np.sum(np.square(moved), axis=-1))))

    def by_camera(self) -> Registration:
        calibration = calibrate(self.crossings, self.sequence.shape, Settings())
        return finish(register(self.sequence, calibration, Settings()))


def made(folder: Path, kappa: float) -> Scene:
    simulation = simulated(
        SimulationSettings(
            seed=5, rows=4, cols=6, n_frames=5, width=288, height=216, kappa=kappa, tilt_deg=10,
            pixels_per_unit=160, supersampling=4, jitter_px=3.0, jitter_deg=0.6,
        )
    )  # fmt: skip
    write_sequence(simulation, folder / "sequence")
    sequence = FrameSequence.open(folder / "sequence")
    crossings = finish(detect(sequence, sequence.layout(Settings())))
    plain = finish(register_by_homography(sequence, crossings, Settings()))
    return Scene(simulation, sequence, crossings, plain)


@pytest.fixture(scope="module")
def straight(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return made(tmp_path_factory.mktemp("straight"), 0.0)


@pytest.fixture(scope="module")
def bent(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return made(tmp_path_factory.mktemp("bent"), -0.2)


def test_without_distortion_it_agrees_with_the_camera_model(straight: Scene) -> None:
    camera = straight.by_camera()
    assert straight.plain.used.all()
    assert straight.plain.camera.kappa == 0
    # Two independent ways from the measured crossings, whose noise is 0.1 px, to the module plane.
    assert straight.error_px(straight.plain) < straight.error_px(camera) + 0.05
    assert straight.error_px(straight.plain) < 0.1
    assert straight.interframe_px(straight.plain) < 0.03


def test_distortion_costs_what_the_missing_model_leaves(straight: Scene, bent: Scene) -> None:
    assert bent.plain.used.all()
    registration = bent.by_camera()
    plain, camera = bent.interframe_px(bent.plain), bent.interframe_px(registration)
    assert plain > 3 * camera
    assert bent.error_px(bent.plain) > 5 * bent.error_px(registration)
    assert plain > 2 * straight.interframe_px(straight.plain)


def test_a_person_may_leave_frames_out(straight: Scene) -> None:
    settings = Settings(skip_frames=("frame_002.tif",))
    registration = finish(register_by_homography(straight.sequence, straight.crossings, settings))
    assert registration.used.tolist() == [True, True, False, True, True]
    assert registration.why[2] == "left out as the settings say"


def test_gains_and_residuals_come_with_it(straight: Scene) -> None:
    gains = np.array([pose.gain for pose in straight.simulation.poses])
    gains /= np.exp(np.log(gains).mean())
    np.testing.assert_allclose(straight.plain.gain, gains, atol=0.01)
    assert np.all(straight.plain.rms < 2)
    # Gain and offset are relative to each other: on average none.
    used = straight.plain.used
    assert np.abs((straight.plain.offset[used] / straight.plain.gain[used]).mean()) < 1e-9
    assert straight.plain.offset[used].std() > 0


def test_pixels_do_not_depend_on_the_focal_length(straight: Scene) -> None:
    other = finish(
        register_by_homography(
            straight.sequence, straight.crossings, Settings(focal_length_px=700.0)
        )
    )
    assert other.camera.K[0, 0] == 700
    for i in range(5):
        np.testing.assert_allclose(
            other.crossings_px(i), straight.plain.crossings_px(i), rtol=0, atol=1e-6
        )


def test_what_does_not_converge_is_rejected_and_says_so(
    straight: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    def diverging(*_: Any) -> Any:
        raise cv2.error("The algorithm stopped before its convergence.")

    monkeypatch.setattr(homography_registration.cv2, "findTransformECC", diverging)
    alone = finish(register_by_homography(straight.sequence, straight.crossings, Settings()))
    assert alone.used.sum() == 1
    rejected = {why for ok, why in zip(alone.used, alone.why, strict=True) if not ok}
    assert rejected == {"the alignment to the reference frame (ECC) did not converge"}


def test_an_alignment_that_runs_away_is_rejected(
    straight: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    away = np.array([[1, 0, 40], [0, 1, 0], [0, 0, 1.0]])
    monkeypatch.setattr(homography_registration.cv2, "findTransformECC", lambda *_: (0.9, away))
    alone = finish(register_by_homography(straight.sequence, straight.crossings, Settings()))
    assert alone.used.sum() == 1
    assert any("lost it" in why for why in alone.why)


def test_a_frame_that_shows_something_else_is_rejected(straight: Scene) -> None:
    sequence = replace(straight.sequence, _cache=type(straight.sequence._cache)(8))
    frame = sequence.frame(2)
    upside_down = np.ascontiguousarray(frame.image[::-1, ::-1])
    # The same crossings, but another module in them.
    sequence._cache.put(2, replace(frame, image=upside_down))
    points = np.array(sequence.shape[::-1]) - 1 - straight.crossings.frames[2].points_px[::-1]
    turned = replace(straight.crossings.frames[2], points_px=points)
    frames = list(straight.crossings.frames)
    frames[2] = turned
    crossings = replace(straight.crossings, frames=tuple(frames))
    found = finish(register_by_homography(sequence, crossings, Settings()))
    assert not found.used[2]
    assert "not show the same module" in found.why[2] or "ECC" in found.why[2]
    assert found.used.sum() == 4


def test_frames_without_crossings_keep_their_reason(straight: Scene) -> None:
    layout = straight.crossings.layout
    frames = [*straight.crossings.frames[:3], FrameCrossings.failed(layout, "black")]
    few = straight.crossings.frames[4]
    measured = few.measured & (np.arange(layout.n_crossings) < 5)
    frames.append(replace(few, measured=measured))
    some = finish(
        register_by_homography(straight.sequence, Crossings(layout, tuple(frames)), Settings())
    )
    assert some.why[3:] == ("black", "only 5 of 35 crossing points were measured")
    assert np.isnan(some.homographies[3]).all()
    none = Crossings(layout, (frames[3],) * 5)
    with pytest.raises(InspectionError, match=r"No frame is left to register \(black\)"):
        finish(register_by_homography(straight.sequence, none, Settings()))
