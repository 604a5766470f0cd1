"""What JPEG has taken from a picture, told from what it has left.

Compression rounds the cosine coefficients of blocks of 8 x 8 pixels to multiples of steps in its
tables. Noise goes with them, so that it can't be estimated from the pixels any more; but how many
coefficients became zero tells how large they were, and with that how large the error is.

References
----------
D. S. Turaga, Y. Chen, J. Caviedes, "No reference PSNR estimation for compressed pictures", Signal
Processing: Image Communication 19, 2004.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pv_inspect.image_files.jpeg import decoded_jpeg
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.image_files.problems import ImageFileError
from pv_inspect.image_files.regular import open_regular

__all__ = ["error_variance_of", "jpeg_error_variance", "rounding_error"]

_SIDE = 8
# Blocks that show the module: this share of the way from dark to bright.
_BRIGHT = 0.3
_LEAST_BLOCKS, _MOST_BLOCKS = 16, 2**15
# Share of zeros from which on the others are too few to tell their size.
_ALL_BUT_ZERO = 0.99
_ZIGZAG = sorted(
    ((row, col) for row in range(_SIDE) for col in range(_SIDE)),
    key=lambda at: (sum(at), at[0] if sum(at) % 2 else -at[0]),
)
_TABLES, _SCAN = 0xDB, 0xDA
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}


def jpeg_error_variance(path: Path, limits: ReadLimits) -> float:
    """Estimate the mean squared error of a JPEG file as `error_variance_of` does."""
    try:
        with open_regular(path) as file:
            return error_variance_of(file.read(), limits)
    except ImageFileError:
        return 0.0


def error_variance_of(data: bytes, limits: ReadLimits) -> float:
    """Estimate the mean squared error of the bright pixels of a JPEG.

    Parameters
    ----------
    data : bytes
    limits : ReadLimits

    Returns
    -------
    float
        DN^2 of 8 bits; 0 for other data, and where nothing is bright.
    """
    try:
        image = decoded_jpeg(data, None, limits)
    except ImageFileError:
        return 0.0
    steps = _steps(data)
    if steps is None:
        return 0.0
    blocks = _blocks(image)
    level = blocks.mean(axis=(1, 2))
    if not level.size:
        return 0.0
    dark, bright = np.percentile(level, [1.0, 99.5])
    blocks = blocks[level > dark + _BRIGHT * (bright - dark)]
    if len(blocks) < _LEAST_BLOCKS:
        return 0.0
    cosines = _cosines()
    coefficients = cosines @ (blocks - 128.0) @ cosines.T
    zero = np.mean(np.abs(coefficients) < 0.5 * steps, axis=0)
    # A share of none or all is known to half a block.
    zero = np.clip(zero, 0.5 / len(blocks), 1 - 0.5 / len(blocks))
    spread = -steps / (2 * np.log(1 - zero))
    # Where nearly all are zero, their size is bounded by that of the others.
    measured = zero <= _ALL_BUT_ZERO
    if measured.any():
        spread = np.where(measured, spread, np.minimum(spread, spread[measured].min()))
    error = rounding_error(spread, steps)
    error[0, 0] = steps[0, 0] ** 2 / 12  # of the mean, which is no rounding to zero
    return float(error.mean())


def rounding_error(spread: NDArray[Any], step: NDArray[Any]) -> NDArray[np.float64]:
    """Mean squared error of rounding values of a Laplace distribution to multiples of a step.

    Parameters
    ----------
    spread : array
        Mean absolute value.
    step : array
    """
    b, a = np.asarray(spread, np.float64), np.asarray(step, np.float64) / 2
    beyond = np.exp(-a / b)
    of_zero = 2 * b**2 - beyond * (a**2 + 2 * a * b + 2 * b**2)
    inner, outer = a**2 - 2 * a * b + 2 * b**2, a**2 + 2 * a * b + 2 * b**2
    of_others = (inner - outer * beyond**2) / (1 - beyond**2)
    return np.asarray(of_zero + beyond * of_others)


def _blocks(image: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Blocks of brightness, (n, 8, 8); of a large picture some rows of them."""
    rows, cols = image.shape[0] // _SIDE, image.shape[1] // _SIDE
    step = max(1, rows * cols // _MOST_BLOCKS)
    cut = image[: rows * _SIDE, : cols * _SIDE]
    tiles = cut.reshape(rows, _SIDE, cols, _SIDE, *image.shape[2:])[::step].astype(np.float64)
    if image.ndim == 3:  # brightness as JPEG has it, from blue, green, red
        tiles = tiles[..., :3] @ np.array([0.114, 0.587, 0.299])
    return tiles.transpose(0, 2, 1, 3).reshape(-1, _SIDE, _SIDE)


def _cosines() -> NDArray[np.float64]:
    k, x = np.mgrid[:_SIDE, :_SIDE]
    basis = np.cos((2 * x + 1) * k * math.pi / (2 * _SIDE)) * math.sqrt(2 / _SIDE)
    basis[0] /= math.sqrt(2)
    return np.asarray(basis, np.float64)


def _steps(data: bytes) -> NDArray[np.float64] | None:
    """Steps of the coefficients of brightness, (8, 8); None if the header does not say."""
    tables: dict[int, list[int]] = {}
    wanted, at = None, 2
    while at + 4 <= len(data) and data[at] == 0xFF and data[at + 1] != _SCAN:
        marker, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4])
        content = data[at + 4 : at + 2 + length]
        if marker == 0xFF:  # filling
            at += 1
            continue
        if marker == _TABLES:
            tables |= _tables(content)
        elif marker in _FRAMES and len(content) >= 9:
            wanted = content[8]  # of the first component
        at += 2 + max(length, 2)
    values = tables.get(-1 if wanted is None else wanted, [])
    if len(values) != _SIDE**2 or not all(values):
        return None
    steps = np.empty((_SIDE, _SIDE))
    for (row, col), value in zip(_ZIGZAG, values, strict=True):
        steps[row, col] = value
    return steps


def _tables(content: bytes) -> dict[int, list[int]]:
    found, at = {}, 0
    while at < len(content):
        size = 2 if content[at] >> 4 else 1
        values = content[at + 1 : at + 1 + size * _SIDE**2]
        found[content[at] & 15] = [
            int.from_bytes(values[k : k + size]) for k in range(0, len(values), size)
        ]
        at += 1 + size * _SIDE**2
    return found
