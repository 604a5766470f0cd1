"""What detection, calibration and registration together must not depend on."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile

from pv_inspect.calibration.calibrate import calibrate
from pv_inspect.common.work import result_of
from pv_inspect.detection.detect import detect
from pv_inspect.registration.register import register
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from pv_inspect.simulate import SimulatedSequence, SimulationSettings, simulated

Small = tuple[SimulatedSequence, Path]

ROWS, COLS, N = 4, 6, 8
ROUNDING_PX = 1e-5
"""The module image is summed in float32, in the order and the units of the frames."""
TRANSPOSED_PX = 5e-3
"""The fixed pattern of columns is taken out of the frames; transposed, it is one of rows."""
REPITCHED_PX = 2e-2
"""With the unit, the cell width, the pitch of the module image changes as well."""


def located(sequence: FrameSequence, settings: Settings) -> Registration:
    crossings = result_of(detect(sequence, sequence.layout(settings)))
    calibration = calibrate(crossings, sequence.shape, settings)
    return result_of(register(sequence, calibration, settings))


def crossings_px(registration: Registration) -> np.ndarray:
    """All crossings, (n_frames, rows + 1, cols + 1, 2)."""
    assert registration.used.all()
    layout = registration.layout
    points = [registration.crossings_px(i) for i in range(len(registration.used))]
    return np.array(points).reshape(-1, layout.rows + 1, layout.cols + 1, 2)


def written(folder: Path, frames: np.ndarray) -> Path:
    folder.mkdir()
    for i, frame in enumerate(frames):
        tifffile.imwrite(folder / f"frame_{i:03d}.tif", frame)
    return folder


@pytest.fixture(scope="module")
def settings() -> Settings:
    return Settings(rows=ROWS, cols=COLS)


@pytest.fixture(scope="module")
def usual(small_sequence: Small, settings: Settings) -> np.ndarray:
    return crossings_px(located(FrameSequence.open(small_sequence[1]), settings))


def test_the_order_of_the_frames_does_not_matter(
    small_sequence: Small, settings: Settings, usual: np.ndarray
) -> None:
    order = np.random.default_rng(2).permutation(N)
    files = sorted((small_sequence[1] / "frames").iterdir())
    shuffled = crossings_px(located(FrameSequence.open([files[i] for i in order]), settings))
    assert np.abs(shuffled - usual[order]).max() < ROUNDING_PX


def test_the_brightness_does_not_matter(
    small_sequence: Small, settings: Settings, usual: np.ndarray, tmp_path: Path
) -> None:
    folder = written(tmp_path / "scaled", 3 * small_sequence[0].frames)
    scaled = crossings_px(located(FrameSequence.open(folder), settings))
    assert np.abs(scaled - usual).max() < ROUNDING_PX


def transposed(frames: np.ndarray, rows: int, cols: int, aspect: float, folder: Path) -> np.ndarray:
    """Crossings of transposed frames, put back to where they are in the original ones."""
    written(folder, frames.transpose(0, 2, 1))
    sidecar = {"rows": cols, "cols": rows, "cell_aspect": 1 / aspect}
    (folder / "module.json").write_text(json.dumps(sidecar))
    turned = crossings_px(located(FrameSequence.open(folder), Settings()))
    return turned.transpose(0, 2, 1, 3)[..., ::-1]


def test_a_transposed_module_has_transposed_crossings(
    small_sequence: Small, usual: np.ndarray, tmp_path: Path
) -> None:
    back = transposed(small_sequence[0].frames, ROWS, COLS, 1.0, tmp_path / "transposed")
    assert np.abs(back - usual).max() < TRANSPOSED_PX


def test_transposing_half_cut_cells_inverts_their_aspect(tmp_path: Path) -> None:
    simulation = simulated(
        SimulationSettings(
            seed=8, rows=8, cols=3, cell_aspect=2.0, n_frames=3, width=200, height=240, kappa=-0.1,
            tilt_deg=8, pixels_per_unit=160, supersampling=4, jitter_px=2.0,
        )
    )  # fmt: skip
    folder = written(tmp_path / "upright", simulation.frames)
    upright = located(FrameSequence.open(folder), Settings(rows=8, cols=3, cell_aspect=2.0))
    back = transposed(simulation.frames, 8, 3, 2.0, tmp_path / "transposed")
    assert np.abs(back - crossings_px(upright)).max() < REPITCHED_PX
