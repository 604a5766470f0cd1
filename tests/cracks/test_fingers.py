from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pv_inspect.cracks.fingers import interrupted_fingers
from pv_inspect.cracks.isolation import Busbars
from pv_inspect.simulate.defects import finger_interruptions

SIDE = 200


def busbars(horizontal: bool = True) -> Busbars:
    lines = np.zeros(SIDE, bool)
    for centre in (50, 150):
        lines[centre - 2 : centre + 3] = True
    return Busbars(horizontal, lines)


def cell(seed: int = 0, noise: float = 0.01) -> NDArray[np.float32]:
    tile = np.random.default_rng(seed).normal(0.5, noise * 0.5, (SIDE, SIDE))
    tile[busbars().lines] = 0.2
    return tile.astype(np.float32)


def with_bar(tile: NDArray[np.float32], depth: float = 0.3) -> NDArray[np.float32]:
    """From the upper busbar half of the way to the lower one, three pixels wide."""
    tile = tile.copy()
    tile[53:100, 80:83] *= 1 - depth
    return tile


def test_a_bar_from_a_busbar_is_found_where_it_is() -> None:
    (bar,) = interrupted_fingers(with_bar(cell()), busbars())
    assert bar.rows == (pytest.approx(53, abs=4), pytest.approx(100, abs=4))
    assert bar.cols[0] <= 81 < bar.cols[1]
    assert bar.length_px == pytest.approx(47, abs=6)
    assert bar.contrast == pytest.approx(0.3, abs=0.08)


def test_a_turned_cell_has_the_same_bars_turned() -> None:
    tile = with_bar(cell())
    (bar,) = interrupted_fingers(tile, busbars())
    (turned,) = interrupted_fingers(np.ascontiguousarray(tile.T), busbars(horizontal=False))
    assert (turned.cols, turned.rows) == (bar.rows, bar.cols)


def test_brightness_and_its_slope_do_not_matter() -> None:
    tile = with_bar(cell())
    slope = np.linspace(0.6, 1.4, SIDE, dtype=np.float32)
    (found,) = interrupted_fingers(tile, busbars())
    (brighter,) = interrupted_fingers(tile * np.float32(900), busbars())
    assert (brighter.rows, brighter.cols) == (found.rows, found.cols)
    assert len(interrupted_fingers(tile * slope, busbars())) == 1


@pytest.mark.parametrize("seed", range(5))
def test_noise_alone_is_no_bar(seed: int) -> None:
    assert interrupted_fingers(cell(seed, noise=0.08), busbars()) == []


def test_a_line_that_leans_is_no_bar() -> None:
    for lean in (8, 20, 47):
        tile = cell()
        rows = np.arange(53, 100)
        at = 80 + np.rint(np.linspace(0, lean, len(rows))).astype(int)
        for k in range(3):
            tile[rows, at + k] *= 0.5
        assert interrupted_fingers(tile, busbars()) == [], lean


def test_a_line_along_the_busbars_is_no_bar() -> None:
    tile = cell()
    tile[100:103, 40:120] *= 0.5
    assert interrupted_fingers(tile, busbars()) == []


def test_the_edge_of_a_dark_part_is_no_bar() -> None:
    tile = cell()
    tile[55:145, 80:] *= 0.3
    assert interrupted_fingers(tile, busbars()) == []


def test_a_gap_beside_the_cell_is_no_bar() -> None:
    tile = cell()
    tile[:, 190:194] *= 0.3
    assert interrupted_fingers(tile, busbars()) == []


def test_a_bar_that_is_marked_as_a_crack_is_left_to_it() -> None:
    tile = with_bar(cell())
    mark = np.zeros(tile.shape, bool)
    mark[60:90, 81] = True
    elsewhere = np.zeros(tile.shape, bool)
    elsewhere[60:90, 120] = True
    assert interrupted_fingers(tile, busbars(), [mark]) == []
    assert len(interrupted_fingers(tile, busbars(), [elsewhere])) == 1


def test_broken_fingers_of_the_simulator_are_found() -> None:
    rng, found, drawn = np.random.default_rng(4), 0, 0
    for _ in range(20):
        factor = finger_interruptions(rng, (SIDE, SIDE), 1 / SIDE, 2)
        deep = (factor < 0.85).any(axis=0)
        tile = cell() * factor
        bars = interrupted_fingers(tile, busbars())
        assert all(factor[slice(*b.rows), slice(*b.cols)].min() < 0.97 for b in bars)
        drawn += bool(deep.any())
        found += bool(deep.any()) and bool(bars)
    assert drawn >= 6
    assert found >= 0.7 * drawn


def test_a_cell_without_light_or_without_room_has_none() -> None:
    assert interrupted_fingers(np.zeros((SIDE, SIDE), np.float32), busbars()) == []
    everywhere = Busbars(True, np.ones(SIDE, bool))
    assert interrupted_fingers(with_bar(cell()), everywhere) == []


def test_a_bar_of_few_pixels_is_none() -> None:
    tile = np.full((80, 80), 0.5, np.float32)
    tile[30:39, 40] = 0.3  # 0.11 cell widths, 9 px
    lines = np.zeros(80, bool)
    lines[[19, 20, 59, 60]] = True
    assert interrupted_fingers(tile, Busbars(True, lines)) == []
    tile[30:56, 40] = 0.3
    assert len(interrupted_fingers(tile, Busbars(True, lines))) == 1
