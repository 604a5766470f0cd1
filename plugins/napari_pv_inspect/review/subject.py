"""What is reviewed: cells and crack marks, of an inspection or of a result folder. No Qt."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pv_inspect.cells import CellTiles
from pv_inspect.cracks import (
    CellFeatures,
    CrackMap,
    crack_marks,
    detector_of,
)
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.review import Cell, Measure, measured
from pv_inspect.settings import Settings

__all__ = ["Mask", "Subject"]

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Subject:
    """A module that is reviewed.

    Parameters
    ----------
    tiles : CellTiles
    cracks : CrackMap or None
        None while they are looked for.
    settings : Settings
        What made the image.
    inspection : Inspection or None
        None: there are no frames, only a result folder.
    """

    tiles: CellTiles
    cracks: CrackMap | None
    settings: Settings
    inspection: Inspection | None = None

    @classmethod
    def of_inspection(cls, inspection: Inspection) -> Subject | None:
        """Take the cells of an inspection; None if it has none of its layout yet."""
        tiles = inspection.tiles
        if tiles is None or tiles.grid.layout != inspection.layout:
            return None
        frames = inspection if inspection.sequence is not None else None
        return cls(tiles, inspection.cracks, inspection.settings, frames)

    @property
    def places(self) -> list[Cell]:
        """All cells, row by row."""
        return self.tiles.places

    def shows_the_same(self, other: Subject | None) -> bool:
        """Whether the pictures are the same ones."""
        return other is not None and self.tiles is other.tiles and self.cracks is other.cracks

    def probability(self, cell: Cell) -> Image | None:
        """Crack probability of the pixels of a cell."""
        if self.cracks is None:
            return None
        return self.cracks.probability[self.tiles.grid.cell_slices(*cell)]

    def marks(self, cell: Cell, threshold: float) -> Mask:
        """Pixels of the marks that count as cracks at a threshold, (h, w) bool."""
        marked = np.zeros(self.tiles.shape(*cell), bool)
        probability = self.probability(cell)
        if probability is not None and self.cracks is not None:
            width, extent = self.tiles.grid.pixels_per_unit, self.cracks.least_extent_cells
            for mark in crack_marks(probability, threshold, width, extent):
                marked |= mark
        return marked

    def measured(self, cell: Cell, mask: Mask) -> CellFeatures:
        """Measure a cell with corrected marks; takes a while the first time.

        Raises
        ------
        InspectionError
            If the mask is of another size than the cell.
        """
        row, col = cell
        probability = self.probability(cell)
        if probability is None:
            raise InspectionError("The cracks are still looked for: correct them afterwards.")
        return measured(
            mask,
            self.tiles.tile(row, col),
            probability,
            self._measure,
            row=row,
            col=col,
            support=self.tiles.support_of(row, col),
            seen=self.tiles.seen(row, col),
        )

    @cached_property
    def _measure(self) -> Measure:
        assert self.cracks is not None
        return Measure.of_cells(
            self.tiles,
            self.cracks.threshold,
            self.settings.cell_width_mm,
            detector_of(self.settings),
        )
