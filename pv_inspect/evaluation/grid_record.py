"""Where the compared cells lie: what scoring needs to know of a case after its images are made."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from pv_inspect.common.records import Record
from pv_inspect.evaluation.case import Case, Cell

__all__ = ["GridRecord"]

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class GridRecord(Record):
    """The grid of a case and the pixels of its cells, as they are stored beside the images.

    Attributes
    ----------
    rows, cols : int
    size : (width, height)
        Of the module, module units.
    pixels_per_unit : float
    origin_px : (x, y)
    magnification : float
    windows : dict of str to (top, bottom, left, right)
        Pixels of the cells that are compared, by "row,col".
    geometry_cpu_s : float
    frames_used, frames : int
    """

    rows: int
    cols: int
    size: tuple[Positive, Positive]
    pixels_per_unit: Positive
    origin_px: tuple[float, float]
    magnification: Positive
    windows: dict[str, tuple[int, int, int, int]]
    geometry_cpu_s: float
    frames_used: int
    frames: int

    @classmethod
    def of(cls, case: Case, cells: list[Cell]) -> GridRecord:
        """Describe the cells of a case."""
        grid, layout = case.grid, case.grid.layout
        windows = {}
        for row, col in cells:
            y, x = grid.cell_slices(row, col)
            windows[f"{row},{col}"] = (y.start, y.stop, x.start, x.stop)
        width, height = layout.size
        return cls(
            rows=layout.rows,
            cols=layout.cols,
            size=(float(width), float(height)),
            pixels_per_unit=grid.pixels_per_unit,
            origin_px=grid.origin_px,
            magnification=grid.magnification,
            windows=windows,
            geometry_cpu_s=case.geometry_cpu_s,
            frames_used=int(case.registration.used.sum()),
            frames=len(case.sequence),
        )

    def window(self, cell: Cell) -> tuple[slice, slice]:
        """[row, col] slices of a cell."""
        top, bottom, left, right = self.windows[f"{cell[0]},{cell[1]}"]
        return slice(top, bottom), slice(left, right)

    @property
    def cells(self) -> list[Cell]:
        """Row and column of the cells that are compared."""
        places = [name.split(",") for name in self.windows]
        return [(int(row), int(col)) for row, col in places]
