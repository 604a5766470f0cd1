"""The stages of the method and their order."""

from __future__ import annotations

from enum import StrEnum

__all__ = ["Stage"]


class Stage(StrEnum):
    """The stages of the method in the order in which data flows (paper, Fig. 2)."""

    LOAD = "load"
    DETECT = "detect"
    CALIBRATE = "calibrate"
    REGISTER = "register"
    RECONSTRUCT = "reconstruct"
    CELLS = "cells"
    CRACKS = "cracks"

    @property
    def index(self) -> int:  # type: ignore[override]  # of no use on the name as a string
        """Position in the order of the stages, 0 for the first."""
        return list(Stage).index(self)

    # Stages compare by their order; that of their names means nothing.
    def __lt__(self, other: str) -> bool:
        return self.index < Stage(other).index

    def __le__(self, other: str) -> bool:
        return self.index <= Stage(other).index

    def __gt__(self, other: str) -> bool:
        return self.index > Stage(other).index

    def __ge__(self, other: str) -> bool:
        return self.index >= Stage(other).index
