"""Crossing points as a person corrected them, over those that were detected. No Qt, no napari."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from pv_inspect.detection.crossings import Crossings

__all__ = ["Place", "Point", "PointEdits"]

Place = tuple[int, int, int]
"""(frame, row, col) of a crossing."""
Point = tuple[float, float]
"""(x, y) in LR px."""


@dataclass(frozen=True)
class PointEdits:
    """All corrections of one sequence.

    Attributes
    ----------
    points : mapping
        Where a point was put; None where it was deleted, so that the fit predicts it.
    """

    points: Mapping[Place, Point | None] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.points)

    def changed(self, changes: Mapping[Place, Point | None]) -> PointEdits:
        """Return the corrections with some more."""
        return PointEdits({**self.points, **changes})

    def count(self, frame: int) -> int:
        """How many crossings of a frame are corrected."""
        return sum(place[0] == frame for place in self.points)

    def frames_that_differ(self, other: PointEdits) -> list[int]:
        """Frames in which two sets of corrections are not the same."""
        places = self.points.keys() | other.points.keys()
        missing = object()
        return sorted(
            {p[0] for p in places if self.points.get(p, missing) != other.points.get(p, missing)}
        )

    def apply(self, detected: Crossings) -> Crossings:
        """Put the corrections into detected points; frames without any stay the same objects."""
        if not self.points:
            return detected
        width = detected.layout.cols + 1
        frames = list(detected.frames)
        for i in {place[0] for place in self.points}:
            own = {
                row * width + col: point
                for (frame, row, col), point in self.points.items()
                if frame == i
            }
            frames[i] = frames[i].with_edits(own)
        return replace(detected, frames=tuple(frames))
