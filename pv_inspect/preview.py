"""A small part of the module, reconstructed again and again while the settings change.

The same equations and the same solver as for the whole module; what a change leaves valid is kept,
and the solver starts from the image before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.layout import HrGrid
from pv_inspect.observation import NormalEquations, ObservationModel, SensorRays
from pv_inspect.psf_estimation import View, cut_view
from pv_inspect.reconstruction import Reconstruction, observed
from pv_inspect.registration import Registration
from pv_inspect.sequence import Sequence
from pv_inspect.settings import Settings
from pv_inspect.solver import Problem, first_guess, minimise

__all__ = ["Preview", "Region"]

Image = NDArray[np.float32]

# Around the cell, so that what lies beyond its border has the chance to explain the LR pixels.
_MARGIN_LR_PX = 4.0


@dataclass(frozen=True)
class Region:
    """A rectangle of cells, counted from the top left.

    Parameters
    ----------
    row, col : int
        Its first cell.
    rows, cols : int
        How many cells.
    """

    row: int
    col: int
    rows: int = 1
    cols: int = 1


class Preview:
    """Reconstructs parts of one module.

    Parameters
    ----------
    sequence : Sequence
    registration : Registration
    whole : Reconstruction
        Result for the whole module: PSF, motion and lambda are taken from it where the settings
        leave them open.
    """

    def __init__(
        self, sequence: Sequence, registration: Registration, whole: Reconstruction
    ) -> None:
        self._sequence = sequence
        self._registration = registration
        self._whole = whole
        self._rays = SensorRays.of(registration.camera, sequence.shape)
        self._key: tuple[object, ...] = ()
        self._equations: NormalEquations | None = None
        self._views: list[View] = []
        self._image: Image | None = None

    def grid(self, region: Region, magnification: float) -> HrGrid:
        """Return the grid of a region with its margin.

        Raises
        ------
        InspectionError
            If the module has no such cells.
        """
        layout = self._registration.layout
        last = (region.row + region.rows - 1, region.col + region.cols - 1)
        if not (0 <= region.row <= last[0] < layout.rows and 0 <= region.col <= last[1] < layout.cols):
            raise InspectionError(
                f"There is no region of {region.rows} x {region.cols} cells at row {region.row}, "
                f"column {region.col} in a module of {layout.rows} x {layout.cols} cells: rows and "
                "columns count from 0."
            )
        grid = HrGrid.covering(layout, self._registration.lr_px_per_unit, magnification)
        first_rows, first_cols = grid.cell_slices(region.row, region.col)
        last_rows, last_cols = grid.cell_slices(*last)
        pad = int(np.ceil(_MARGIN_LR_PX * grid.magnification))
        return grid.window(
            slice(max(first_rows.start - pad, 0), last_rows.stop + pad),
            slice(max(first_cols.start - pad, 0), last_cols.stop + pad),
        )
