"""A layer of a convolutional network in NumPy."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["convolved"]

Maps = NDArray[np.float32]

# Rows whose neighbourhoods lie in memory at a time.
_ROWS = 32


def convolved(
    maps: Maps, weights: Maps, bias: Maps, beyond: Literal["edge", "constant"] = "constant"
) -> Maps:
    """Correlate maps with filters and add a number to each result.

    Parameters
    ----------
    maps : (n, h, w) float32
    weights : (m, n, k, k) float32
    bias : (m,) float32
    beyond : {"edge", "constant"}
        What lies beyond the ends: the last pixels or 0.

    Returns
    -------
    (m, h, w) float32
    """
    count, height, width = maps.shape
    many, _, side, _ = weights.shape
    reach = side // 2
    padded = np.pad(maps, ((0, 0), (reach, reach), (reach, reach)), mode=beyond)
    out = np.empty((many, height, width), np.float32)
    flat = weights.reshape(many, -1)
    for top in range(0, height, _ROWS):
        rows = padded[:, top : top + _ROWS + 2 * reach]
        near = np.lib.stride_tricks.sliding_window_view(rows, (side, side), axis=(1, 2))
        n_rows = near.shape[1]
        columns = near.transpose(0, 3, 4, 1, 2).reshape(count * side * side, n_rows * width)
        out[:, top : top + n_rows] = (flat @ columns).reshape(many, n_rows, width)
    return out + bias.reshape(-1, 1, 1)
