"""The module image cut into its cells."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pv_inspect.geometry.grid import HrGrid
from pv_inspect.reconstruction.cell_sight import CellSight
from pv_inspect.reconstruction.reconstruction import Reconstruction

__all__ = ["CellTiles", "cut_cells"]

Image = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class CellTiles:
    """The cells of a module image, each of its own size.

    Parameters
    ----------
    image : (H, W) float32
        Module image, full scale = 1.
    grid : HrGrid
        Where the cells lie: ``grid.cell_slices(row, col)``.
    support : (H, W) float32, optional
        Support map, as far as there is one.
    sight : CellSight, optional
        How well every cell was seen, as far as it is known.
    """

    image: Image
    grid: HrGrid
    support: Image | None = None
    sight: CellSight | None = None

    @property
    def places(self) -> list[tuple[int, int]]:
        """Row and column of all cells, row by row."""
        layout = self.grid.layout
        return [(row, col) for row in range(layout.rows) for col in range(layout.cols)]

    @property
    def pixels(self) -> Image:
        """Pixels of all cells, cell by cell, (n,)."""
        return np.concatenate([self.tile(*place).ravel() for place in self.places])

    def shape(self, row: int, col: int) -> tuple[int, int]:
        """Height and width of a tile, HR pixels."""
        y, x = self.grid.cell_slices(row, col)
        return y.stop - y.start, x.stop - x.start

    def tile(self, row: int, col: int) -> Image:
        """Cut out a cell, (h, w); a view of the module image, which must not be written to."""
        return self.image[self.grid.cell_slices(row, col)]

    def support_of(self, row: int, col: int) -> Image | None:
        """Cut out the support of a cell, (h, w); None if there is no support map."""
        return None if self.support is None else self.support[self.grid.cell_slices(row, col)]

    def means(self) -> dict[tuple[int, int], Image]:
        """Mean of the tiles of each size, by their height and width."""
        alike: dict[tuple[int, int], list[Image]] = {}
        for place in self.places:
            alike.setdefault(self.shape(*place), []).append(self.tile(*place))
        return {size: np.mean(tiles, axis=0, dtype=np.float32) for size, tiles in alike.items()}

    def seen(self, row: int, col: int) -> tuple[float, float]:
        """Detail and blur of a cell (`CellSight`); NaN if they are not known."""
        if self.sight is None:
            return float("nan"), float("nan")
        return float(self.sight.detail[row, col]), float(self.sight.blur[row, col])

    def assemble(self, maps: Iterable[Image]) -> Image:
        """Put maps of all cells back into place on the HR grid; the margin is 0.

        Parameters
        ----------
        maps : (h, w) float32 for each cell
            Row by row, each as large as its tile.

        Returns
        -------
        (H, W) float32
        """
        whole = np.zeros(self.grid.shape, np.float32)
        for place, one in zip(self.places, maps, strict=True):
            whole[self.grid.cell_slices(*place)] = one
        return whole


def cut_cells(reconstruction: Reconstruction) -> CellTiles:
    """Cut the rectified module into its cells.

    Crossing points fall between HR pixels and a cell is a whole number of them, so that cutting
    does not resample.

    Parameters
    ----------
    reconstruction : Reconstruction

    Returns
    -------
    CellTiles
    """
    made = reconstruction
    return CellTiles(made.image, made.grid, made.support, made.sight)
