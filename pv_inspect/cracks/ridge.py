"""Cracks as dark ridges: oriented filters at several scales and a fixed quadratic read-out.

A crack is a thin dark line. Second derivatives of Gaussians that are short across and long along
one of 16 directions answer to it [1]_; multicrystalline texture answers as well, but to all
directions and everywhere, so that the response is judged against the response around it. How the
answers are weighed was fitted once on cells with labelled cracks (`benchmarks/fit_ridge.py`) and
lies in ``ridge_weights.json``.

References
----------
.. [1] T. Lindeberg, "Edge detection and ridge detection with automatic scale selection",
       International Journal of Computer Vision 30, 1998. doi:10.1023/A:1008097225773
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import find_objects

from pv_inspect.cracks.flatten import CELL_PX, FlatCell, flatten

__all__ = ["N_FEATURES", "RidgeDetector", "RidgeWeights", "ridge_features"]

Image = NDArray[np.float32]

N_FEATURES = 14
_DIRECTIONS = 16
# (sigma across, sigma along) of the filters, pixels of a cell of CELL_PX.
_FINE, _MEDIUM, _LONG = (0.9, 3.5), (1.5, 5.0), (1.2, 10.0)
_AROUND_PX = 0.07 * CELL_PX
_PAD = 24
_EPS = 0.004
_LIMIT = 2.5
# Marks shorter than this, in cell widths, lose probability in proportion.
_FULL_LENGTH_CELLS = 0.15
_MARK_LEVEL = 0.25


@dataclass(frozen=True, eq=False)
class RidgeWeights:
    """Read-out of the ridge features x: log odds = bias + b.z + z.Q z, z = (x - mean) / scale.

    z is kept within +-2.5: beyond what was seen when the weights were fitted, a quadratic form
    says anything.

    Parameters
    ----------
    mean, scale, linear : (N_FEATURES,) float32
    quadratic : (N_FEATURES, N_FEATURES) float32
    bias : float
    """

    mean: NDArray[np.float32]
    scale: NDArray[np.float32]
    linear: NDArray[np.float32]
    quadratic: NDArray[np.float32]
    bias: float

    @classmethod
    @lru_cache(maxsize=1)
    def load(cls) -> RidgeWeights:
        """Return the weights that come with the package."""
        stored = json.loads(files(__package__).joinpath("ridge_weights.json").read_text("utf-8"))
        arrays = {name: np.array(stored[name], np.float32) for name in stored if name != "bias"}
        return cls(**arrays, bias=float(stored["bias"]))

    def normalised(self, features: Image) -> Image:
        """Z of features (..., N_FEATURES)."""
        return np.asarray(np.clip((features - self.mean) / self.scale, -_LIMIT, _LIMIT))

    def log_odds(self, features: Image) -> Image:
        """Log odds (..., ) of features (..., N_FEATURES)."""
        z = self.normalised(features)
        return np.asarray(self.bias + z @ self.linear + ((z @ self.quadratic) * z).sum(-1))


class RidgeDetector:
    """Classical crack detector; see the top of this file.

    Parameters
    ----------
    weights : RidgeWeights, optional
        The ones of the package if not given.
    """

    name = "oriented ridge filters"

    def __init__(self, weights: RidgeWeights | None = None) -> None:
        self._weights = weights if weights is not None else RidgeWeights.load()

    def probability(self, tile: Image) -> Image:
        """Return the crack probability of every pixel of a cell.

        Parameters
        ----------
        tile : (h, w) float32
            One cell, any brightness scale.

        Returns
        -------
        (h, w) float32
            In [0, 1]; 0 on busbars and on the border of the cell. 0.5 is the level of the best
            F1 on labelled cells.
        """
        if float(np.ptp(tile)) <= 0:
            return np.zeros(tile.shape, np.float32)
        cell = flatten(tile)
        log_odds = self._weights.log_odds(ridge_features(cell))
        p = np.asarray(1.0 / (1.0 + np.exp(-np.clip(log_odds, -30, 30))), np.float32)
        p[cell.outside | cell.lines] = 0.0
        p = _by_length(p)
        size = (tile.shape[1], tile.shape[0])
        way = cv2.INTER_LINEAR if max(tile.shape) > CELL_PX else cv2.INTER_AREA
        return np.clip(np.asarray(cv2.resize(p, size, interpolation=way), np.float32), 0, 1)


def ridge_features(cell: FlatCell) -> Image:
    """Ridge features of every pixel of a cell.

    Parameters
    ----------
    cell : FlatCell

    Returns
    -------
    (h, w, N_FEATURES) float32
        Logarithms of responses (dark ridges positive), contrast, and ratios of responses.
    """
    contrast, (h, w) = cell.contrast, cell.contrast.shape
    padded = np.pad(contrast, _PAD, mode="reflect")
    shape = tuple(fft.next_fast_len(n, real=True) for n in padded.shape)
    missing = [(0, want - have) for want, have in zip(shape, padded.shape, strict=True)]
    spectrum = fft.rfft2(np.pad(padded, missing, mode="edge"))

    def filtered(transfer: NDArray[np.generic]) -> Image:
        whole = fft.irfft2(spectrum * transfer, s=shape, axes=(-2, -1))
        return np.asarray(whole[..., _PAD : _PAD + h, _PAD : _PAD + w], np.float32)

    def at(responses: Image, direction: NDArray[np.intp]) -> Image:
        return np.asarray(np.take_along_axis(responses, direction[None], 0)[0], np.float32)

    def around(energy: Image) -> Image:
        return np.sqrt(cv2.GaussianBlur(energy**2, (0, 0), _AROUND_PX))

    fine = filtered(_ridge_filters(shape, *_FINE)).max(0)
    medium = filtered(_ridge_filters(shape, *_MEDIUM))
    long = filtered(_ridge_filters(shape, *_LONG))
    best_medium, best_long = medium.max(0), long.max(0)
    energy_medium = np.sqrt((medium**2).mean(0))
    energy_long = np.sqrt((long**2).mean(0))
    around_medium, around_long = around(energy_medium), around(energy_long)
    usual = np.full((h, w), np.median(energy_medium[~cell.outside]), np.float32)
    edges = filtered(_edge_filters(shape, *_MEDIUM))
    edge = np.abs(at(edges, long.argmax(0)))
    long_at_medium = at(long, medium.argmax(0))
    broad = filtered(_gaussian(shape, 3.0))

    def log(value: Image) -> Image:
        return np.log(np.maximum(value, 0) + _EPS)

    return np.stack(
        [
            log(fine),
            log(best_medium),
            log(best_long),
            log(around_medium),
            log(around_long),
            log(usual),
            log(edge),
            contrast,
            broad,
            log(long_at_medium),
            best_long / (energy_long + _EPS),
            best_medium / (around_medium + _EPS),
            best_long / (around_long + _EPS),
            log(cell.background),
        ],
        axis=-1,
    )


def _by_length(p: Image) -> Image:
    """Take probability from short marks: a crack is long, a speck of texture is not."""
    _, labels = cv2.connectedComponents((p > _MARK_LEVEL).astype(np.uint8), connectivity=8)
    boxes = find_objects(labels)
    extents = [np.hypot(y.stop - y.start, x.stop - x.start) / CELL_PX for y, x in boxes]
    factor = np.minimum(np.array([_FULL_LENGTH_CELLS, *extents]) / _FULL_LENGTH_CELLS, 1.0)
    return np.asarray(p * factor[labels], np.float32)


def _frequencies(shape: tuple[int, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Angular frequencies along y and x of a real transform, radians per pixel."""
    return 2 * np.pi * fft.fftfreq(shape[0])[:, None], 2 * np.pi * fft.rfftfreq(shape[1])[None]


