"""Where the frames contradict the module image: the residual in units of the noise."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.geometry.grid import HrGrid

__all__ = ["Consistency"]

Array = NDArray[np.float64]
Image = NDArray[np.float32]

# A pixel of a passing insect says "contradiction"; it shall not outshout all frames around it.
_LIMIT = 10.0
_SMOOTHING_LR_PX = 0.7


class Consistency:
    """Gathers residuals of LR pixels on the module plane, frame by frame.

    The map is gathered in bins of one LR pixel: the memory does not depend on the frames.

    Parameters
    ----------
    grid : HrGrid
        Grid of the module image.
    """

    def __init__(self, grid: HrGrid) -> None:
        self._grid = grid
        self._side = max(grid.magnification, 1.0)
        height, width = grid.shape
        self._shape = (int(np.ceil(height / self._side)), int(np.ceil(width / self._side)))
        self._squares = np.zeros(self._shape)
        self._count = np.zeros(self._shape)

    def add(self, positions: Array, residual: Image, used: NDArray[np.bool_]) -> float:
        """Take in one frame.

        Parameters
        ----------
        positions : (height, width, 2) float64
            Where the LR pixels lie, HR pixel coordinates (x, y); NaN outside.
        residual : (height, width) float32
            (g - W f) / sigma.
        used : (height, width) bool
            Pixels that count.

        Returns
        -------
        float
            Robust rms of the frame's residual, 1 if model and noise are right; NaN if no pixel
            counts.
        """
        use = used & np.isfinite(positions).all(axis=-1)
        place = np.floor((positions[use] + 0.5) / self._side).astype(np.int64)
        square = np.minimum(np.square(residual[use], dtype=np.float64), _LIMIT**2)
        inside = ((place >= 0) & (place < self._shape[::-1])).all(axis=-1)
        index = place[inside, 1] * self._shape[1] + place[inside, 0]
        size = self._squares.size
        self._squares += np.bincount(index, square[inside], size).reshape(self._shape)
        self._count += np.bincount(index, minlength=size).reshape(self._shape)
        if not inside.any():
            return float("nan")
        # The median of chi^2 with one degree of freedom is 0.4549.
        return float(np.sqrt(np.median(square[inside]) / 0.4549))

    def map(self) -> Image:
        """Return the rms of the residuals around every HR pixel, in units of the noise.

        Returns
        -------
        (height, width) float32
            About 1 where the frames agree with the image; 0 where no frame looks.
        """
        sigma = _SMOOTHING_LR_PX
        squares, count = (
            cv2.GaussianBlur(a, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
            for a in (self._squares, self._count)
        )
        mean = np.divide(squares, count, out=np.zeros_like(squares), where=count > 1e-3)
        height, width = self._grid.shape
        # Centre of bin k: HR pixel (k + 1/2) side - 1/2.
        transform = np.array([[1 / self._side, 0, 0.0], [0, 1 / self._side, 0.0]])
        transform[:, 2] = 0.5 / self._side - 0.5
        enlarged = cv2.warpAffine(
            np.sqrt(mean).astype(np.float32),
            transform,
            (width, height),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        )
        return np.asarray(enlarged, np.float32)
