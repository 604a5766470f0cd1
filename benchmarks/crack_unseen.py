"""Which cells of a scene a network has learnt from: the scenes are mosaics of labelled cells."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.cracks.training.labelled import LabelledCell

Image = NDArray[np.float32]


class Learnt:
    """Cells that a network was trained on, whole and halved, in every orientation.

    Parameters
    ----------
    trained, others : sequence of LabelledCell
        Every cell of a scene must be in one of them.
    """

    def __init__(self, trained: Sequence[LabelledCell], others: Sequence[LabelledCell]) -> None:
        self._n = len(trained)
        cells = [*trained, *others]
        self._cells = len(cells)
        self._whole = np.array([_print_of(view) for c in cells for view in _views(c.image)])
        halves = (half for c in cells for half in _halves(c.image))
        self._half = np.array([_print_of(view) for half in halves for view in _views(half)])

    def holds(self, tile: Image) -> bool:
        """Whether the cell most like the picture of a cell, or of half of one, was trained."""
        h, w = tile.shape
        bank = self._whole if max(h, w) < 1.5 * min(h, w) else self._half
        tile = tile if w >= h else tile.T
        per_cell = len(bank) // self._cells
        return int((bank @ _print_of(tile)).argmax()) // per_cell < self._n


def _halves(image: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    n = len(image) // 2
    return [image[:n], image[n:], image.T[:n], image.T[n:]]


def _views(image: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    turned = [image, image.T] if image.shape[0] == image.shape[1] else [image]
    return [view[::a, ::b] for view in turned for a in (1, -1) for b in (1, -1)]


def _print_of(image: NDArray[np.generic]) -> Image:
    """Fine texture of a picture in few numbers, of norm 1."""
    h, w = image.shape
    size = (64, 32) if w >= 1.5 * h else (48, 48)
    small = np.ascontiguousarray(image, np.float32)
    small = np.asarray(cv2.resize(small, size, interpolation=cv2.INTER_AREA))[3:-3, 3:-3]
    fine = small - cv2.GaussianBlur(small, (0, 0), 6)
    fine = fine - fine.mean()
    return np.asarray(fine / max(float(np.linalg.norm(fine)), 1e-9), np.float32).ravel()
