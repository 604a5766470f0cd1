"""Fixtures shared by the tests of the core."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import settings as hypothesis_settings

from pv_inspect.simulate import (
    SimulatedSequence,
    SimulationSettings,
    simulated,
    write_sequence,
)
from tests.once import made_once

ROOT = Path(__file__).resolve().parents[1]

# How long an example takes says how busy the machine is.
hypothesis_settings.register_profile("any machine", deadline=None)
hypothesis_settings.load_profile("any machine")


@pytest.fixture(scope="session")
def shared_sequences() -> Path:
    """Folder of the simulated sequences with truth that lies beside the repository."""
    folder = ROOT.parent / "shared" / "data" / "sequences"
    if not folder.is_dir():
        pytest.skip("the sequences in ../shared/data/sequences are not on this machine")
    return folder


@pytest.fixture(scope="session")
def small_sequence(tmp_path_factory: pytest.TempPathFactory) -> tuple[SimulatedSequence, Path]:
    """Eight frames of 4 x 6 cells, 288 x 216 px, with their truth in memory and on disk."""
    settings = SimulationSettings(
        seed=5,
        rows=4,
        cols=6,
        n_frames=8,
        width=288,
        height=216,
        kappa=-0.15,
        tilt_deg=10,
        pixels_per_unit=160,
        supersampling=4,
        jitter_px=2.0,
    )

    def made() -> tuple[SimulatedSequence, Path]:
        simulation = simulated(settings)
        folder = tmp_path_factory.mktemp("sequences") / "small"
        write_sequence(simulation, folder)
        return simulation, folder

    return made_once(tmp_path_factory, "small_sequence", made)


@pytest.fixture(scope="session")
def quick_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of eight frames of 3 x 5 cells, 180 x 120 px, for what runs all stages.

    Its cells are clean, suspected and dark; of every second frame alone none can be judged.
    """
    settings = SimulationSettings(
        seed=6,
        rows=3,
        cols=5,
        n_frames=8,
        width=180,
        height=120,
        kappa=-0.15,
        tilt_deg=10,
        pixels_per_unit=120,
        supersampling=3,
        jitter_px=2.0,
    )

    def made() -> Path:
        folder = tmp_path_factory.mktemp("sequences") / "quick"
        write_sequence(simulated(settings), folder)
        return folder

    return made_once(tmp_path_factory, "quick_folder", made)
