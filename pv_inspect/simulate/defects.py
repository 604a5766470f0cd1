"""Cracks, and what they do to the current: areas cut off from the busbars are dark."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.geometry.layout import ModuleLayout

__all__ = ["Crack", "CrackMaps", "cut_off", "draw_cracks", "finger_interruptions", "grow_cracks"]

_SHIFT = 4
"""Fractional bits of the coordinates that OpenCV draws with."""

_MASK_WIDTH = 0.0125
"""Least width of a crack in the mask, module units: 3 px at 240 px per cell, so that
area-filtering the mask to a coarser grid keeps it in one piece."""


@dataclass(frozen=True)
class Crack:
    """One polyline in the module plane.

    Parameters
    ----------
    points : (n, 2) float64
        Module units.
    home : tuple of int
        (row, col) of the cell where it starts.
    crosses : bool
        It goes on in the neighbouring cells.
    width : float
        Full width at half depth, module units.
    contrast : float
        Depth of the dark line, share of the radiance.
    isolation : float
        Share of the current that does not get across.
    """

    points: NDArray[np.float64]
    home: tuple[int, int]
    crosses: bool
    width: float
    contrast: float
    isolation: float


@dataclass(frozen=True)
class CrackMaps:
    """Cracks on the grid of the scene, each (height, width).

    ``transmission`` float32 share of light that is left, ``mask`` bool truth of the crack map,
    ``barrier`` float32 isolation of the cracks, 0 elsewhere.
    """

    transmission: NDArray[np.float32]
    mask: NDArray[np.bool_]
    barrier: NDArray[np.float32]


def grow_cracks(
    rng: np.random.Generator, layout: ModuleLayout, share: float, wafer: str
) -> tuple[Crack, ...]:
    """Cracks of a module: single lines, crosses and dendritic trees.

    Monocrystalline silicon breaks along its diagonals, cast silicon in any direction.
    """
    cracks: list[Crack] = []
    for row in range(layout.rows):
        for col in range(layout.cols):
            if rng.random() >= share:
                continue
            origin = np.array([layout.col_starts[col], layout.row_starts[row]])
            start = origin + rng.uniform(0.12, 0.88, 2) * [layout.widths[col], layout.heights[row]]
            kind = rng.choice(["line", "cross", "tree"], p=[0.5, 0.25, 0.25])
            # Log-uniform: many faint cracks of some per cent, some strong ones.
            contrast = float(np.exp(rng.uniform(np.log(0.05), np.log(0.75))))
            width = float(rng.uniform(0.006, 0.014) * (0.7 + 0.8 * contrast))
            isolated = rng.random() < 0.55 and contrast > 0.15
            isolation = float(rng.uniform(0.3, 1.0)) if isolated else 0.0
            crosses = bool(rng.random() < 0.3)
            base = Crack(np.empty((0, 2)), (row, col), crosses, width, contrast, isolation)
            angle = _angle(rng, wafer)
            turns = {"line": [0.0, np.pi], "cross": [0.0, 0.5, 1.0, 1.5], "tree": []}[kind]
            if kind == "cross":
                turns = [np.pi * t + rng.normal(0, 0.08) for t in turns]
            if kind == "tree":
                n = int(rng.integers(3, 6))
                spread = 0.15 if wafer == "mono" else 0.35
                turns = list(2 * np.pi * np.arange(n) / n + rng.normal(0, spread, n))
            for turn in turns:
                reach = rng.uniform(0.25, 1.0 if kind != "tree" else 0.6)
                levels = {"line": 1, "cross": 1, "tree": 2 if wafer == "mono" else 3}[kind]
                _grow(rng, base, start, angle + turn, reach, wafer, levels, cracks)
    return tuple(cracks)


def _angle(rng: np.random.Generator, wafer: str) -> float:
    if wafer == "mono" and rng.random() < 0.8:
        return float(np.pi / 4 + np.pi / 2 * rng.integers(4) + rng.normal(0, 0.06))
    return float(rng.uniform(0, 2 * np.pi))


def _grow(
    rng: np.random.Generator,
    base: Crack,
    start: NDArray[np.float64],
    angle: float,
    length: float,
    wafer: str,
    levels: int,
    cracks: list[Crack],
) -> None:
    """Append a wandering polyline and its branches."""
    step = 0.02
    n = max(int(length / step), 2)
    mono = wafer == "mono"
    wander = 0.012 if mono else 0.10
    turn = np.cumsum(rng.normal(0, wander, n))
    turn -= np.linspace(0, turn[-1] * 0.7, n)  # a crack keeps its main direction
    headings = angle + turn
    kinks = rng.random(n) < (0.02 if mono else 0.05)
    headings += np.cumsum(np.where(kinks, rng.normal(0, 0.3, n), 0.0))
    steps = step * np.column_stack([np.cos(headings), np.sin(headings)])
    points = np.vstack([start, start + np.cumsum(steps, axis=0)])
    cracks.append(Crack(points, base.home, base.crosses, base.width, base.contrast, base.isolation))
    if levels <= 0:
        return
    chance = 0.35 if levels == 1 else 0.75
    for _ in range(int(rng.binomial(3, chance))):
        at = int(rng.integers(n // 4, n))
        # The planes along which monocrystalline silicon breaks stand at right angles.
        side = rng.choice([-1.0, 1.0]) * (np.pi / 2 if mono else rng.uniform(0.4, 1.1))
        thinner = Crack(
            base.points,
            base.home,
            base.crosses,
            0.85 * base.width,
            base.contrast * rng.uniform(0.5, 0.95),
            base.isolation if rng.random() < 0.4 else 0.0,
        )
        reach = length * rng.uniform(0.25, 0.6)
        _grow(rng, thinner, points[at], headings[at] + side, reach, wafer, levels - 1, cracks)


def draw_cracks(
    cracks: tuple[Crack, ...],
    layout: ModuleLayout,
    shape: tuple[int, int],
    pixels_per_unit: float,
    origin_px: tuple[float, float],
) -> CrackMaps:
    """Rasterise the cracks.

    Parameters
    ----------
    cracks : tuple of Crack
    layout : ModuleLayout
    shape : tuple of int
        (height, width) of the scene.
    pixels_per_unit : float
    origin_px : tuple of float
        (x, y) of the top-left crossing in scene pixels.

    Notes
    -----
    An anti-aliased line has an integral of one pixel across. Blurred to the width w of the crack
    (full width at half depth) and multiplied by 1.064 w it is a Gaussian of depth 1 where w is
    wider than a pixel, and has the right integral where it is narrower.
    """
    transmission = np.ones(shape, np.float32)
    barrier = np.zeros(shape, np.float32)
    mask = np.zeros(shape, np.uint8)
    extent = np.array(layout.size) * pixels_per_unit
    for crack in cracks:
        points = np.asarray(origin_px) + pixels_per_unit * crack.points
        row, col = crack.home
        start = np.array([layout.col_starts[col], layout.row_starts[row]])
        corner = np.asarray(origin_px) + pixels_per_unit * start
        cell = np.array([layout.widths[col], layout.heights[row]]) * pixels_per_unit
        low, high = (
            (np.asarray(origin_px), np.asarray(origin_px) + extent)
            if crack.crosses
            else (corner, corner + cell)
        )
        pad = 4 + 3 * crack.width * pixels_per_unit
        x0, y0 = np.maximum(np.ceil(np.maximum(low, points.min(0) - pad)), 0).astype(int)
        x1, y1 = np.floor(np.minimum(high, points.max(0) + pad)).astype(int) + 1
        if x1 - x0 < 1 or y1 - y0 < 1:
            continue
        window = (slice(y0, y1), slice(x0, x1))
        canvas = np.zeros((y1 - y0, x1 - x0), np.uint8)
        line = np.round((points - [x0, y0]) * 2**_SHIFT).astype(np.int32)
        width_px = crack.width * pixels_per_unit
        soft = cv2.polylines(canvas.copy(), [line], False, 255, 1, cv2.LINE_AA, _SHIFT)
        depth = np.asarray(soft, np.float32) / 255
        if width_px / 2.355 > 0.3:
            depth = np.asarray(cv2.GaussianBlur(depth, (0, 0), width_px / 2.355), np.float32)
        depth = np.clip(np.float32(1.064 * width_px) * depth, 0, 1)
        transmission[window] *= 1.0 - crack.contrast * depth
        thick = max(round(max(crack.width, _MASK_WIDTH) * pixels_per_unit), 1)
        wide = cv2.polylines(canvas.copy(), [line], False, 255, thick, cv2.LINE_8, _SHIFT)
        mask[window] |= np.asarray(wide, np.uint8)
        if crack.isolation > 0:
            hard = cv2.polylines(canvas, [line], False, 1, 1, cv2.LINE_8, _SHIFT)
            barrier[window] = np.maximum(barrier[window], crack.isolation * hard)
    return CrackMaps(transmission, mask > 0, barrier)


def cut_off(barrier: NDArray[np.float32], busbars: int) -> NDArray[np.float32]:
    """How far each point of a cell is cut off from its current.

    A finger runs along y and is fed by the busbars next to it: by two between busbars, by one
    beyond the outer ones. A point is cut off as far as *all* its ways to a busbar are.

    Parameters
    ----------
    barrier : (height, width) float32
        Isolation of the cracks in one cell, 0 where there is none; busbars run along x.
    busbars : int

    Returns
    -------
    (height, width) float32
        0 fully fed ... 1 cut off.
    """
    height = barrier.shape[0]
    at = [int((k + 0.5) / busbars * height) for k in range(busbars)]
    result = np.zeros_like(barrier)
    edges = [0, *at, height]
    for k, (top, bottom) in enumerate(pairwise(edges)):
        part = barrier[top:bottom]
        if not part.any():
            continue
        from_top = np.maximum.accumulate(part, axis=0)
        from_bottom = np.maximum.accumulate(part[::-1], axis=0)[::-1]
        if k == 0:
            result[top:bottom] = from_bottom
        elif k == busbars:
            result[top:bottom] = from_top
        else:
            # The longer way through the other busbar's half also costs a little light.
            both = np.minimum(from_top, from_bottom)
            result[top:bottom] = both + 0.12 * (np.maximum(from_top, from_bottom) - both)
    return result


def finger_interruptions(
    rng: np.random.Generator, shape: tuple[int, int], pitch: float, busbars: int
) -> NDArray[np.float32]:
    """Broken fingers: dark strips from the break to where the next busbar feeds again.

    Returns
    -------
    (height, width) float32
        Radiance factor.
    """
    height, width = shape
    value = np.ones(shape, np.float32)
    edges = np.array([0.0, *((np.arange(busbars) + 0.5) / busbars), 1.0]) * height
    cluster = rng.random() < 0.15
    for _ in range(int(rng.poisson(10 if cluster else 0.9))):
        k = int(rng.integers(busbars + 1))
        span = edges[k + 1] - edges[k]
        cut = edges[k] + span * rng.uniform(0.05, 0.9)
        y0, y1 = (
            (edges[k], cut)
            if k == 0 or (k < busbars and rng.random() < 0.5)
            else (
                cut,
                edges[k + 1],
            )
        )
        x0 = rng.uniform(0, width)
        x1 = x0 + rng.choice([0.6, 0.6, 1, 1, 2]) / 64.0 / pitch
        y = np.arange(height, dtype=np.float32)[:, None]
        x = np.arange(width, dtype=np.float32)[None, :]
        across = np.clip(np.minimum(x - x0, x1 - x) + 0.5, 0, 1)
        # Light fades along the finger away from the end that is still fed.
        along = np.clip(np.minimum(y - y0, y1 - y) / (0.15 * span) + 0.3, 0, 1)
        value *= 1.0 - np.float32(rng.uniform(0.08, 0.4)) * across * along
    return value
