"""Cell tiles in, crack probability and features per cell out.

What finds the cracks is exchangeable: anything with the two members of `CrackDetector` will do.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from pv_inspect.cells import CellTiles
from pv_inspect.common.work import Progress
from pv_inspect.cracks.areas import usual_brightness
from pv_inspect.cracks.blocks import cut_off_blocks
from pv_inspect.cracks.completion import completed
from pv_inspect.cracks.counts import CellCounts, CellState, look_at_first, state_of
from pv_inspect.cracks.features import (
    CellFeatures,
    measure_cell,
)
from pv_inspect.cracks.isolation import busbars_from_image, busbars_from_map
from pv_inspect.cracks.marks import OperatingPoint, crack_marks
from pv_inspect.cracks.network import NetworkDetector
from pv_inspect.cracks.ridge import RidgeDetector
from pv_inspect.cracks.wording import CLASS_RULE
from pv_inspect.settings import Settings

# Contrast is judged against at least this share of the module's usual brightness.
_LEAST_BRIGHTNESS = 0.7

__all__ = [
    "CLASS_RULE",
    "BusbarFinder",
    "CellCounts",
    "CellFeatures",
    "CellState",
    "CrackDetector",
    "CrackMap",
    "LooksKnown",
    "NetworkDetector",
    "Operated",
    "OperatingPoint",
    "RidgeDetector",
    "crack_marks",
    "detector_of",
    "look_at_first",
    "measure_cell",
    "novelty_of",
    "operating_point_of",
    "read_cracks",
    "state_of",
]


class CrackDetector(Protocol):
    """Something that finds cracks in the tile of one cell."""

    @property
    def name(self) -> str:
        """Name for reports, with what it was trained on if that matters."""

    def probability(self, tile: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the crack probability in [0, 1] of every pixel of a tile, (h, w) float32.

        Tiles may have any brightness scale; no pixel is NaN.
        """


@runtime_checkable
class Operated(Protocol):
    """A detector that has an operating point of its own."""

    @property
    def operating_point(self) -> OperatingPoint:
        """From when on its answer counts as a crack."""


@runtime_checkable
class BusbarFinder(Protocol):
    """A detector that sees the busbars as well."""

    def read(self, tile: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return crack probability and busbar probability of every pixel of a tile."""


@runtime_checkable
class LooksKnown(Protocol):
    """A detector that can say how far a cell is from those that it has learnt from."""

    def novelty(self, tile: NDArray[np.float32]) -> float:
        """Return that distance; from 1 on its answer can't be relied on, NaN if it is not known."""


@dataclass(frozen=True, eq=False)
class CrackMap:
    """Where cracks are suspected.

    Parameters
    ----------
    probability : (H, W) float32
        In [0, 1], on the HR grid; 0 outside of the cells.
    threshold : float
        Probability from which a pixel counts as crack in ``cells``.
    detector : str
    cells : tuple of CellFeatures
        Row-major.
    least_extent_cells : float
        Marks that are shorter count as no crack in ``cells``.
    """

    probability: NDArray[np.float32]
    threshold: float
    detector: str
    cells: tuple[CellFeatures, ...]
    least_extent_cells: float = OperatingPoint.least_extent_cells

    @property
    def counts(self) -> CellCounts:
        """How many cells are suspected, clean, dark, or can't be judged."""
        return CellCounts.of(self.cells)


def detector_of(settings: Settings) -> CrackDetector:
    """Return the detector that the settings ask for.

    Raises
    ------
    InspectionError
        If its model is missing or altered.
    """
    return RidgeDetector() if settings.detector == "ridge" else NetworkDetector()


def operating_point_of(detector: CrackDetector, settings: Settings) -> OperatingPoint:
    """Operating point of a detector with the threshold of the settings, if they have one."""
    own = detector.operating_point if isinstance(detector, Operated) else OperatingPoint()
    threshold = settings.crack_threshold
    return own if threshold is None else replace(own, threshold=threshold)


def novelty_of(detector: CrackDetector, tile: NDArray[np.float32]) -> float:
    """How far the look of a cell is from what a detector has learnt; NaN if it does not say."""
    return detector.novelty(tile) if isinstance(detector, LooksKnown) else float("nan")


def read_cracks(
    tiles: CellTiles, settings: Settings, detector: CrackDetector | None = None
) -> Generator[Progress, None, CrackMap]:
    """Look for cracks in every cell.

    Parameters
    ----------
    tiles : CellTiles
    settings : Settings
        ``detector``, ``crack_threshold`` and ``cell_width_mm`` are used.
    detector : CrackDetector, optional
        The one that the settings ask for if not given.

    Yields
    ------
    Progress

    Returns
    -------
    CrackMap

    Raises
    ------
    InspectionError
        If the model of the detector is missing or altered.
    """
    detector = detector if detector is not None else detector_of(settings)
    point = operating_point_of(detector, settings)
    places = tiles.places
    images = [tiles.tile(*place) for place in places]
    usual = usual_brightness(images)
    maps: list[NDArray[np.float32]] = []
    blocks: list[NDArray[np.bool_]] = []
    novelty: list[float] = []
    width = tiles.grid.pixels_per_unit
    count = Counter(image.shape for image in images)
    bars = {size: np.zeros(size, np.float32) for size in count}
    for n, image in enumerate(images, start=1):
        tile = _lifted(image, usual)
        if isinstance(detector, BusbarFinder):
            probability, bar = detector.read(tile)
            bars[tile.shape] += bar / count[tile.shape]
        else:
            probability = detector.probability(tile)
        blocks.append(cut_off_blocks(image))
        maps.append(completed(probability, tile, blocks[-1], point, width))
        novelty.append(novelty_of(detector, tile))
        yield Progress(n / len(images), "looking for cracks")
    # Cells of one size have the same busbars: together they show them better than one by one.
    if isinstance(detector, BusbarFinder):
        busbars = {size: busbars_from_map(mean) for size, mean in bars.items()}
    else:
        busbars = {size: busbars_from_image(mean) for size, mean in tiles.means().items()}
    cells = tuple(
        measure_cell(
            images[k],
            maps[k],
            point.threshold,
            row=row,
            col=col,
            cell_width_px=width,
            usual_intensity=usual,
            busbars=busbars[images[k].shape],
            cell_width_mm=settings.cell_width_mm,
            least_extent_cells=point.least_extent_cells,
            least_length_cells=point.least_length_cells,
            least_score=point.least_score,
            novelty=novelty[k],
            support=tiles.support_of(row, col),
            blocks=blocks[k],
            seen=tiles.seen(row, col),
        )
        for k, (row, col) in enumerate(places)
    )
    return CrackMap(
        tiles.assemble(maps), point.threshold, detector.name, cells, point.least_extent_cells
    )


def _lifted(tile: NDArray[np.float32], usual: float) -> NDArray[np.float32]:
    """Cell with a pedestal that brings a dark one to the brightness of the module.

    Detectors look at contrast relative to the cell's brightness: in a dead cell that would be
    noise divided by almost nothing.
    """
    lift = _LEAST_BRIGHTNESS * usual - float(np.median(tile))
    return tile + np.float32(lift) if lift > 0 else tile
