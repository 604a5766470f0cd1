"""The blur that borders of cells tell."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.observation.motion_blur import motion_of
from pv_inspect.reconstruction.border_blur import BorderBlur, blur_of_borders
from pv_inspect.reconstruction.border_samples import border_samples
from pv_inspect.reconstruction.psf_evidence import read_borders, without_contradicted
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.simulate import Scene, SimulationSettings, simulated

SETTINGS = SimulationSettings(
    rows=2,
    cols=3,
    width=160,
    height=116,
    n_frames=6,
    pixels_per_unit=400,
    wafer="mono",
    crack_share=0.0,
    dark_cell_share=0.0,
    motion_blur_px=0.0,
    seed=3,
)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return simulated(replace(SETTINGS, n_frames=1)).scene


def recorded(
    folder: Path, scene: Scene, settings: SimulationSettings
) -> tuple[FrameSequence, Registration, SensorRays]:
    """A simulated sequence with its true geometry."""
    made = simulated(settings, scene)
    np.save(folder / "frames.npy", made.frames)
    sequence, n = FrameSequence.open(folder / "frames.npy"), len(made.poses)
    registration = Registration(
        settings.layout,
        Camera(made.camera_matrix, settings.kappa),
        np.array([pose.H for pose in made.poses]),
        np.ones(n, bool),
        ("",) * n,
        np.array([pose.gain for pose in made.poses]),
        np.zeros(n),
        np.ones(n),
    )
    return sequence, registration, SensorRays.of(registration.camera, sequence.shape)


def borders(folder: Path, scene: Scene, frames: int = 6, **changed: Any) -> BorderBlur | None:
    sequence, registration, rays = recorded(folder, scene, replace(SETTINGS, **changed))
    still = np.zeros((len(sequence), 2))
    used = np.arange(len(sequence))[:frames]
    samples = border_samples(sequence, registration, used, None, rays, still)
    return blur_of_borders(samples, np.zeros(frames))


@pytest.mark.parametrize(("sigma", "shape"), [(0.45, "gaussian"), (0.7, "gaussian"), (0.6, "disc")])
def test_borders_tell_width_and_shape_of_the_blur(
    tmp_path: Path, scene: Scene, sigma: float, shape: str
) -> None:
    found = borders(tmp_path, scene, psf_sigma_px=sigma, psf_shape=shape)
    assert found is not None
    assert found.sigma == pytest.approx(sigma, rel=0.06)
    assert found.shape == shape
    assert found.error < 0.08 * sigma


def test_motion_that_was_not_noticed_is_no_blur_of_the_optics(tmp_path: Path, scene: Scene) -> None:
    found = borders(tmp_path, scene, psf_sigma_px=0.45, motion_blur_px=3.0, n_frames=8)
    assert found is not None
    assert found.sigma == pytest.approx(0.45, rel=0.08)


def test_gaps_too_wide_for_a_profile_are_left_out(tmp_path: Path) -> None:
    settings = replace(SETTINGS, cell_gap=0.1, pixels_per_unit=100)
    wide = simulated(replace(settings, n_frames=1)).scene
    sequence, registration, rays = recorded(tmp_path, wide, settings)
    still = np.zeros((len(sequence), 2))
    samples = border_samples(sequence, registration, np.arange(6), None, rays, still)
    assert len(samples) == 0
    assert blur_of_borders(samples, np.zeros(6)) is None


def test_one_frame_has_too_few_borders(tmp_path: Path, scene: Scene) -> None:
    assert borders(tmp_path, scene, frames=1) is None


def test_borders_beside_busbars_are_not_read(tmp_path: Path) -> None:
    coarse = replace(SETTINGS, n_frames=1, busbars=12, pixels_per_unit=240)
    dense = simulated(coarse).scene
    found = borders(tmp_path, dense, psf_sigma_px=0.5)
    # One axis is left: its borders cross the busbars.
    assert found is None or abs(found.sigma - 0.5) < 2.5 * found.error


def test_motions_that_borders_contradict_are_told(tmp_path: Path, scene: Scene) -> None:
    settings = replace(SETTINGS, psf_sigma_px=0.45)
    sequence, registration, rays = recorded(tmp_path, scene, settings)
    told = np.tile([1.4, 0.3], (len(sequence), 1))
    found = read_borders(sequence, registration, None, rays, told)
    assert found is not None
    assert found.still == tuple(range(len(sequence)))
    assert found.sigma == pytest.approx(0.45, rel=0.08)
    assert not without_contradicted(told, registration, found).any()


def test_motions_that_borders_show_are_kept(tmp_path: Path, scene: Scene) -> None:
    moving = replace(SETTINGS, psf_sigma_px=0.45, motion_blur_px=3.0)
    sequence, registration, rays = recorded(tmp_path, scene, moving)
    poses = simulated(moving, scene).poses
    true = np.array([motion_of(pose.motion_px, pose.motion_deg) for pose in poses])
    assert (np.hypot(*true.T) > 0.9).sum() > 3
    found = read_borders(sequence, registration, None, rays, true)
    assert found is not None
    assert found.still == ()
    assert without_contradicted(true, registration, found) is true


def test_frames_whose_borders_were_not_read_follow_the_majority(
    tmp_path: Path, scene: Scene
) -> None:
    _, registration, _ = recorded(tmp_path, scene, SETTINGS)
    n = 40
    many = replace(
        registration,
        homographies=np.repeat(registration.homographies[:1], n, axis=0),
        used=np.ones(n, bool),
        why=("",) * n,
        gain=np.ones(n),
        offset=np.zeros(n),
        rms=np.ones(n),
    )
    told = np.full((n, 2), 1.1)
    some = BorderBlur(0.5, 0.01, "disc", 50.0, still=tuple(range(4)))
    assert (~without_contradicted(told, many, some).any(axis=1)).sum() == 4
    most = replace(some, still=tuple(range(12)))
    assert (~without_contradicted(told, many, most).any(axis=1)).sum() == 32
    assert np.array_equal(without_contradicted(told, many, None), told)
