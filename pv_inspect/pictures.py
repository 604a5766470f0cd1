"""Pictures for pages: shrunk, in shades of grey or as coloured marks, within the page itself."""

from __future__ import annotations

import base64

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.layout import HrGrid

__all__ = ["CRACK_RGB", "contrast", "grey", "jpeg", "overlay", "shrunk"]

# Vermilion of the Okabe-Ito palette (RGB): seen on grey by colour-blind readers too.
CRACK_RGB = (213, 94, 0)


def contrast(image: NDArray[np.float32], grid: HrGrid) -> tuple[float, float]:
    """Black and white of the pictures: the range of the module, without its extreme pixels."""
    first, last = (
        grid.cell_slices(0, 0),
        grid.cell_slices(grid.layout.rows - 1, grid.layout.cols - 1),
    )
    inside = image[first[0].start : last[0].stop, first[1].start : last[1].stop]
    low, high = np.percentile(inside[np.isfinite(inside)], [0.5, 99.5])
    return float(low), float(max(high, low + 1e-6))


def shrunk(image: NDArray[np.float32], longest: int) -> NDArray[np.float32]:
    """Shrink a picture whose longer side is longer than ``longest`` pixels."""
    scale = longest / max(image.shape)
    if scale >= 1:
        return image
    size = (max(round(image.shape[1] * scale), 1), max(round(image.shape[0] * scale), 1))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)


def _peaks(probability: NDArray[np.float32], longest: int) -> NDArray[np.float32]:
    """Shrunk with the maximum of what falls together: a crack must not fade away."""
    size = int(np.ceil(max(probability.shape) / longest)) | 1
    return shrunk(np.asarray(cv2.dilate(probability, np.ones((size, size))), np.float32), longest)


def grey(image: NDArray[np.float32], low: float, high: float) -> NDArray[np.uint8]:
    """Eight bits between black and white; NaN counts as 0."""
    share = np.clip((np.nan_to_num(image) - low) / (high - low), 0, 1)
    return np.asarray(np.round(255 * share), np.uint8)


def overlay(probability: NDArray[np.float32], marks: NDArray[np.float32], longest: int) -> str:
    """Marks in colour, what else the detector answers to faintly; transparent elsewhere."""
    p = np.nan_to_num(_peaks(probability, longest))
    alpha = np.where(_peaks(marks, longest) > 0.5, 60 + 160 * p, 90 * p * (p > 0.25))
    bgra = np.empty((*p.shape, 4), np.uint8)
    bgra[..., :3] = CRACK_RGB[::-1]
    bgra[..., 3] = np.clip(alpha, 0, 255)
    return _data_url("image/png", cv2.imencode(".png", bgra, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1])


def jpeg(picture: NDArray[np.uint8]) -> str:
    """Address that holds the picture itself."""
    return _data_url("image/jpeg", cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 88])[1])


def _data_url(kind: str, data: NDArray[np.uint8]) -> str:
    return f"data:{kind};base64,{base64.b64encode(data.tobytes()).decode()}"
