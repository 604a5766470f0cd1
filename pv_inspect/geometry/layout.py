"""The module plane: how many cells, where their crossing points lie, and the HR grid on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError

__all__ = ["ModuleLayout"]

Points = NDArray[np.float64]


@dataclass(frozen=True)
class ModuleLayout:
    """Cells of a module in the module plane.

    The unit of the plane is the pitch of one cell width, the same in x and y.

    Parameters
    ----------
    rows, cols : int
        Number of cells along y and x.
    cell_aspect : float
        Cell width / cell height (2 for half-cut cells lying flat).
    """

    rows: int
    cols: int
    cell_aspect: float = 1.0

    def __post_init__(self) -> None:
        if self.rows < 1 or self.cols < 1:
            raise InspectionError(
                f"A module of {self.rows} rows x {self.cols} columns has no cells: "
                "give rows and cols of at least 1."
            )
        if not (np.isfinite(self.cell_aspect) and 0.1 <= self.cell_aspect <= 10):
            raise InspectionError(
                f"cell_aspect is {self.cell_aspect:g}, but cell width / cell height must lie "
                "between 0.1 and 10."
            )

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the module in module units."""
        return float(self.cols), self.rows / self.cell_aspect

    @property
    def n_crossings(self) -> int:
        """Number of crossing points, outer ones included: (rows + 1) * (cols + 1)."""
        return (self.rows + 1) * (self.cols + 1)

    def crossings(self) -> Points:
        """Crossing points in the module plane.

        Returns
        -------
        (n_crossings, 2) float64
            (x, y), row-major: crossing (row i, column j) lies at (j, i / cell_aspect).
        """
        i, j = np.divmod(np.arange(self.n_crossings), self.cols + 1)
        return np.column_stack([j, i / self.cell_aspect]).astype(np.float64)
