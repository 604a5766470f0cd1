"""The crack features of a cell after a person has corrected its marks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.cells import CellTiles
from pv_inspect.cracks import (
    BusbarFinder,
    CellFeatures,
    CrackDetector,
    CrackMap,
    measure_cell,
)
from pv_inspect.cracks.areas import usual_brightness
from pv_inspect.cracks.isolation import Busbars, busbars_from_image, busbars_from_map
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection

__all__ = ["Measure", "measured"]

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Measure:
    """What all cells of a module share when they are measured.

    Parameters
    ----------
    threshold : float
        Probability from which a pixel counts as crack.
    cell_width_px : float
        HR pixels per cell width.
    usual_intensity : float
        Median brightness of the cells that work (`pv_inspect.cracks.areas.usual_brightness`).
    busbars : mapping of (int, int) to Busbars or None
        By height and width of the cells, pixels; without them nothing is said about isolated
        areas.
    cell_width_mm : float or None
    """

    threshold: float
    cell_width_px: float
    usual_intensity: float
    busbars: Mapping[tuple[int, int], Busbars | None] = field(default_factory=dict)
    cell_width_mm: float | None = None

    @classmethod
    def of(cls, result: Inspection, detector: CrackDetector | None = None) -> Measure:
        """Measure of a result.

        Parameters
        ----------
        result : Inspection
            With its cracks.
        detector : CrackDetector, optional
            If it sees busbars, they are looked for with it in the mean of all cells; else as lines
            in that mean.

        Returns
        -------
        Measure
        """
        tiles, cracks = result.need(CellTiles), result.need(CrackMap)
        return cls.of_cells(
            tiles,
            cracks.threshold,
            result.settings.cell_width_mm,
            detector,
        )

    @classmethod
    def of_cells(
        cls,
        tiles: CellTiles,
        threshold: float,
        cell_width_mm: float | None,
        detector: CrackDetector | None,
    ) -> Measure:
        """Measure of a module's cells; see `of`.

        Parameters
        ----------
        tiles : CellTiles
        threshold, cell_width_mm
            See the class.
        detector : CrackDetector or None
        """
        means = tiles.means()
        if isinstance(detector, BusbarFinder):
            busbars = {size: busbars_from_map(detector.read(m)[1]) for size, m in means.items()}
        else:
            busbars = {size: busbars_from_image(m) for size, m in means.items()}
        usual = usual_brightness([tiles.tile(*place) for place in tiles.places])
        return cls(threshold, tiles.grid.pixels_per_unit, usual, busbars, cell_width_mm)


def measured(
    mask: Mask,
    tile: Image,
    probability: Image,
    measure: Measure,
    *,
    row: int,
    col: int,
    support: Image | None = None,
    seen: tuple[float, float] = (math.nan, math.nan),
) -> CellFeatures:
    """Measure a cell with the marks that a person has drawn.

    Parameters
    ----------
    mask : (h, w) bool
        Corrected marks. All of them count, however short or wide, also in a dark cell: a person
        has looked at them.
    tile, probability : (h, w) float32
        Image of the cell and what the detector answered; the crack score remains the detector's.
    measure : Measure
    row, col : int
        Position of the cell in the module.
    support : (h, w) float32, optional
        Support map of the cell.
    seen : (float, float)
        How well the cell was seen, see `measure_cell`.

    Returns
    -------
    CellFeatures

    Raises
    ------
    InspectionError
        If the mask is of another size than the cell.
    """
    if mask.shape != tile.shape:
        raise InspectionError(
            f"The corrected mask of row {row + 1}, column {col + 1} is {mask.shape[1]} x "
            f"{mask.shape[0]} px, the cell is {tile.shape[1]} x {tile.shape[0]} px: it was drawn "
            "on another result; draw it again."
        )
    n_labels, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    return measure_cell(
        tile,
        probability,
        measure.threshold,
        row=row,
        col=col,
        cell_width_px=measure.cell_width_px,
        usual_intensity=measure.usual_intensity,
        busbars=measure.busbars.get((tile.shape[0], tile.shape[1])),
        cell_width_mm=measure.cell_width_mm,
        support=support,
        seen=seen,
        marks=[labels == k for k in range(1, n_labels)],
    )
