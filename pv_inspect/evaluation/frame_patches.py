"""The surroundings of a cell in one frame, for methods that enlarge frames before rectification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.evaluation.case import Case, Cell

__all__ = ["FramePatch", "UnitScale", "sampled_at", "video_around"]

Image = NDArray[np.float32]
Points = NDArray[np.float64]

# LR pixels around the cell: the receptive field of SRCNN is 8, larger networks want more.
_MARGIN_PX = 12


@dataclass(frozen=True, eq=False)
class UnitScale:
    """An image scaled to 0 to 1 for a network, and the way back.

    Parameters
    ----------
    image : (h, w) float32
        In [0, 1].
    black, white : float
        What became 0 and 1.
    """

    image: Image
    black: float
    white: float

    def back(self, image: Image) -> Image:
        """Return an image of the network on the scale of the frame."""
        return np.asarray(image * (self.white - self.black) + self.black, np.float32)


@dataclass(frozen=True, eq=False)
class FramePatch:
    """A rectangle of a frame that holds a cell.

    Parameters
    ----------
    image : (h, w) float32
        Module's intensity scale.
    corner_px : (x, y)
        Frame pixel of its first pixel.
    target_px : (H, W, 2) float64
        Where the pixels of the cell on the HR grid lie in the frame, LR px.
    white : float
        The 99.9 percentile of the frame, module's intensity scale.
    """

    image: Image
    corner_px: tuple[int, int]
    target_px: Points
    white: float

    @classmethod
    def around(cls, case: Case, cell: Cell, frame: int) -> FramePatch:
        """Cut the surroundings of a cell out of a frame.

        Parameters
        ----------
        case : Case
        cell : (row, col)
        frame : int
        """
        return cls.common(case, cell, [frame])[0]

    @classmethod
    def common(cls, case: Case, cell: Cell, frames: Sequence[int]) -> list[FramePatch]:
        """Cut one rectangle out of several frames, which holds the cell in all of them.

        Parameters
        ----------
        case : Case
        cell : (row, col)
        frames : sequence of int
        """
        registration = case.registration
        rows, cols = case.grid.cell_slices(*cell)
        y, x = np.mgrid[rows, cols].astype(np.float64)
        at = case.grid.to_module(np.stack([x, y], axis=-1))
        targets = [registration.camera.project(registration.homographies[i], at) for i in frames]
        low = np.floor(np.nanmin(targets, axis=(0, 1, 2))).astype(int) - _MARGIN_PX
        high = np.ceil(np.nanmax(targets, axis=(0, 1, 2))).astype(int) + _MARGIN_PX + 1
        height, width = case.sequence.shape
        x0, y0 = (max(int(v), 0) for v in low)
        x1, y1 = min(int(high[0]), width), min(int(high[1]), height)
        patches = []
        for i, target in zip(frames, targets, strict=True):
            whole = case.sequence.frame(i).image
            whole = (whole - registration.offset[i]) / registration.gain[i]
            image = np.ascontiguousarray(whole[y0:y1, x0:x1], np.float32)
            patches.append(cls(image, (x0, y0), target, float(np.percentile(whole, 99.9))))
        return patches

    def scaled_to_unit(self) -> UnitScale:
        """Scale black to 0 and the 99.9 percentile of the frame to 1, with what is beyond cut."""
        white = max(self.white, 1e-6)
        return UnitScale(np.clip(self.image / np.float32(white), 0, 1), 0.0, white)

    def within(self, shape: tuple[int, int]) -> FramePatch:
        """Return the patch mirrored at its ends to at least a shape, for networks that need it."""
        rows, cols = (max(n - have, 0) for n, have in zip(shape, self.image.shape, strict=True))
        padded = cv2.copyMakeBorder(self.image, 0, rows, 0, cols, cv2.BORDER_REFLECT_101)
        return replace(self, image=np.asarray(padded, np.float32))

    def rectified(self, enlarged: Image, scale: int) -> Image:
        """Sample the enlarged patch at the pixels of the cell, by cubic interpolation.

        Parameters
        ----------
        enlarged : (scale * h, scale * w) float32
            Pixel u covers what lies between (u / scale) and ((u + 1) / scale) of a patch pixel.
        scale : int

        Returns
        -------
        (H, W) float32
        """
        inside = self.target_px - np.asarray(self.corner_px, np.float64)
        return sampled_at(enlarged, scale * (inside + 0.5) - 0.5)


def video_around(
    case: Case, cell: Cell, count: int
) -> tuple[FramePatch, NDArray[np.float32], int, UnitScale]:
    """Cut one rectangle with a cell out of several frames in a row, scaled to 0 to 1 for a network.

    Parameters
    ----------
    case : Case
    cell : (row, col)
    count : int
        Frames; all in use if there are no more.

    Returns
    -------
    tuple of FramePatch, (n, h, w) float32, int and UnitScale
        The patch of the frame that shows the cell, all patches, its index among them, and the
        scale of all, which is that of this frame.
    """
    used = [int(i) for i in np.flatnonzero(case.registration.used)]
    own = used.index(case.frame_of(cell))
    begin = max(min(own - count // 2, len(used) - count), 0)
    patches = FramePatch.common(case, cell, used[begin : begin + count])
    index = own - begin
    units = [replace(p, white=patches[index].white).scaled_to_unit() for p in patches]
    return patches[index], np.stack([unit.image for unit in units]), index, units[index]


def sampled_at(image: Image, points: Points) -> Image:
    """Sample an image by cubic interpolation; beyond its ends the last pixels go on.

    Parameters
    ----------
    image : (h, w) float32
    points : (H, W, 2) float64
        Positions (x, y) in it, px.

    Returns
    -------
    (H, W) float32
    """
    at = np.nan_to_num(points, nan=-10.0).astype(np.float32)
    found = cv2.remap(
        image, at[..., 0], at[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(found, np.float32)