def _oriented(
    shape: tuple[int, ...], across: float, along: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gaussians and normalised frequencies across the line for all directions."""
    wy, wx = _frequencies(shape)
    angle = (np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS)[:, None, None]
    u = (wx * np.cos(angle) + wy * np.sin(angle)) * along
    v = (wy * np.cos(angle) - wx * np.sin(angle)) * across
    return np.exp(-0.5 * (u**2 + v**2)), v


@lru_cache(maxsize=8)
def _ridge_filters(shape: tuple[int, ...], across: float, along: float) -> NDArray[np.float32]:
    """Transfer functions of the second derivatives across the line, scale-normalised."""
    gaussian, v = _oriented(shape, across, along)
    return np.asarray(-(v**2) * gaussian, np.float32)


@lru_cache(maxsize=4)
def _edge_filters(shape: tuple[int, ...], across: float, along: float) -> NDArray[np.complex64]:
    """Transfer functions of the first derivatives across the line, scale-normalised."""
    gaussian, v = _oriented(shape, across, along)
    return np.asarray(1j * v * gaussian, np.complex64)


@lru_cache(maxsize=4)
def _gaussian(shape: tuple[int, ...], sigma: float) -> NDArray[np.float32]:
    wy, wx = _frequencies(shape)
    return np.asarray(np.exp(-0.5 * sigma**2 * (wx**2 + wy**2)), np.float32)
