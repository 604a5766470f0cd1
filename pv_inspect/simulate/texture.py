"""Silicon and metal of one cell as electroluminescence shows them, procedurally.

Every function works in the frame of the metallisation: busbars run along x (columns of the
array), fingers along y. Lengths are in module units (one cell width).
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

__all__ = ["cell_shading", "fractal_noise", "metal", "monocrystalline", "multicrystalline"]

Image = NDArray[np.float32]


def fractal_noise(
    rng: np.random.Generator,
    shape: tuple[int, int],
    base: tuple[float, float],
    octaves: int,
    persistence: float = 0.55,
) -> Image:
    """Smooth random field of zero mean and about unit variance.

    Parameters
    ----------
    rng : numpy.random.Generator
    shape : tuple of int
        (height, width) of the field.
    base : tuple of float
        Knots of the coarsest octave along (y, x); each octave doubles them.
    octaves : int
    persistence : float
        Amplitude of an octave relative to the coarser one.

    Returns
    -------
    (height, width) float32
    """
    height, width = shape
    total = np.zeros(shape, np.float32)
    power = 0.0
    for octave in range(octaves):
        knots = [max(round(b * 2**octave), 1) + 3 for b in base]
        # The spline needs support beyond the border: enlarge a bigger grid and cut it.
        grid = rng.standard_normal(knots).astype(np.float32)
        scale = [n / (k - 3) for n, k in zip(shape, knots, strict=True)]
        rows = (np.arange(height, dtype=np.float32) + 0.5) / scale[0] + 0.5
        cols = (np.arange(width, dtype=np.float32) + 0.5) / scale[1] + 0.5
        x, y = np.meshgrid(cols, rows)
        amplitude = persistence**octave
        total += amplitude * cv2.remap(grid, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        power += 0.45 * amplitude**2
    return np.asarray(total / np.sqrt(power), np.float32)


def multicrystalline(rng: np.random.Generator, shape: tuple[int, int], pitch: float) -> Image:
    """Grains, grain boundaries and dislocation clusters of a cast wafer.

    Parameters
    ----------
    rng : numpy.random.Generator
    shape : tuple of int
        (height, width) in scene pixels.
    pitch : float
        Size of a scene pixel, module units.

    Returns
    -------
    (height, width) float32
        Radiance factor, about 1 for undisturbed silicon.
    """
    height, width = shape
    extent = np.array([width, height]) * pitch
    knots = (10 * extent[1], 10 * extent[0])
    y, x = np.mgrid[0:height, 0:width].astype(np.float32) * np.float32(pitch)
    warp_x = 0.018 * fractal_noise(rng, shape, knots, 3)
    warp_y = 0.018 * fractal_noise(rng, shape, knots, 3)
    n_grains = 4 + int(rng.poisson(70 * extent.prod()))
    seeds = rng.uniform(-0.1, 1.1, (n_grains, 2)) * extent
    points = np.stack([(x + warp_x) * 1.15, y + warp_y], axis=-1).reshape(-1, 2)
    distance, grain = cKDTree(seeds * [1.15, 1.0]).query(points, k=2)
    distance = distance.reshape(height, width, 2).astype(np.float32)
    grain = grain.reshape(height, width, 2)

    brightness = rng.normal(0.0, 0.022, n_grains).astype(np.float32)
    value = 1.0 + brightness[grain[..., 0]]
    # Recombination differs from boundary to boundary; the pair of grains names the boundary.
    low, high = grain.min(axis=-1), grain.max(axis=-1)
    activity = ((low * 7919 + high * 104729) % 1009 / 1009.0).astype(np.float32) ** 3
    gap = distance[..., 1] - distance[..., 0]
    value *= 1.0 - 0.22 * activity * np.exp(-((gap / 0.007) ** 2))

    # Dislocations come in clusters, in some grains and in some regions of the wafer.
    density = rng.beta(0.7, 2.2, n_grains).astype(np.float32)[grain[..., 0]]
    density = cv2.GaussianBlur(density, (0, 0), max(0.012 / pitch, 0.3))
    region = fractal_noise(rng, shape, (2 * extent[1] + 1, 2 * extent[0] + 1), 2)
    smudge = fractal_noise(rng, shape, (7 * extent[1], 10 * extent[0]), 3, 0.5)
    cloud = fractal_noise(rng, shape, (16 * extent[1], 20 * extent[0]), 4, 0.6)
    speckle = fractal_noise(rng, shape, (36 * extent[1], 60 * extent[0]), 3, 0.7)
    level = rng.uniform(1.1, 2.4)
    where = 0.55 * smudge + 1.5 * density + 0.45 * region - level
    cluster = np.logaddexp(0.0, 3.5 * (where + 0.75 * cloud)) / 3.5
    cluster = np.minimum(cluster, 2.0)
    value *= np.exp(-rng.uniform(0.2, 0.42) * cluster * np.clip(0.8 + 0.35 * speckle, 0, 2))
    haze = np.logaddexp(0.0, 3.0 * (where + 0.6)) / 3.0
    value *= np.exp(-0.10 * haze)
    value *= 1.0 + 0.010 * speckle + 0.03 * region
    return np.asarray(value, np.float32)


def monocrystalline(rng: np.random.Generator, shape: tuple[int, int], pitch: float) -> Image:
    """Smooth wafer with growth rings, sometimes the print of a conveyor belt."""
    height, width = shape
    extent = np.array([width, height]) * pitch
    y, x = np.mgrid[0:height, 0:width].astype(np.float32) * np.float32(pitch)
    centre = extent / 2 + rng.normal(0.0, 0.06, 2)
    radius = np.hypot(x - centre[0], y - centre[1])
    value = 1.02 - rng.uniform(0.02, 0.14) * radius**2
    rings = np.sin(2 * np.pi * (radius * rng.uniform(9, 16) + rng.uniform()))
    value += rng.uniform(0.0, 0.01) * rings * (radius + 0.2)
    value += 0.012 * fractal_noise(rng, shape, (3 * extent[1] + 1, 3 * extent[0] + 1), 3)
    value += 0.004 * fractal_noise(rng, shape, (50 * extent[1], 50 * extent[0]), 2)
    if rng.random() < 0.3:
        fx, fy = rng.uniform(9, 12), rng.uniform(6, 8)
        row = np.floor(fy * y)
        dots = np.cos(2 * np.pi * (fx * x + 0.5 * row)) * np.cos(2 * np.pi * fy * y)
        patch = fractal_noise(rng, shape, (2 * extent[1] + 1, 2 * extent[0] + 1), 2)
        value -= rng.uniform(0.02, 0.07) * np.clip(dots, 0, 1) ** 2 * np.clip(0.6 + patch, 0, 1.5)
    for _ in range(rng.poisson(1.2)):
        spot = rng.uniform(0.05, 0.95, 2) * extent
        size = rng.uniform(0.004, 0.014)
        value -= rng.uniform(0.1, 0.6) * np.exp(
            -((x - spot[0]) ** 2 + (y - spot[1]) ** 2) / (2 * size**2)
        )
    return np.asarray(value, np.float32)


def cell_shading(rng: np.random.Generator, shape: tuple[int, int], busbars: int) -> Image:
    """Slow brightness of a cell: current crowding at the busbars, brick edges, a tilt.

    Returns
    -------
    (height, width) float32
        Radiance factor.
    """
    height, width = shape
    v, u = np.mgrid[0:height, 0:width].astype(np.float32)
    u, v = (u + 0.5) / width, (v + 0.5) / height
    value = 1.0 - rng.uniform(0.015, 0.05) * np.cos(2 * np.pi * busbars * v)
    value *= 1.0 + rng.normal(0, 0.04) * (u - 0.5) + rng.normal(0, 0.04) * (v - 0.5)
    if rng.random() < 0.35:
        edge = (u, 1 - u, v, 1 - v)[rng.integers(4)]
        value *= 1.0 - rng.uniform(0.08, 0.4) * np.exp(-edge / rng.uniform(0.03, 0.12))
    rim = np.minimum(np.minimum(u, 1 - u), np.minimum(v, 1 - v))
    value *= 1.0 - 0.10 * np.exp(-rim / 0.012)
    return np.asarray(value, np.float32)


def metal(
    rng: np.random.Generator, shape: tuple[int, int], pitch: float, busbars: int, style: str
) -> Image:
    """Shadow of busbars and fingers.

    Parameters
    ----------
    rng : numpy.random.Generator
    shape : tuple of int
        (height, width) in scene pixels; busbars run along the width.
    pitch : float
        Size of a scene pixel, module units.
    busbars : int
    style : {"solid", "dashed"}
        Dashed: a thin line with soldered pads.

    Returns
    -------
    (height, width) float32
        Share of light that passes.
    """
    height, width = shape
    length, depth = width * pitch, height * pitch
    x = (np.arange(width, dtype=np.float32) + 0.5) * np.float32(pitch)
    y = (np.arange(height, dtype=np.float32) + 0.5) * np.float32(pitch)
    # Real cells have 75 fingers and more; they are printed at random phase.
    fingers = 0.5 + 0.5 * np.cos(2 * np.pi * (x * 64.0 + rng.uniform()))
    value = np.repeat(1.0 - 0.035 * fingers[None, :] ** 2, height, axis=0)
    half = {"solid": 0.030, "dashed": 0.024}[style] / max(busbars, 3) ** 0.6 / 2 * 1.3
    end = 0.035
    pads = 4
    for k in range(busbars):
        d = np.abs(y - (k + 0.5) / busbars * depth)[:, None]
        soft = pitch
        inside = np.clip((length / 2 - end - np.abs(x - length / 2)) / pitch + 0.5, 0, 1)[None, :]
        if style == "solid":
            line = np.clip((half - d) / soft + 0.5, 0, 1) * inside
            thin = np.clip((0.35 * half - d) / soft + 0.5, 0, 1)
            shade = np.maximum(rng.uniform(0.68, 0.82) * line, 0.45 * thin)
        else:
            phase = (x / length * pads) % 1.0
            on = np.clip((0.25 - np.abs(phase - 0.5)) * length / pads / pitch + 0.5, 0, 1)[None, :]
            line = np.clip((half - d) / soft + 0.5, 0, 1) * on
            thin = np.clip((0.4 * half - d) / soft + 0.5, 0, 1) * inside
            shade = np.maximum(rng.uniform(0.7, 0.85) * line, 0.55 * thin)
        halo = np.exp(-((d / (3 * half)) ** 2)) * inside
        value *= (1.0 - shade) * (1.0 - 0.05 * halo)
    return np.asarray(value, np.float32)
