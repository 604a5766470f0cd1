"""The rectified scene: radiance of a whole module in the module plane, with its crack mask."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.simulate.defects import (
    CrackMaps,
    cut_off,
    draw_cracks,
    finger_interruptions,
    grow_cracks,
)
from pv_inspect.simulate.settings import SimulationSettings
from pv_inspect.simulate.texture import (
    cell_shading,
    metal,
    monocrystalline,
    multicrystalline,
)

__all__ = ["CellTruth", "Scene", "render_scene"]

Image = NDArray[np.float32]

MEAN_RADIANCE = 0.7
"""Radiance of an average cell."""
MARGIN = 0.2
"""Border of the scene around the cells, module units: backsheet and frame."""
_BACKSHEET, _FRAME = 0.055, 0.012
_FRAME_AT = 0.15


@dataclass(frozen=True)
class CellTruth:
    """What was put into one cell: its gain, and ``cracked`` / ``dark`` for a look at the truth."""

    row: int
    col: int
    gain: float
    cracked: bool
    dark: bool


@dataclass(frozen=True)
class Scene:
    """A plane that emits light, sampled on a regular grid of the module plane.

    Parameters
    ----------
    layout : ModuleLayout
    pixels_per_unit : float
        Scene pixels per module unit.
    origin_px : tuple of float
        (x, y) of the top-left outer crossing, scene pixels, pixel centres at integers.
    radiance : (height, width) float32
        About 0.7 for an average cell; 0 outside of the image.
    cracks : (height, width) bool
        True on cracks.
    cells : tuple of CellTruth
        Row-major; empty for a scene that is no module.
    """

    layout: ModuleLayout
    pixels_per_unit: float
    origin_px: tuple[float, float]
    radiance: Image
    cracks: NDArray[np.bool_]
    cells: tuple[CellTruth, ...] = ()


def scene_grid(layout: ModuleLayout, pixels_per_unit: int) -> tuple[tuple[int, int], float]:
    """Shape of the scene and the pixel coordinate of its origin, the same in x and y.

    Cell borders fall between pixels.
    """
    pad = round(MARGIN * pixels_per_unit)
    width, height = layout.size
    shape = (
        int(np.ceil(height * pixels_per_unit)) + 2 * pad,
        int(np.ceil(width * pixels_per_unit)) + 2 * pad,
    )
    return shape, pad - 0.5


def render_scene(
    settings: SimulationSettings, rng: np.random.Generator
) -> Generator[float, None, Scene]:
    """Render a module.

    Parameters
    ----------
    settings : SimulationSettings
    rng : numpy.random.Generator

    Yields
    ------
    float
        Share of the cells done.
    """
    layout = settings.layout
    ppu = settings.pixels_per_unit
    shape, origin = scene_grid(layout, ppu)
    cracks = grow_cracks(rng, layout, settings.crack_share, settings.wafer)
    maps = draw_cracks(cracks, layout, shape, ppu, (origin, origin))
    cells_light = np.zeros(shape, np.float32)
    coverage = np.zeros(shape, np.float32)
    truth = []
    # Cells of one module come from one batch: same axis and phase of the metal, similar silicon.
    upright = layout.cell_aspect > 1
    for row in range(layout.rows):
        for col in range(layout.cols):
            window = _cell_window(layout, ppu, origin, row, col)
            tile, cell = _render_cell(settings, layout, rng, maps, window, (row, col), upright)
            inside = _cell_outline(layout, ppu, origin, window, (row, col), settings)
            cells_light[window] = tile * inside
            coverage[window] = inside
            truth.append(cell)
        yield (row + 1) / layout.rows
    radiance = cells_light + (1 - coverage) * _surroundings(cells_light, layout, ppu, origin)
    radiance = _blurred(radiance, settings.scene_blur * ppu)
    mask = maps.mask & (coverage > 0.5)
    return Scene(layout, ppu, (origin, origin), radiance, mask, tuple(truth))


def _blurred(image: Image, sigma_px: float) -> Image:
    """Gaussian blur; 0 leaves the image as it is."""
    if sigma_px <= 0:
        return image
    blurred = cv2.GaussianBlur(image, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(blurred, np.float32)


def _cell_window(
    layout: ModuleLayout, ppu: int, origin: float, row: int, col: int
) -> tuple[slice, slice]:
    """Pixels whose centres lie in the pitch of a cell; where cells lie apart, in the cell itself.

    Its busbars and fingers are spread over the cell. A pixel more on each side is for its border.
    """
    (left, top), _, (right, bottom), _ = layout.cell_corners(row, col)
    gap_x, gap_y = layout.cell_gap
    edges_x = np.ceil(origin + ppu * np.array([left, right])).astype(int)
    edges_y = np.ceil(origin + ppu * np.array([top, bottom])).astype(int)
    edges_x += np.array([-1, 1]) * (gap_x > 0)
    edges_y += np.array([-1, 1]) * (gap_y > 0)
    return slice(*edges_y.tolist()), slice(*edges_x.tolist())


def _render_cell(
    settings: SimulationSettings,
    layout: ModuleLayout,
    rng: np.random.Generator,
    maps: CrackMaps,
    window: tuple[slice, slice],
    place: tuple[int, int],
    upright: bool,
) -> tuple[Image, CellTruth]:
    """Radiance of the pitch of one cell, as if it had no outline."""
    ppu, (row, col) = settings.pixels_per_unit, place
    # Busbars lie as far apart in a cut cell as in a whole one.
    share = layout.widths[col] if upright else layout.heights[row] * layout.cell_aspect
    busbars = max(round(settings.busbars * share), 1)
    barrier = maps.barrier[window]
    # The texture works with busbars along x; on upright cells they run along y.
    barrier = barrier.T if upright else barrier
    shape = (barrier.shape[0], barrier.shape[1])
    silicon = multicrystalline if settings.wafer == "multi" else monocrystalline
    tile = silicon(rng, shape, 1 / ppu)
    tile *= cell_shading(rng, shape, busbars)
    tile *= finger_interruptions(rng, shape, 1 / ppu, busbars)

    lost = cut_off(barrier, busbars)
    stripes = np.repeat(rng.uniform(0.75, 1.0, shape[1] // 4 + 1), 4)[: shape[1]]
    tile *= 1.0 - 0.93 * lost * stripes.astype(np.float32)
    # The current that a dead area does not take makes the rest of the cell brighter.
    gain = float(np.exp(rng.normal(0.0, 0.075))) * (1.0 - 0.8 * float(lost.mean())) ** -0.6
    dark = bool(rng.random() < settings.dark_cell_share)
    if dark:
        gain *= rng.uniform(0.12, 0.5)
    tile *= metal(rng, shape, 1 / ppu, busbars, settings.busbar_style)
    tile = np.ascontiguousarray(tile.T) if upright else tile
    # Light spreads in silicon and glass before it reaches the lens; cracks stay sharper.
    spread = _blurred(tile, settings.light_spread * ppu)
    level = np.float32(MEAN_RADIANCE * 1.04 * gain)
    tile = spread * maps.transmission[window] * level
    cracked = bool(maps.mask[window].any())
    return tile, CellTruth(*place, round(gain, 5), cracked, dark)


def _cell_outline(
    layout: ModuleLayout,
    ppu: int,
    origin: float,
    window: tuple[slice, slice],
    place: tuple[int, int],
    settings: SimulationSettings,
) -> Image:
    """Share of each pixel that the wafer covers; monocrystalline wafers have cut corners.

    Of half-cut cells only the corners on the outer side of the former whole cell are cut.
    """
    row, col = place
    height, width = layout.heights[row], layout.widths[col]
    y = (np.arange(window[0].start, window[0].stop) - origin)[:, None] / ppu
    x = (np.arange(window[1].start, window[1].stop) - origin)[None, :] / ppu
    y, x = y - layout.row_starts[row], x - layout.col_starts[col]
    gap = max(layout.cell_gap[0], settings.wafer_gap)
    left, top = x - gap / 2, y - gap / 2
    right, bottom = width - gap / 2 - x, height - gap / 2 - y
    inside = np.minimum(np.minimum(left, right), np.minimum(top, bottom))
    size = 0.05 if settings.wafer == "mono" else 0.008
    halved_y, halved_x = layout.cell_aspect > 1.5, layout.cell_aspect < 0.67
    for vertical, is_top in ((top, True), (bottom, False)):
        for horizontal, is_left in ((left, True), (right, False)):
            if (halved_y and is_top != (row % 2 == 0)) or (halved_x and is_left != (col % 2 == 0)):
                continue
            inside = np.minimum(inside, (horizontal + vertical - size) / np.sqrt(2))
    return np.asarray(np.clip(inside * ppu + 0.5, 0, 1), np.float32)


def _surroundings(light: Image, layout: ModuleLayout, ppu: int, origin: float) -> Image:
    """Backsheet between and around the cells and the frame, lit by the cells near them."""
    height, width = light.shape
    y = (np.arange(height) - origin)[:, None] / ppu
    x = (np.arange(width) - origin)[None, :] / ppu
    extent = layout.size
    outside = np.maximum(
        np.maximum(-x, x - extent[0]), np.maximum(-y, y - extent[1])
    )  # distance from the cells, negative among them
    frame = np.clip((outside - _FRAME_AT) * ppu + 0.5, 0, 1)
    base = _BACKSHEET + (_FRAME - _BACKSHEET) * frame
    small = cv2.resize(light, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    glow = cv2.GaussianBlur(small, (0, 0), 0.05 * ppu / 4)
    wide = cv2.GaussianBlur(small, (0, 0), 0.3 * ppu / 4)
    glow = cv2.resize(0.09 * glow + 0.03 * wide, (width, height), interpolation=cv2.INTER_LINEAR)
    return (base + glow * (1 - 0.7 * frame)).astype(np.float32)
