"""What the image of a cell shows of cracks beyond the map of a detector."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pv_inspect.cracks.blocks import with_block_edges
from pv_inspect.cracks.features import OperatingPoint, crack_marks
from pv_inspect.cracks.links import linked

__all__ = ["completed"]

Image = NDArray[np.float32]


def completed(
    probability: Image,
    tile: Image,
    blocks: NDArray[np.bool_],
    point: OperatingPoint,
    cell_width_px: float,
) -> Image:
    """Join the pieces of cracks, and mark the edge of cut-off parts where nothing else is marked.

    Parameters
    ----------
    probability : (h, w) float32
        Crack probability of the pixels of one cell.
    tile : (h, w) float32
        Its image, any brightness scale.
    blocks : (h, w) bool
        Of `pv_inspect.cracks.blocks.cut_off_blocks`.
    point : OperatingPoint
    cell_width_px : float

    Returns
    -------
    (h, w) float32

    Notes
    -----
    In a cell with marks the edges would be marked as cracks that nobody has labelled: the pixel F1
    of the benchmark sequences fell by 0.01 to 0.02 where they were.
    """
    probability = np.clip(probability, 0.0, 1.0)
    if blocks.any() and not crack_marks(
        probability, point.threshold, cell_width_px, point.least_extent_cells
    ):
        probability = with_block_edges(probability, blocks, point.threshold, cell_width_px)
    return linked(probability, tile, point.threshold, cell_width_px)
