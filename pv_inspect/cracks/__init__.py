"""Cell tiles in, crack probability and features per cell out.

What finds the cracks is exchangeable: anything with the two members of `CrackDetector` will do.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pv_inspect.cells import CellTiles
from pv_inspect.cracks.features import CellFeatures, crack_marks, measure_cell
from pv_inspect.cracks.ridge import RidgeDetector
from pv_inspect.settings import Settings

# Contrast is judged against at least this share of the module's usual brightness.
_LEAST_BRIGHTNESS = 0.7

__all__ = [
    "CellFeatures",
    "CrackDetector",
    "CrackMap",
    "RidgeDetector",
    "crack_marks",
    "read_cracks",
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
    """

    probability: NDArray[np.float32]
    threshold: float
    detector: str
    cells: tuple[CellFeatures, ...]


def read_cracks(
    tiles: CellTiles, settings: Settings, detector: CrackDetector | None = None
) -> Generator[float, None, CrackMap]:
    """Look for cracks in every cell.

    Parameters
    ----------
    tiles : CellTiles
    settings : Settings
        ``crack_threshold`` is used.
    detector : CrackDetector, optional
        `RidgeDetector` if not given.

    Yields
    ------
    float
        Fraction done.

    Returns
    -------
    CrackMap
    """
    detector = detector if detector is not None else RidgeDetector()
    images = tiles.images
    rows, cols = images.shape[:2]
    usual = float(np.median(images))
    maps = np.zeros_like(images, dtype=np.float32)
    cells = []
    for row, col in np.ndindex(rows, cols):
        tile = images[row, col]
        maps[row, col] = np.clip(detector.probability(_lifted(tile, usual)), 0.0, 1.0)
        cells.append(
            measure_cell(
                tile,
                maps[row, col],
                settings.crack_threshold,
                row=row,
                col=col,
                cell_width_px=tiles.grid.pixels_per_unit,
                usual_intensity=usual,
            )
        )
        yield len(cells) / (rows * cols)
    return CrackMap(tiles.assemble(maps), settings.crack_threshold, detector.name, tuple(cells))


def _lifted(tile: NDArray[np.float32], usual: float) -> NDArray[np.float32]:
    """Cell with a pedestal that brings a dark one to the brightness of the module.

    Detectors look at contrast relative to the cell's brightness: in a dead cell that would be
    noise divided by almost nothing.
    """
    lift = _LEAST_BRIGHTNESS * usual - float(np.median(tile))
    return tile + np.float32(lift) if lift > 0 else tile
