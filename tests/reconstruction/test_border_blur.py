"""The blur that borders of cells tell, and what is made of all evidence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pv_inspect.common.work import result_of
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.reconstruction import psf_evidence
from pv_inspect.reconstruction.border_blur import EdgeBlur, blur_of_edges, common_moment
from pv_inspect.reconstruction.edge_samples import edge_samples
from pv_inspect.reconstruction.psf_estimate import PsfEstimate
from pv_inspect.reconstruction.psf_evidence import (
    TYPICAL,
    between_which,
    combined,
    estimate_psf,
)
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


def borders(folder: Path, scene: Scene, frames: int = 6, **changed: Any) -> EdgeBlur | None:
    sequence, registration, rays = recorded(folder, scene, replace(SETTINGS, **changed))
    still = np.zeros((len(sequence), 2))
    used = np.arange(len(sequence))[:frames]
    return blur_of_edges(edge_samples(sequence, registration, used, None, rays, still))


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
    samples = edge_samples(sequence, registration, np.arange(6), None, rays, still)
    assert len(samples) == 0
    assert blur_of_edges(samples) is None


def test_one_frame_has_too_few_borders(tmp_path: Path, scene: Scene) -> None:
    assert borders(tmp_path, scene, frames=1) is None


def test_borders_beside_busbars_are_not_read(tmp_path: Path) -> None:
    coarse = replace(SETTINGS, n_frames=1, busbars=12, pixels_per_unit=240)
    dense = simulated(coarse).scene
    found = borders(tmp_path, dense, psf_sigma_px=0.5)
    # One axis is left: its borders cross the busbars.
    assert found is None or abs(found.sigma - 0.5) < 2.5 * found.error


def test_the_sharpest_frames_tell_the_optics_from_motion() -> None:
    rng = np.random.default_rng(4)
    motion = np.where(rng.random(24) < 0.5, 0.0, rng.uniform(0.0, 0.9, 24))
    moments = 0.2 + motion**2 / 12 + 0.004 * rng.standard_normal(24)
    covariance = np.diag(np.full(24, 0.004**2))
    moment, error = common_moment(moments, covariance, np.zeros(24))
    assert moment == pytest.approx(0.2, abs=0.006)
    assert 0.0005 < error < 0.005


def test_a_motion_that_was_found_is_taken_off() -> None:
    motion = np.linspace(0.6, 1.6, 6)
    covariance = np.diag(np.full(6, 0.005**2))
    moment, _ = common_moment(0.25 + motion**2 / 12, covariance, motion)
    assert moment == pytest.approx(0.25, abs=0.02)
    # The first frame stands still and the others do not look it: their motions are false.
    false = common_moment(np.full(6, 0.25), covariance, np.array([0.0] + [1.4] * 5))
    assert false[0] == pytest.approx(0.25, abs=0.03)


def test_an_error_that_all_frames_share_is_not_averaged_out() -> None:
    moments = np.full(20, 0.25)
    alone = np.diag(np.full(20, 0.01**2))
    _, small = common_moment(moments, alone, np.zeros(20))
    _, large = common_moment(moments, alone + 0.02**2, np.zeros(20))
    assert small < 0.005
    assert large > 0.019


SHARP = EdgeBlur(0.5, 0.01, "disc", 50.0)


def test_held_out_pixels_decide_within_what_the_borders_allow() -> None:
    least, largest = between_which(SHARP, 50.0)
    assert least == pytest.approx(np.sqrt(0.5**2 - (0.0055 * 50) ** 2) - 0.01)
    assert largest == pytest.approx(0.51)
    assert combined(SHARP, 0.45, 50.0).sigma == 0.45
    assert combined(SHARP, 0.23, 50.0).sigma == pytest.approx(least)
    wide = combined(SHARP, 0.9, 50.0)
    assert wide.sigma == pytest.approx(largest)
    assert (wide.evidence, wide.shape) == ("borders and pixels", "disc")
    assert 0.01 < wide.error < (largest - least) / 2


def test_borders_of_a_wide_blur_leave_little_open() -> None:
    sharp = combined(replace(SHARP, sigma=0.3), None, 50.0)
    wide = combined(replace(SHARP, sigma=0.8), None, 50.0)
    assert wide.error / wide.sigma < 0.3 * sharp.error / sharp.sigma
    assert wide.sigma == pytest.approx(0.8, rel=0.05)


@pytest.mark.parametrize("pixels", [0.13, 1.49, None])
def test_a_limit_of_the_search_is_never_the_answer(pixels: float | None) -> None:
    assert combined(None, pixels, 50.0) == TYPICAL
    least, largest = between_which(SHARP, 50.0)
    assert least < combined(SHARP, pixels, 50.0).sigma < largest


def test_held_out_pixels_are_asked_only_if_borders_leave_it_open(
    tmp_path: Path, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    sequence, registration, rays = recorded(tmp_path, scene, replace(SETTINGS, psf_sigma_px=0.95))
    still = np.zeros((len(sequence), 2))
    monkeypatch.setattr(psf_evidence, "estimate_psf_sigma", None)
    found = result_of(estimate_psf(sequence, registration, None, rays, still))
    assert found.evidence == "borders"
    assert found.sigma == pytest.approx(0.95, rel=0.08)
    asked = []

    def held_out(*views: Any) -> Any:
        asked.append(views)
        yield 1.0
        return 0.4

    monkeypatch.setattr(psf_evidence, "estimate_psf_sigma", held_out)
    monkeypatch.setattr(psf_evidence, "blur_of_edges", lambda _: None)
    found = result_of(estimate_psf(sequence, registration, None, rays, still))
    assert (found.sigma, found.evidence, len(asked)) == (0.4, "pixels", 1)


def test_words_say_how_well_it_is_known() -> None:
    assert PsfEstimate(0.5, 0.013, "borders").words == ", ± 0.01, from the borders of the cells"
    assert "usual" in TYPICAL.words
    assert PsfEstimate(0.5, 0.0, "given").words == ", given"
