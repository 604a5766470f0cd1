"""What the frames say against the module image, summed up where the sensor could be to blame.

A pattern of the sensor stays on its pixels while the module moves, so the residuals of all frames
against one module image tell the two apart. Their sums over bands of a column and over the frames
at a pixel are all that `pattern` and `vignetting` look at.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["BAND_ROWS", "COUNT", "ResidualSums", "halves_along"]

Array = NDArray[np.float64]
Image = NDArray[np.float32]

BAND_ROWS = 16
"""Rows of the sensor that are summed up within a column."""
COUNT, LIGHT, LIGHT2, MISFIT, PRODUCT = range(5)
"""Sums of w, w p, w p^2, w r and w p r over pixels with prediction p, residual r, weight w."""


@dataclass(frozen=True, eq=False)
class ResidualSums:
    """Weighted sums over residuals; frames are added one by one.

    Parameters
    ----------
    bands : (n_frames, 5, n_bands, width) float32
        Sums over bands of `BAND_ROWS` rows within one column and one frame.
    pixels : (2, 5, height, width) float32
        Sums over the frames of the first and of the second half.
    """

    bands: Image
    pixels: Image

    @classmethod
    def empty(cls, n_frames: int, shape: tuple[int, int]) -> ResidualSums:
        """Return the sums of no residual at all, for frames of ``shape``."""
        n_bands = -(-shape[0] // BAND_ROWS)
        return cls(
            np.zeros((n_frames, 5, n_bands, shape[1]), np.float32),
            np.zeros((2, 5, *shape), np.float32),
        )

    def add(
        self, index: int, half: bool, predicted: Image, residual: Image, weights: Image
    ) -> None:
        """Add one frame.

        Parameters
        ----------
        index : int
            Which of the frames.
        half : bool
            Whether it belongs to the second half.
        predicted : (height, width) float32
            What the module image says, full scale = 1.
        residual : (height, width) float32
            Frame minus predicted.
        weights : (height, width) float32
            1 / variance; 0 where the frame or the prediction says nothing.
        """
        light, misfit = weights * predicted, weights * residual
        starts = np.arange(0, weights.shape[0], BAND_ROWS)
        for k, term in enumerate((weights, light, light * predicted, misfit, misfit * predicted)):
            self.pixels[int(half), k] += term
            self.bands[index, k] = np.add.reduceat(term, starts, axis=0)

    def of_columns(self, second: NDArray[np.bool_]) -> Array:
        """Return the sums of both halves of the frames over whole columns, (2, 5, width).

        Parameters
        ----------
        second : (n_frames,) bool
            Frames of the second half.
        """
        columns = self.bands.sum(axis=2, dtype=np.float64)
        return np.stack([columns[half].sum(axis=0) for half in (~second, second)])

    def take_out_columns(self, offset: Array, gain: Array) -> None:
        """Take ``offset + gain p`` per column out of the residuals that are summed up.

        In place and frame by frame: of many or large frames the bands take a gigabyte.

        Parameters
        ----------
        offset : (width,) or (n_frames, width) float64
            The offsets of single frames leave the sums over frames as they are.
        gain : (width,) float64
        """
        of_frames = np.broadcast_to(offset, (len(self.bands), self.bands.shape[-1]))
        fixed = offset if offset.ndim == 1 else np.zeros(offset.shape[1])
        parts = [*zip(self.bands, of_frames, strict=True), *((half, fixed) for half in self.pixels)]
        for sums, per_column in parts:
            sums[MISFIT] -= per_column * sums[COUNT] + gain * sums[LIGHT]
            sums[PRODUCT] -= per_column * sums[LIGHT] + gain * sums[LIGHT2]


def halves_along(positions: Array, direction: Array) -> tuple[NDArray[np.bool_], float]:
    """Split frames into two halves that see the module at different places of the sensor.

    Parameters
    ----------
    positions : (n_frames, 2) float64
        Where the module is, LR px.
    direction : (2,) float64
        Unit vector to order them along.

    Returns
    -------
    second : (n_frames,) bool
        Frames of the second half.
    distance : float
        Between the mean positions of the halves, LR px.

    Notes
    -----
    What the sensor does is the same in both halves; what the module image gets wrong of the scene
    lies elsewhere.
    """
    along = positions @ direction
    second = np.zeros(len(along), bool)
    second[np.argsort(along, kind="stable")[len(along) // 2 :]] = True
    if second.all() or not second.any():
        return second, 0.0
    return second, float(along[second].mean() - along[~second].mean())
