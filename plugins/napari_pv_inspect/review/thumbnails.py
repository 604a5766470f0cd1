"""Small pictures of the cells for the gallery, in one contrast for all, with their marks. No Qt."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from napari_pv_inspect.appearance import CORRECTED_RGB, CRACK_RGB, contrast_limits
from napari_pv_inspect.review.subject import Mask, Subject
from pv_inspect.review import Cell

__all__ = ["Thumbnails"]

Image = NDArray[np.float32]


class Thumbnails:
    """Pictures of the cells of a module, each made when it is looked at.

    One contrast and one scale for the whole module: a dark cell has to look dark beside the others,
    a narrow one narrow.

    Parameters
    ----------
    subject : Subject
    longest : int
        Longest side of all pictures, pixels.
    """

    def __init__(self, subject: Subject, longest: int) -> None:
        self._subject = subject
        scale = longest / max(max(subject.tiles.shape(*cell)) for cell in subject.places)
        self._scale = scale
        # What falls together leaves its maximum: a crack must not fade away.
        self._reach = int(np.ceil(1 / scale)) | 1
        self._limits = contrast_limits(subject.tiles.pixels)
        self._known: dict[Cell, tuple[Image, Image]] = {}

    def picture(
        self, cell: Cell, threshold: float, opacity: float, mask: Mask | None = None
    ) -> NDArray[np.uint8]:
        """Paint a cell, (height, width, 3).

        Parameters
        ----------
        cell : (row, col)
        threshold : float
            Probability from which pixels are painted.
        opacity : float
            Of the paint, 0 to 1.
        mask : (h, w) bool, optional
            Corrected marks, painted instead in the colour of edited things.
        """
        grey, probability = self._small(cell)
        if mask is not None and mask.shape == self._subject.tiles.shape(*cell):
            painted, rgb = self._peaks(mask.astype(np.float32)) > 0, CORRECTED_RGB
        else:
            painted, rgb = probability >= threshold, CRACK_RGB
        picture = np.repeat(grey[..., None], 3, axis=-1)
        colour = np.array(rgb, dtype=np.float32)
        picture[painted] = (1 - opacity) * picture[painted] + opacity * colour
        return np.asarray(np.round(picture * 255), dtype=np.uint8)

    def _small(self, cell: Cell) -> tuple[Image, Image]:
        if cell not in self._known:
            low, high = self._limits
            tile = self._subject.tiles.tile(*cell)
            shrunk = cv2.resize(tile, self._size(tile), interpolation=cv2.INTER_AREA)
            grey = np.clip((np.nan_to_num(shrunk) - low) / (high - low), 0.0, 1.0)
            probability = self._subject.probability(cell)
            peaks = self._peaks(probability) if probability is not None else grey * 0 - 1
            self._known[cell] = np.asarray(grey, np.float32), np.asarray(peaks, np.float32)
        return self._known[cell]

    def _peaks(self, values: Image) -> Image:
        kernel = np.ones((self._reach, self._reach), np.uint8)
        highest = cv2.dilate(np.ascontiguousarray(values), kernel)
        return np.asarray(cv2.resize(highest, self._size(values), interpolation=cv2.INTER_NEAREST))

    def _size(self, values: Image) -> tuple[int, int]:
        height, width = values.shape
        return max(round(width * self._scale), 1), max(round(height * self._scale), 1)
