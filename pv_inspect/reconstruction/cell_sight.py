"""How well every cell was seen: whether the lines of cracks would show, however many frames."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pv_inspect.observation.normal_equations import NormalEquations
from pv_inspect.observation.stencil import Quadratic
from pv_inspect.reconstruction.image_blur import image_blur
from pv_inspect.reconstruction.support import Detail, support_of

__all__ = ["CellSight", "sight_of"]

Image = NDArray[np.float32]

# Periods of the detail by which lines as fine as cracks are told: 1/28 to 1/14 of a cell's width.
# The network has learnt from cells of 56 px and more, which carry up to 28 cycles. Of 8 to 16, 14
# to 28 and 22 to 40 cycles these tell best which cracks are found (benchmarks/judged_cells.py).
_CYCLES_PER_CELL = (14.0, 28.0)
# Radius over which the answer is averaged, cell widths.
_WINDOW_CELLS = 0.06
# What the figure of a cell is reached in: all of it but this share.
_OTHER_SHARE = 0.2


@dataclass(frozen=True, eq=False)
class CellSight:
    """How well the cells of a module were seen.

    Parameters
    ----------
    detail : (rows, cols) float32
        0..1: share of a detail of 14 to 28 cycles per cell width and 10 % contrast that comes from
        the frames, reached in four fifths of the cell. Noise, coarse pixels, the assumed blur and
        overexposure lower it, more frames raise it.
    blur : (rows, cols) float32
        Standard deviation of the blur of the module image, measured at the edges of the cells
        around, cell widths; NaN if no edge of the module can be measured.
    """

    detail: Image
    blur: Image


def sight_of(
    equations: NormalEquations, prior_with: Callable[[Image], Quadratic], image: Image
) -> Generator[float, None, CellSight]:
    """Measure how well every cell was seen.

    Parameters
    ----------
    equations : NormalEquations
        The data.
    prior_with : callable
        See `pv_inspect.reconstruction.support.support_of`.
    image : (height, width) float32
        Module image.

    Yields
    ------
    float
        Share of the work that is done.

    Returns
    -------
    CellSight
    """
    grid = equations.model.grid
    lr_px = grid.pixels_per_unit / grid.magnification
    low, high = (cycles / lr_px for cycles in _CYCLES_PER_CELL)
    detail = Detail((low, high), _WINDOW_CELLS * lr_px)
    answer = yield from support_of(equations, prior_with, detail)
    # What the grid of the image can't carry is not in it.
    carried = float(np.clip((0.5 * grid.magnification - low) / (high - low), 0.0, 1.0))
    layout = grid.layout
    shares = [
        [
            carried * np.quantile(answer[grid.cell_slices(row, col)], _OTHER_SHARE)
            for col in range(layout.cols)
        ]
        for row in range(layout.rows)
    ]
    return CellSight(np.array(shares, np.float32), image_blur(image, grid))
