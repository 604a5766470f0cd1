"""Frames with many pixels per cell, reduced for the search of the module.

The gaps between cells are looked for as blurred lines about a pixel wide. In frames of 10 million
pixels they are bands, and discs that close them cost minutes: crossing points are looked for in
frames reduced by a whole factor, where they are as exact as the poses need them; the registration
then works on all pixels.
"""

from __future__ import annotations

import re
from collections.abc import Generator
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.memory import expected_grid

if TYPE_CHECKING:
    from pv_inspect.common.work import Progress
    from pv_inspect.detection.crossings import Crossings, FrameCrossings
    from pv_inspect.geometry.layout import ModuleLayout
    from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["ReducedFrames", "enlarged", "reduction"]

# Cells of simulated frames of 4096 x 3000 px are found at 74, 93 and 123 px, not at 185 and 370.
_CELL_PX = 90.0
_LARGE_SIDE_PX, _LEAST_SIDE_PX = 1000, 400
# Without a layout the size of the frame decides.
_USUAL_SIDE_PX = 600
_PLACE = re.compile(r"\((-?[\d.e+]+), (-?[\d.e+]+)\)")


def reduction(sequence: FrameSequence | ReducedFrames, layout: ModuleLayout | None) -> int:
    """Return the whole factor by which frames are reduced for the search of the module.

    Parameters
    ----------
    sequence : FrameSequence
    layout : ModuleLayout or None
        None if it is not known yet.

    Returns
    -------
    int
        1 for frames of usual size.
    """
    side = min(sequence.shape)
    if isinstance(sequence, ReducedFrames) or side < _LARGE_SIDE_PX:
        return 1
    if layout is None:
        return max(side // _USUAL_SIDE_PX, 1)
    cell = min(
        expected_grid(sequence.frame(sequence.measured[0]).image, layout, 1.0).pixels_per_cell
    )
    return max(min(round(cell / _CELL_PX), side // _LEAST_SIDE_PX), 1)


@dataclass(frozen=True, eq=False)
class ReducedFrames:
    """What the search asks of a sequence, with means of factor x factor pixels as frames."""

    sequence: FrameSequence
    factor: int

    def __getattr__(self, name: str) -> Any:
        return getattr(self.sequence, name)

    def __len__(self) -> int:
        return len(self.sequence)

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of a reduced frame."""
        height, width = self.sequence.shape
        return height // self.factor, width // self.factor

    def frame(self, index: int) -> SimpleNamespace:
        """Return the reduced frame, (height, width) float32 as ``image``."""
        height, width = self.shape
        whole = self.sequence.frame(index).image[: height * self.factor, : width * self.factor]
        image: NDArray[np.float32] = np.asarray(
            cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.float32
        )
        return SimpleNamespace(image=image)

    def as_sequence(self) -> FrameSequence:
        """Return this as what the search expects."""
        return cast("FrameSequence", self)

    def point(self, point: tuple[float, float] | None) -> tuple[float, float] | None:
        """Pixel of a frame to pixel of the reduced frame."""
        if point is None:
            return None
        x, y = ((c + 0.5) / self.factor - 0.5 for c in point)
        return x, y


def enlarged(
    search: Generator[Progress, None, Crossings], factor: int
) -> Generator[Progress, None, Crossings]:
    """Bring what was found in reduced frames to the pixels of the frames.

    Parameters
    ----------
    search : generator
        `detect` on reduced frames.
    factor : int

    Raises
    ------
    InspectionError
        What the search raises, with its places in pixels of the frames.
    """
    try:
        found = yield from search
    except InspectionError as error:
        text = _PLACE.sub(lambda place: _told(place, factor), str(error))
        raise InspectionError(text) from None

    def in_frame(frame: FrameCrossings) -> FrameCrossings:
        return replace(
            frame,
            points_px=factor * (frame.points_px + 0.5) - 0.5,
            sigma_px=factor * frame.sigma_px,
        )

    return replace(found, frames=tuple(in_frame(frame) for frame in found.frames))


def _told(place: re.Match[str], factor: int) -> str:
    x, y = (factor * (float(c) + 0.5) - 0.5 for c in place.groups())
    return f"({x:.0f}, {y:.0f})"
