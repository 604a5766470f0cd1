"""A picture of one cell, and what it was made with. No Qt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pv_inspect.settings import Settings

__all__ = ["Cell", "CellPicture", "Image"]

Image = NDArray[np.float32]
Cell = tuple[int, int]


@dataclass(frozen=True, eq=False)
class CellPicture:
    """A picture of a cell with its caption and the settings that it was made with.

    Attributes
    ----------
    image : (height, width) float32
        Without margin, full scale = 1.
    cell : (row, col)
    caption : str
        What was used, for a person.
    settings : Settings or None
        None: not reconstructed for these settings (bicubic).
    finished : bool
        False: an early picture that will be replaced.
    """

    image: Image
    cell: Cell
    caption: str
    settings: Settings | None = None
    finished: bool = True
