"""How the view has moved between two frames whose light differs: registered by their detail.

The camera hardly moves between two frames, so that a polynomial of second degree says where every
pixel went: perspective and the lens are in it. What only one of the frames shows (the glow of the
module) is an outlier to it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.robust import MAD_TO_SIGMA

__all__ = ["Motion", "motion_between"]

Array = NDArray[np.float64]
Image = NDArray[np.float32]

# Detail is what a Gaussian of this sigma takes away after one of the other [px of the level]; of 4
# and 6 after 1 and 2 the pair that left the least error on three simulated pairs of 320 x 256 px
# (0.04 to 0.09 px). Terms of third degree made that worse.
_COARSE, _FINE = 4.0, 1.0
# Halvings of the picture before the first fit, as long as its shorter side keeps so many pixels.
_LEVELS, _LEAST_SIDE = 3, 48
_ITERATIONS = 12
# Standard deviations from which on a residual counts for less (Huber).
_HUBER = 1.5
# What is expected of the terms of degree 0, 1 and 2 [share of the picture's longer side]: keeps
# those small that the detail says nothing about.
_EXPECTED = (0.1, 0.05, 0.02)
_DEGREE = len(_EXPECTED) - 1
_N_TERMS = (_DEGREE + 1) * (_DEGREE + 2) // 2
# The motion must explain this share of the (robust) spread of the detail; less is the noise's.
_WORTH = 0.05
# Pixels that a fit takes at most.
_MOST_PX = 40_000
_LONGEST = 0.25


@dataclass(frozen=True, eq=False)
class Motion:
    """Where the pixels of one frame are in another one: ``x + A [1, u, v, uu, uv, vv]``.

    Parameters
    ----------
    coefficients : (6, 2) float64
        Displacement (x, y) [px] per term; u and v run from -1 to 1 along the longer side.
    """

    coefficients: Array

    def maps(self, shape: tuple[int, int]) -> tuple[Image, Image]:
        """Return x and y in the other frame of every pixel, (height, width) float32."""
        terms = _terms(shape)
        height, width = shape
        y, x = np.mgrid[:height, :width].astype(np.float64)
        dx, dy = np.moveaxis(terms @ self.coefficients, -1, 0)
        return (x + dx).astype(np.float32), (y + dy).astype(np.float32)

    def largest(self, shape: tuple[int, int]) -> float:
        """Longest displacement, px."""
        return float(np.linalg.norm(_terms(shape)[::8, ::8] @ self.coefficients, axis=-1).max())


def motion_between(first: Image, second: Image) -> Motion | None:
    """Find where the pixels of a frame are in a second one.

    Parameters
    ----------
    first, second : (height, width) float32
        Their light may differ by a factor, slowly over the picture, and by what one of them shows.

    Returns
    -------
    Motion or None
        None if moving explains nothing: the camera stood still, or there is no detail.
    """
    pyramid = [(first, second)]
    while len(pyramid) < _LEVELS and min(pyramid[-1][0].shape) >= 2 * _LEAST_SIDE:
        halves = [cv2.resize(p, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
                  for p in pyramid[-1]]  # fmt: skip
        pyramid.append((np.asarray(halves[0], np.float32), np.asarray(halves[1], np.float32)))
    details = [(_detail(a), _detail(b)) for a, b in pyramid]
    coefficients = np.zeros((_N_TERMS, 2))
    small = details[-1][0].shape
    window = cv2.createHanningWindow(small[::-1], cv2.CV_32F)
    (dx, dy), _ = cv2.phaseCorrelate(details[-1][0], details[-1][1], window)
    if np.hypot(dx, dy) < _LONGEST * max(small):
        coefficients[0] = dx, dy
    starts = [coefficients, np.zeros((_N_TERMS, 2))]
    a, b = details[-1]
    coefficients = min((_fit(a, b, start) for start in starts), key=lambda fit: _rest(a, b, fit))
    for a, b in details[-2::-1]:
        coefficients = _fit(a, b, 2 * coefficients)
    a, b = details[0]
    still = _rest(a, b, np.zeros((_N_TERMS, 2)))
    if not _rest(a, b, coefficients) < (1.0 - _WORTH) * still:
        return None
    return Motion(coefficients)


def _detail(picture: Image) -> Image:
    smooth = cv2.GaussianBlur(picture, (0, 0), _FINE)
    slow = cv2.GaussianBlur(picture, (0, 0), _COARSE)
    detail = np.asarray(smooth - slow, np.float32)
    scale = MAD_TO_SIGMA * float(np.median(np.abs(detail)))
    # A bright edge says no more than many faint ones.
    return np.clip(detail, -8 * scale, 8 * scale)


def _terms(shape: tuple[int, int]) -> Array:
    height, width = shape
    half = max(height, width) / 2
    v, u = np.mgrid[:height, :width].astype(np.float64)
    u, v = (u - (width - 1) / 2) / half, (v - (height - 1) / 2) / half
    return np.stack(
        [u ** (d - k) * v**k for d in range(_DEGREE + 1) for k in range(d + 1)], axis=-1
    )


def _moved(second: Image, coefficients: Array) -> tuple[Image, NDArray[np.bool_]]:
    map_x, map_y = Motion(coefficients).maps((second.shape[0], second.shape[1]))
    height, width = second.shape
    seen = (map_x >= 1) & (map_x <= width - 2) & (map_y >= 1) & (map_y <= height - 2)
    moved = cv2.remap(second, map_x, map_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return np.asarray(moved, np.float32), seen


def _rest(first: Image, second: Image, coefficients: Array) -> float:
    moved, seen = _moved(second, coefficients)
    if seen.mean() < 0.5:
        return float("inf")
    return float(np.median(np.abs(first[seen] - _gain(first, moved, seen) * moved[seen])))


def _gain(first: Image, second: Image, seen: NDArray[np.bool_]) -> float:
    """Contrast of the first over the second; its sign is known."""
    power = float(np.sum(np.square(second[seen], dtype=np.float64)))
    product = float(np.sum(first[seen].astype(np.float64) * second[seen]))
    return float(np.clip(product / max(power, 1e-30), 0.2, 5.0))


def _fit(first: Image, second: Image, start: Array) -> Array:
    """Gauss-Newton from a start, with Huber's weights."""
    shape = (first.shape[0], first.shape[1])
    terms, coefficients = _terms(shape), start
    expected = max(shape) * np.repeat(_EXPECTED, range(1, len(_EXPECTED) + 1))
    chosen = np.zeros(shape, bool)
    stride = max(1, round(np.sqrt(first.size / _MOST_PX)))
    chosen[::stride, ::stride] = True
    for _ in range(_ITERATIONS):
        moved, seen = _moved(second, coefficients)
        if seen.mean() < 0.5:
            return start
        gain = _gain(first, moved, seen)
        use = seen & chosen
        rest = (first - gain * moved)[use].astype(np.float64)
        sigma = max(MAD_TO_SIGMA * float(np.median(np.abs(rest))), 1e-12)
        weight = np.minimum(1.0, _HUBER * sigma / np.maximum(np.abs(rest), 1e-12)) / sigma**2
        slopes = [gain * np.asarray(g)[use].astype(np.float64) for g in np.gradient(moved)[::-1]]
        basis = terms[use]
        # Neighbouring pixels share their detail: a fifth of them is independent.
        jacobian = np.concatenate([basis * slope[:, None] for slope in slopes], axis=1)
        weighted = jacobian * (0.2 * weight)[:, None]
        prior = np.concatenate([1 / expected**2, 1 / expected**2])
        normal = weighted.T @ jacobian + np.diag(prior)
        right = weighted.T @ rest - prior * coefficients.T.ravel()
        step = np.linalg.solve(normal, right).reshape(2, -1).T
        coefficients = coefficients + step
        if np.abs(step).max() < 2e-3:
            break
    return coefficients
