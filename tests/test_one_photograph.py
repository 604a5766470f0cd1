"""One photograph of a module, from the file to the classes of its cells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pv_inspect.cells import CellTiles
from pv_inspect.common.work import result_of
from pv_inspect.cracks import CrackMap, read_cracks
from pv_inspect.cracks.seen import would_show
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.inspection.summary import summary
from pv_inspect.pipeline import inspect
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.reconstruction.single_frame import bicubic
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings
from pv_inspect.simulate import SimulationSettings, simulated, write_sequence

ROOT = Path(__file__).resolve().parents[1]
SETTINGS = Settings(magnification=2)


def photograph(folder: Path) -> Inspection:
    """A module without a crack in sharp optics, seen by a sensor with many hot and dead pixels."""
    settings = SimulationSettings(
        seed=23,
        rows=3,
        cols=4,
        n_frames=1,
        width=190,
        height=150,
        kappa=-0.1,
        tilt_deg=6,
        psf_sigma_px=0.32,
        crack_share=0.0,
        dark_cell_share=0.0,
        hot_share=2e-3,
        dead_share=1e-3,
        pixels_per_unit=120,
        supersampling=4,
    )
    write_sequence(simulated(settings), folder / "one")
    return inspect(FrameSequence.open(folder / "one"), SETTINGS)


def stored_photograph() -> Inspection:
    folder = ROOT.parent / "shared" / "cases" / "06-single-frame-false-cracks"
    if not folder.is_dir():
        pytest.skip("the small inputs in ../shared/cases are not on this machine")
    return inspect(FrameSequence.open(folder), SETTINGS)


@pytest.fixture(scope="module", params=["simulated", "stored"])
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Inspection:
    if request.param == "stored":
        return stored_photograph()
    return photograph(tmp_path_factory.mktemp("photograph"))


def test_it_is_called_what_it_is(made: Inspection) -> None:
    assert made.need(Reconstruction).support.max() == 0.0
    assert made.warnings == (
        "1 frame: the result is a rectified single frame, not a super-resolution. Narrow or faint "
        "cracks that more frames would show may be missing.",
    )
    first = summary(made, Path("out"), 1.0).splitlines()[len(made.doubts)]
    assert first == f"warning   {made.warnings[0]}"


def test_its_cells_are_judged_by_what_could_be_seen(made: Inspection) -> None:
    cells = made.need(CrackMap).cells
    assert all(np.isfinite((cell.crack_detail, cell.edge_blur)).all() for cell in cells)
    unseen = [not would_show(cell.crack_detail, cell.edge_blur) for cell in cells]
    # 40 and 48 px per cell are on the verge of too coarse, however sharp.
    assert sum(unseen) > len(cells) // 2
    assert [cell.unsure for cell in cells] == unseen
    assert bool(made.doubts) == all(cell.undecidable for cell in cells)


def test_no_value_is_beyond_what_the_frame_shows(made: Inspection) -> None:
    frame, image = made.frames.frame(0), made.need(Reconstruction).image
    brightest = float(frame.image[frame.valid].max())
    assert image.min() >= -0.05
    # One hot pixel that was not found would be as bright as full scale.
    assert image.max() <= 1.1 * brightest
    assert image.max() < 0.9


def test_noise_is_not_turned_into_cracks(made: Inspection) -> None:
    """No more cells have a class than in the rectified frame itself."""
    grid = made.need(Reconstruction).grid
    plain = bicubic(made.frames, made.need(Registration), grid, 0)
    of_frame = result_of(read_cracks(CellTiles(plain, grid), SETTINGS))
    ours = made.need(CrackMap)
    assert ours.counts.suspected <= of_frame.counts.suspected
    assert ours.counts.suspected == 0
