from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from pv_inspect.cli import app as cli
from pv_inspect.cracks.module_pictures import module_in
from pv_inspect.simulate import SimulatedSequence, SimulationSettings, simulated
from tests.cracks.test_network import cell

TRAIN = Path(__file__).parents[3] / "shared" / "data" / "cracks" / "train" / "img"


def test_a_frame_of_a_module_is_seen_as_one_with_its_layout(
    small_sequence: tuple[SimulatedSequence, Path],
) -> None:
    frame = np.asarray(small_sequence[0].frames[0], np.float32)
    found = module_in(frame)
    assert found is not None
    assert (found.rows, found.cols) == (4, 6)


def test_a_module_that_is_cut_out_at_its_edges_is_seen() -> None:
    settings = SimulationSettings(
        seed=3, rows=3, cols=5, n_frames=1, width=400, height=300, kappa=0, tilt_deg=0,
        supersampling=2, pixels_per_unit=100,
    )  # fmt: skip
    frame = np.asarray(simulated(settings).frames[0], np.float32)
    bright = cv2.blur(frame, (9, 9)) > 0.3 * np.percentile(frame, 95)
    rows, cols = np.flatnonzero(bright.mean(1) > 0.4), np.flatnonzero(bright.mean(0) > 0.4)
    cut = frame[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    found = module_in(cut)
    assert found is not None
    assert (found.rows, found.cols) == (3, 5)


@pytest.mark.parametrize("n_busbars", [0, 2, 3, 5, 9])
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("fingers", [0, 80])
def test_busbars_and_fingers_make_no_module(n_busbars: int, turned: bool, fingers: int) -> None:
    image = cell(400, 400, crack=False)
    image[10:-10, 10:-10] = 0.7
    image += np.random.default_rng(n_busbars).normal(0, 0.02, image.shape).astype(np.float32)
    for k in range(n_busbars):
        y = round(400 * (k + 0.5) / n_busbars)
        image[y - 2 : y + 3] *= 0.3
    for k in range(fingers):
        image[:, round(400 * (k + 0.5) / fingers)] *= 0.93
    assert module_in(np.ascontiguousarray(image.T if turned else image)) is None


@pytest.mark.skipif(not TRAIN.is_dir(), reason="the photographs of cells are not there")
def test_photographs_of_cells_are_cells() -> None:
    for path in sorted(TRAIN.iterdir())[5::120]:
        assert module_in(np.asarray(cv2.imread(str(path), 0), np.float32)) is None, path.name


def test_a_module_among_cells_is_told_and_counted_as_no_cell(
    small_sequence: tuple[SimulatedSequence, Path], tmp_path: Path
) -> None:
    images = tmp_path / "images"
    images.mkdir()
    cv2.imwrite(
        str(images / "cell.png"), np.round(cell(200, 200, crack=False) * 255).astype(np.uint8)
    )
    frame = sorted((small_sequence[1] / "frames").iterdir())[0]
    (images / f"module{frame.suffix}").write_bytes(frame.read_bytes())
    command = ["cracks", str(images), "--out", str(tmp_path / "out"), "--detector", "ridge"]
    run = CliRunner().invoke(cli.app, command)
    assert run.exit_code == 1
    said = [line for line in run.stderr.splitlines() if "module" in line]
    assert len(said) == 1
    assert "shows a grid of about 4 x 6 cells" in said[0]
    assert "`pv-inspect run`" in said[0]
    assert "the cell is clean" in run.stdout
    assert "1 image could not be used" in run.stdout
    assert not (tmp_path / "out" / "module.tif").exists()
