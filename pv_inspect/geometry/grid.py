"""The HR grid: the pixels of the module image on the module plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout

__all__ = ["HrGrid"]

Points = NDArray[np.float64]


@dataclass(frozen=True)
class HrGrid:
    """Pixel grid of the rectified high-resolution image on the module plane.

    HR pixel = ``origin_px`` + ``pixels_per_unit`` * (module-plane coordinate), pixel centres at
    integers.

    Parameters
    ----------
    layout : ModuleLayout
    pixels_per_unit : float
        HR pixels per module unit, the same in x and y.
    origin_px : tuple of float
        (x, y) of the top-left outer crossing, HR pixels.
    shape : tuple of int
        (height, width) of the image.
    magnification : float
        LR pixel pitch / HR pixel pitch at the module's mean scale.
    """

    layout: ModuleLayout
    pixels_per_unit: float
    origin_px: tuple[float, float]
    shape: tuple[int, int]
    magnification: float

    @classmethod
    def covering(
        cls, layout: ModuleLayout, lr_px_per_unit: float, magnification: float, margin: float = 0.15
    ) -> HrGrid:
        """Return the grid of a whole module with a margin around it.

        The pitch is rounded so that a usual cell is a whole number of HR pixels wide: tiles then
        need no resampling. ``magnification`` becomes what the rounding makes of it.

        Parameters
        ----------
        layout : ModuleLayout
        lr_px_per_unit : float
            Mean scale of the module in the frames, LR pixels per module unit.
        magnification : float
            Wanted LR pixel pitch / HR pixel pitch.
        margin : float
            Border around the cells, module units.
        """
        if not 0.0 < lr_px_per_unit < np.inf:
            raise InspectionError(
                f"The poses of the frames give the module no size ({lr_px_per_unit} px per cell): "
                "check rows, cols, and the focal length and kappa that are given."
            )
        ppu = float(max(round(lr_px_per_unit * magnification), 1))
        pad = int(np.ceil(margin * ppu))
        width, height = layout.size
        shape = (int(np.ceil(height * ppu)) + 2 * pad, int(np.ceil(width * ppu)) + 2 * pad)
        # Cell borders fall between pixels: the first pixel of a cell starts at the crossing.
        origin = pad - 0.5
        return cls(layout, ppu, (origin, origin), shape, ppu / lr_px_per_unit)

    @property
    def pixels_per_cell(self) -> tuple[float, float]:
        """HR pixels per usual cell along x and y."""
        return self.pixels_per_unit, self.pixels_per_unit / self.layout.cell_aspect

    def to_pixels(self, module_points: Points) -> Points:
        """Module-plane points (..., 2) to HR pixel coordinates."""
        points = np.asarray(module_points)
        pixels: Points = np.asarray(self.origin_px) + self.pixels_per_unit * points
        return pixels

    def to_module(self, pixels: Points) -> Points:
        """HR pixel coordinates (..., 2) to the module plane."""
        points: Points = (np.asarray(pixels) - np.asarray(self.origin_px)) / self.pixels_per_unit
        return points

    @property
    def matrix(self) -> NDArray[np.float64]:
        """3 x 3 similarity from HR pixel coordinates to the module plane."""
        s = 1.0 / self.pixels_per_unit
        ox, oy = self.origin_px
        return np.array([[s, 0.0, -ox * s], [0.0, s, -oy * s], [0.0, 0.0, 1.0]])

    def cell_slices(self, row: int, col: int) -> tuple[slice, slice]:
        """[row, col] slices of the pixels of one cell; cells of one width have as many pixels."""
        layout, scale = self.layout, self.pixels_per_unit
        gap_x, gap_y = (scale * gap for gap in layout.cell_gap)
        w = round(scale * float(layout.widths[col]) - gap_x)
        h = round(scale * float(layout.heights[row]) - gap_y)
        x0 = round(self.origin_px[0] + 0.5 + scale * float(layout.col_starts[col]) + gap_x / 2)
        y0 = round(self.origin_px[1] + 0.5 + scale * float(layout.row_starts[row]) + gap_y / 2)
        return slice(y0, y0 + h), slice(x0, x0 + w)

    def window(self, rows: slice, cols: slice) -> HrGrid:
        """Return the grid of a part of the image, given as [row, col] slices within it."""
        (top, bottom, _), (left, right, _) = (
            rows.indices(self.shape[0]),
            cols.indices(self.shape[1]),
        )
        origin = (self.origin_px[0] - left, self.origin_px[1] - top)
        shape = (bottom - top, right - left)
        return HrGrid(self.layout, self.pixels_per_unit, origin, shape, self.magnification)

    def to_dict(self) -> dict[str, Any]:
        """Return the part of ``result.json`` that places the HR image on the module plane."""
        return {
            "pixels_per_cell": list(self.pixels_per_cell),
            "origin_px": list(self.origin_px),
            "magnification": self.magnification,
        }
