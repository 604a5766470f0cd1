"""The module image cut into its cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pv_inspect.geometry.grid import HrGrid
from pv_inspect.reconstruction.cell_sight import CellSight
from pv_inspect.reconstruction.reconstruction import Reconstruction

__all__ = ["CellTiles", "cut_cells"]


@dataclass(frozen=True, eq=False)
class CellTiles:
    """One image per cell, all of the same size.

    Parameters
    ----------
    images : (rows, cols, h, w) float32
        Tile of every cell, full scale = 1; h x w pixels are one cell pitch.
    grid : HrGrid
        Where the tiles lie: ``grid.cell_slices(row, col)``.
    support : (rows, cols, h, w) float32, optional
        Tiles of the support map, as far as there is one.
    sight : CellSight, optional
        How well every cell was seen, as far as it is known.
    """

    images: NDArray[np.float32]
    grid: HrGrid
    support: NDArray[np.float32] | None = None
    sight: CellSight | None = None

    def seen(self, row: int, col: int) -> tuple[float, float]:
        """Detail and blur of a cell (`CellSight`); NaN if they are not known."""
        if self.sight is None:
            return float("nan"), float("nan")
        return float(self.sight.detail[row, col]), float(self.sight.blur[row, col])

    def assemble(self, maps: NDArray[np.float32]) -> NDArray[np.float32]:
        """Put maps of all cells back into place on the HR grid; the margin is 0.

        Parameters
        ----------
        maps : (rows, cols, h, w) float32

        Returns
        -------
        (H, W) float32
        """
        whole = np.zeros(self.grid.shape, np.float32)
        for row, col in np.ndindex(*maps.shape[:2]):
            whole[self.grid.cell_slices(row, col)] = maps[row, col]
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
    grid, image = reconstruction.grid, reconstruction.image
    rows, cols = grid.layout.rows, grid.layout.cols

    def cut(whole: NDArray[np.float32]) -> NDArray[np.float32]:
        tiles = [[whole[grid.cell_slices(i, j)] for j in range(cols)] for i in range(rows)]
        return np.array(tiles, dtype=np.float32)

    return CellTiles(cut(image), grid, cut(reconstruction.support), reconstruction.sight)
