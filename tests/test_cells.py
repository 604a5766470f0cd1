from __future__ import annotations

import numpy as np
import pytest

from pv_inspect.cells import cut_cells
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.reconstruction.reconstruction import Reconstruction


def reconstruction(aspect: float) -> Reconstruction:
    grid = HrGrid.covering(ModuleLayout(3, 4, aspect), 15.0, 4.0)
    rng = np.random.default_rng(0)
    image = rng.random(grid.shape, dtype=np.float32)
    return Reconstruction(image, image, grid, 0.05, 0.4, (), True, image, (), (), 0)


@pytest.mark.parametrize("aspect", [1.0, 2.0, 0.5])
def test_a_tile_is_one_cell_pitch_and_starts_at_its_crossing(aspect: float) -> None:
    made = reconstruction(aspect)
    tiles = cut_cells(made)
    assert {tiles.tile(*place).shape for place in tiles.places} == {(round(60 / aspect), 60)}
    x, y = made.grid.to_pixels(np.array([2.0, 1 / aspect])) + 0.5
    top_left = made.image[round(y), round(x)]
    assert tiles.tile(1, 2)[0, 0] == top_left


def test_assembling_the_tiles_gives_the_image_back_inside_and_zero_in_the_margin() -> None:
    made = reconstruction(1.0)
    tiles = cut_cells(made)
    whole = tiles.assemble(tiles.tile(*place) for place in tiles.places)
    inside = np.zeros(made.image.shape, bool)
    for row, col in np.ndindex(3, 4):
        inside[made.grid.cell_slices(row, col)] = True
    np.testing.assert_array_equal(whole[inside], made.image[inside])
    assert not whole[~inside].any()
