"""How wide the optical blur is, how well that is known, and from what."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["PsfEstimate", "PsfMeasurements", "PsfShape"]


PsfShape = Literal["gaussian", "disc", "unknown"]

_SOURCES = {
    "borders": "the borders of the cells",
    "pixels": "held-out pixels",
    "camera profile": "the camera profile",
}


@dataclass(frozen=True)
class PsfMeasurements:
    """What one sequence shows of the blur, before anything is assumed of its scene.

    Parameters
    ----------
    borders : (float, float) or None
        Width of the borders of cells, softness of the scene included, and its standard deviation,
        LR px.
    pixels : float or None
        Sigma that predicts held-out pixels best, LR px.
    """

    borders: tuple[float, float] | None = None
    pixels: float | None = None


@dataclass(frozen=True)
class PsfEstimate:
    """Optical blur with its uncertainty.

    Parameters
    ----------
    sigma : float
        Standard deviation per axis, LR px.
    error : float
        One standard deviation of sigma, LR px; 0 for one that was given.
    evidence : str
        What says so: "borders" of cells, held-out "pixels" or another `Evidence`, joined by " and "
        if there are several; "typical", what lenses in focus have, where the frames leave it open;
        "given" by the user.
    shape : {"gaussian", "disc", "unknown"}
        What the borders say of the shape. The observation model is Gaussian.
    measured : PsfMeasurements or None
        What it was made of; None if that is not known.
    """

    sigma: float
    error: float
    evidence: str
    shape: PsfShape = "unknown"
    measured: PsfMeasurements | None = None

    @property
    def words(self) -> str:
        """How well it is known and from what, to follow the number."""
        if self.evidence == "given":
            return ", given"
        if self.evidence == "typical":
            return f", \u00b1 {self.error:.2f}, what is usual: the frames don't tell it"
        sources = (_SOURCES.get(name, name) for name in self.evidence.split(" and "))
        return f", \u00b1 {self.error:.2f}, from {' and '.join(sources)}"
