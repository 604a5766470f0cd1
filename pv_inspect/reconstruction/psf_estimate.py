"""How wide the optical blur is, how well that is known, and from what."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["PsfEstimate", "PsfEvidence", "PsfShape"]

PsfEvidence = Literal["borders", "borders and pixels", "pixels", "typical", "given"]
PsfShape = Literal["gaussian", "disc", "unknown"]


@dataclass(frozen=True)
class PsfEstimate:
    """Optical blur with its uncertainty.

    Parameters
    ----------
    sigma : float
        Standard deviation per axis, LR px.
    error : float
        One standard deviation of sigma, LR px; 0 for one that was given.
    evidence : {"borders", "borders and pixels", "pixels", "typical", "given"}
        What says so: borders of cells, held-out pixels, both; what lenses in focus have, for the
        frames leave it open; the user.
    shape : {"gaussian", "disc", "unknown"}
        What the borders say of the shape. The observation model is Gaussian.
    """

    sigma: float
    error: float
    evidence: PsfEvidence
    shape: PsfShape = "unknown"

    @property
    def words(self) -> str:
        """How well it is known and from what, to follow the number."""
        where = {
            "borders": "from the borders of the cells",
            "borders and pixels": "from the borders of the cells and held-out pixels",
            "pixels": "from held-out pixels, for the borders of the cells can't be read",
        }
        if self.evidence == "given":
            return ", given"
        if self.evidence == "typical":
            return ", what is usual: the frames don't tell it"
        return f", \u00b1 {self.error:.2f}, {where[self.evidence]}"
