"""The truth on a grid: area means, turns, and files that are damaged."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pv_inspect.errors import InspectionError
from pv_inspect.evaluation.grid_record import GridRecord
from pv_inspect.evaluation.truth import Truth, read_truth
from pv_inspect.simulate import SimulatedSequence

SIZE = (3.0, 2.0)


def grid_of(pixels_per_unit: float) -> GridRecord:
    height, width = (round(n * pixels_per_unit) for n in SIZE[::-1])
    return GridRecord(
        rows=2,
        cols=3,
        size=SIZE,
        pixels_per_unit=pixels_per_unit,
        origin_px=(-0.5, -0.5),
        magnification=4.0,
        windows={"0,0": (0, height, 0, width)},
        geometry_cpu_s=0.0,
        frames_used=1,
        frames=1,
    )


def test_pixels_of_the_grid_are_means_of_the_scene() -> None:
    values = np.random.default_rng(0).random((40, 60))
    truth = Truth(values, values > 0.5, 20.0, (-0.5, -0.5))
    grid = grid_of(10.0)
    found = truth.on(grid, grid.window((0, 0)))
    expected = values.reshape(20, 2, 30, 2).mean((1, 3))
    assert found == pytest.approx(expected, abs=1e-6)
    marked = truth.cracks_on(grid, grid.window((0, 0)))
    shares = (values > 0.5).reshape(20, 2, 30, 2).mean((1, 3))
    assert marked is not None
    assert (marked == (shares >= 0.5)).all()


def test_four_quarter_turns_are_none() -> None:
    values = np.random.default_rng(1).random((43, 64))
    truth = Truth(values, None, 20.0, (1.25, 0.5))
    turned, size = truth, SIZE
    for _ in range(4):
        turned = turned.turned(1, size)
        size = size[::-1]
    assert (turned.radiance == values).all()
    assert turned.origin_px == pytest.approx(truth.origin_px)


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_a_turn_moves_a_bright_point_as_the_module_turns(turns: int) -> None:
    values = np.zeros((48, 68))
    truth = Truth(values, None, 20.0, (3.5, 3.5))
    at = np.array([2.3, 0.4])  # module units
    x, y = np.round(np.array(truth.origin_px) + 20 * at).astype(int)
    values[y, x] = 1.0
    turned = truth.turned(turns, SIZE)
    place, size = at, np.array(SIZE)
    for _ in range(turns):  # counterclockwise in the picture: (x, y) goes to (y, width - x)
        place, size = np.array([place[1], size[0] - place[0]]), size[::-1]
    row, col = np.unravel_index(turned.radiance.argmax(), turned.radiance.shape)
    found = (np.array([col, row]) - turned.origin_px) / 20
    assert found == pytest.approx(place, abs=0.03)


def test_the_truth_of_a_simulated_sequence_is_its_scene(
    small_sequence: tuple[SimulatedSequence, Path],
) -> None:
    made, folder = small_sequence
    read = read_truth(folder)
    assert read is not None
    truth, shape = read
    assert shape == (made.settings.rows, made.settings.cols)
    assert truth.origin_px == pytest.approx(made.scene.origin_px)
    assert np.abs(truth.radiance - made.scene.radiance).max() < 2e-3
    assert truth.cracks is not None
    assert (truth.cracks == made.scene.cracks).all()


def test_a_sequence_without_truth_has_none(tmp_path: Path) -> None:
    assert read_truth(tmp_path) is None


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("{", "no JSON"),
        ("{}", "rows"),
        (json.dumps({"rows": 2, "cols": 3, "hr": {"file": "hr.png"}}), "px_per_unit"),
        (
            json.dumps(
                {
                    "rows": 2,
                    "cols": 3,
                    "hr": {
                        "file": "hr.png",
                        "px_per_unit": 20.0,
                        "origin_px": [0.0, 0.0],
                        "value_scale": 1.0,
                    },
                }
            ),
            "hr.png is missing",
        ),
    ],
)
def test_a_damaged_truth_is_told_in_one_sentence(tmp_path: Path, content: str, said: str) -> None:
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "truth.json").write_text(content)
    with pytest.raises(InspectionError, match=said) as told:
        read_truth(tmp_path)
    assert "--no-truth" in str(told.value)
