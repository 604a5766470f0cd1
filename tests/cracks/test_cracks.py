from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace
from typing import TypeVar

import cv2
import numpy as np
import pytest

from pv_inspect.cells import CellTiles, cut_cells
from pv_inspect.common.work import result_of
from pv_inspect.cracks import (
    NetworkDetector,
    OperatingPoint,
    detector_of,
    operating_point_of,
    read_cracks,
)
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.settings import Settings
from tests.handmade import made_reconstruction

T = TypeVar("T")


class BelowLevel:
    """A detector for tests: what is dark is crack."""

    name = "below level"

    def probability(self, tile: np.ndarray) -> np.ndarray:
        return (tile < 0.3).astype(np.float32) * 2  # beyond 1 on purpose


def drained(work: Generator[float, None, T]) -> tuple[list[float], T]:
    fractions: list[float] = []
    return fractions, result_of(work, lambda step: fractions.append(step.fraction))


def test_any_detector_fills_the_map_and_the_features() -> None:
    reconstruction = made_reconstruction()
    tiles = cut_cells(reconstruction)
    fractions, found = drained(read_cracks(tiles, Settings(), BelowLevel()))
    assert fractions == pytest.approx(np.arange(1, 7) / 6)
    assert found.detector == "below level"
    assert found.probability.shape == reconstruction.image.shape
    np.testing.assert_array_equal(found.probability > 0, reconstruction.image < 0.3)
    assert found.probability.max() == 1
    assert [(c.row, c.col) for c in found.cells] == [(i, j) for i in (0, 1) for j in (0, 1, 2)]
    assert [c.crack_instances for c in found.cells] == [0, 1, 0, 0, 0, 0]
    # the line in handmade.py goes from (10, 10) to (70, 50) in a cell of 80 pixels
    assert found.cells[1].crack_length_cells == pytest.approx(np.hypot(60, 40) / 80, abs=0.03)


@pytest.mark.parametrize(("name", "said"), [("network", "network"), ("ridge", "ridge filters")])
def test_the_detector_is_the_one_of_the_settings(name: str, said: str) -> None:
    tiles = cut_cells(made_reconstruction())
    _, found = drained(read_cracks(tiles, Settings.create(detector=name)))
    assert said in found.detector
    assert max(found.cells, key=lambda c: c.crack_score).col == 1


def test_the_network_is_the_default() -> None:
    assert isinstance(detector_of(Settings()), NetworkDetector)


def test_a_threshold_of_the_settings_wins_over_the_detectors_own() -> None:
    detector = NetworkDetector()
    assert operating_point_of(detector, Settings()) == detector.operating_point
    given = operating_point_of(detector, Settings(crack_threshold=0.7))
    assert given == replace(detector.operating_point, threshold=0.7)
    assert operating_point_of(BelowLevel(), Settings()) == OperatingPoint(0.5, 0.15)


def test_lengths_in_millimetres_need_the_size_of_the_cell() -> None:
    tiles = cut_cells(made_reconstruction())
    _, found = drained(read_cracks(tiles, Settings(cell_width_mm=156.0), BelowLevel()))
    cell = found.cells[1]
    assert cell.crack_length_mm == pytest.approx(156 * cell.crack_length_cells)
    _, found = drained(read_cracks(tiles, Settings(), BelowLevel()))
    assert np.isnan(found.cells[1].crack_length_mm)


def test_in_a_narrow_cell_lengths_have_the_usual_unit_and_areas_are_of_the_cell_itself() -> None:
    grid = HrGrid.covering(ModuleLayout(2, 3, col_widths=((2, 0.5),)), 20.0, 4.0)
    image = np.full(grid.shape, 0.4, np.float32)
    y, x = grid.cell_slices(0, 1)
    cv2.line(image, (x.start + 15, y.start + 10), (x.start + 25, y.start + 70), 0.1, 2)
    y, x = grid.cell_slices(1, 1)
    image[y, x.start : x.start + 20] = 0.05
    tiles = CellTiles(image, grid)
    _, found = drained(read_cracks(tiles, Settings(cell_width_mm=156.0), BelowLevel()))
    cracked, half_dark = found.cells[1], found.cells[4]
    assert cracked.crack_length_cells == pytest.approx(np.hypot(10, 60) / 80, abs=0.03)
    assert cracked.crack_length_mm == pytest.approx(156 * cracked.crack_length_cells)
    assert half_dark.dark_area_share == pytest.approx(0.5, abs=0.05)
    assert found.cells[0].crack_instances == found.cells[2].crack_instances == 0


@pytest.mark.parametrize("detector", ["network", "ridge"])
def test_a_crack_in_a_narrow_cell_is_found_by(detector: str) -> None:
    grid = HrGrid.covering(ModuleLayout(1, 3, col_widths=((3, 0.5),)), 20.0, 4.0)
    image = np.full(grid.shape, 0.4, np.float32)
    y, x = grid.cell_slices(0, 2)
    cv2.line(image, (x.start + 8, y.start + 12), (x.start + 34, y.start + 66), 0.1, 2)
    tiles = CellTiles(image, grid)
    _, found = drained(read_cracks(tiles, Settings.create(detector=detector)))
    assert max(found.cells, key=lambda cell: cell.crack_score).col == 2
    assert found.probability.shape == image.shape


def test_noise_in_a_dead_cell_is_no_crack() -> None:
    tiles = cut_cells(made_reconstruction())
    image = tiles.image.copy()
    rng = np.random.default_rng(4)
    image[tiles.grid.cell_slices(1, 1)] = 0.02 + cv2.GaussianBlur(
        rng.normal(0, 0.03, tiles.shape(1, 1)).astype(np.float32), (0, 0), 1.5
    )
    _, found = drained(read_cracks(replace(tiles, image=image), Settings()))
    dead = found.cells[4]
    assert dead.dark
    assert not dead.crack_suspected
    assert found.probability[tiles.grid.cell_slices(1, 1)].max() < 0.3


def test_dead_cells_are_dark_even_where_they_are_the_majority() -> None:
    tiles = cut_cells(made_reconstruction())
    image = tiles.image.copy()
    dead = [cell for cell in tiles.places if cell not in {(0, 0), (1, 0)}]
    for cell in dead:
        image[tiles.grid.cell_slices(*cell)] *= 0.35
    _, found = drained(read_cracks(replace(tiles, image=image), Settings(detector="ridge")))
    assert [(cell.row, cell.col) for cell in found.cells if cell.dark] == dead
