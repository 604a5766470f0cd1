from __future__ import annotations

import numpy as np
import pytest

from pv_inspect.cells import cut_cells
from pv_inspect.common.gap_text import CellSizes
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.reconstruction.reconstruction import Reconstruction


def reconstruction(aspect: float, col_widths: CellSizes = ()) -> Reconstruction:
    grid = HrGrid.covering(ModuleLayout(3, 4, aspect, col_widths=col_widths), 15.0, 4.0)
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


def test_the_tile_of_a_narrow_column_has_its_own_size() -> None:
    made = reconstruction(1.0, ((3, 0.5),))
    tiles = cut_cells(made)
    assert [tiles.tile(1, col).shape for col in range(4)] == [
        (60, 60),
        (60, 60),
        (60, 30),
        (60, 60),
    ]
    x, y = made.grid.to_pixels(np.array([2.5, 1.0])) + 0.5
    assert tiles.tile(1, 3)[0, 0] == made.image[round(y), round(x)]
    means = tiles.means()
    assert set(means) == {(60, 60), (60, 30)}
    narrow = [tiles.tile(row, 2) for row in range(3)]
    np.testing.assert_allclose(means[60, 30], np.mean(narrow, axis=0), rtol=1e-6)


@pytest.mark.parametrize("col_widths", [(), ((2, 0.6),)])
def test_assembling_the_tiles_gives_the_image_back_inside_and_zero_in_the_margin(
    col_widths: CellSizes,
) -> None:
    made = reconstruction(1.0, col_widths)
    tiles = cut_cells(made)
    whole = tiles.assemble(tiles.tile(*place) for place in tiles.places)
    inside = np.zeros(made.image.shape, bool)
    for row, col in np.ndindex(3, 4):
        inside[made.grid.cell_slices(row, col)] = True
    np.testing.assert_array_equal(whole[inside], made.image[inside])
    assert not whole[~inside].any()
