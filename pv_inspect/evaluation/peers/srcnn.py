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

from pv_inspect.evaluation.peers.convolution import convolved

__all__ = ["srcnn"]

Image = NDArray[np.float32]
Maps = NDArray[np.float32]

_WEIGHTS = Path(__file__).with_name("srcnn.npz")


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
        maps = convolved(maps, weights, bias, "edge")
        if k < len(layers):
            maps = np.maximum(maps, 0)
    return np.asarray(maps[0])


@cache
def _layers() -> tuple[tuple[Maps, Maps], ...]:
    with np.load(_WEIGHTS) as file:
        return tuple((file[f"conv{k}_w"], file[f"conv{k}_b"]) for k in (1, 2, 3))
