"""SRCNN, the first super-resolution network: three convolutions on the enlarged image.

References
----------
.. [1] C. Dong, C. C. Loy, K. He, X. Tang, "Image Super-Resolution Using Deep Convolutional
       Networks", IEEE TPAMI 38 (2), 2016. doi:10.1109/TPAMI.2015.2439281
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["srcnn"]

Image = NDArray[np.float32]
Maps = NDArray[np.float32]

_WEIGHTS = Path(__file__).with_name("srcnn.npz")
# Rows whose neighbourhoods lie in memory at a time.
_ROWS = 32


def srcnn(image: Image, scale: int) -> Image:
    """Enlarge an image by bicubic interpolation and let the network sharpen it.

    Parameters
    ----------
    image : (h, w) float32
        In [0, 1].
    scale : int

    Returns
    -------
    (scale * h, scale * w) float32
    """
    height, width = image.shape
    large = cv2.resize(image, (scale * width, scale * height), interpolation=cv2.INTER_CUBIC)
    maps: Maps = np.asarray(large, np.float32)[None]
    layers = _layers()
    for k, (weights, bias) in enumerate(layers, start=1):
        maps = _convolved(maps, weights, bias)
        if k < len(layers):
            maps = np.maximum(maps, 0)
    return np.asarray(maps[0])


@cache
def _layers() -> tuple[tuple[Maps, Maps], ...]:
    with np.load(_WEIGHTS) as file:
        return tuple((file[f"conv{k}_w"], file[f"conv{k}_b"]) for k in (1, 2, 3))


def _convolved(maps: Maps, weights: Maps, bias: Maps) -> Maps:
    """Correlate (n, h, w) maps with (m, n, k, k) filters, mirrored at the ends: (m, h, w)."""
    count, height, width = maps.shape
    many, _, side, _ = weights.shape
    reach = side // 2
    padded = np.pad(maps, ((0, 0), (reach, reach), (reach, reach)), mode="edge")
    out = np.empty((many, height, width), np.float32)
    flat = weights.reshape(many, -1)
    for top in range(0, height, _ROWS):
        rows = padded[:, top : top + _ROWS + 2 * reach]
        near = np.lib.stride_tricks.sliding_window_view(rows, (side, side), axis=(1, 2))
        n_rows = near.shape[1]
        columns = near.transpose(0, 3, 4, 1, 2).reshape(count * side * side, n_rows * width)
        out[:, top : top + n_rows] = (flat @ columns).reshape(many, n_rows, width)
    return out + bias.reshape(-1, 1, 1)
