"""Files that hold several series of pictures: which one is meant, or the question which."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pv_inspect.image_files.problems import ImageFileError

__all__ = ["Series", "chosen_series", "left_out"]

# So many are named in a sentence.
_NAMED = 4
_LONGEST_NAME = 30


@dataclass(frozen=True)
class Series:
    """Pictures of one size and type that belong together.

    Parameters
    ----------
    name : str
        "" if it has none.
    n : int
        Number of pictures.
    shape : tuple of int
        (height, width), px.
    dtype : dtype
    coloured : bool
    """

    name: str
    n: int
    shape: tuple[int, int]
    dtype: np.dtype[Any]
    coloured: bool = False

    def said(self) -> str:
        """What it is, in a few words."""
        colour = "colour" if self.coloured else str(self.dtype)
        return f"{self.n} of {self.shape[1]} x {self.shape[0]} px, {colour}"


def chosen_series(found: Sequence[Series], wanted: str | None) -> int:
    """Return the index of the series that is wanted, or the only one that can be meant.

    A single picture beside a series is a label or an overview, and so are colours beside grey.

    Parameters
    ----------
    found : sequence of Series
    wanted : str, optional
        Name, or number from 1.

    Raises
    ------
    ImageFileError
        If several can be meant, or there is none that is wanted; the sentence names them.
    """
    if wanted is not None:
        for index, series in enumerate(found):
            if wanted in (series.name, str(index + 1)):
                return index
        raise ImageFileError(f"holds no series '{wanted[:_LONGEST_NAME]}' but {_named(found)}.")
    likely = list(range(len(found)))
    likely = [k for k in likely if not found[k].coloured] or likely
    likely = [k for k in likely if found[k].n > 1] or likely
    if len(likely) == 1:
        return likely[0]
    raise ImageFileError(
        f"holds {_named(found)}: choose one by number or name with --series, or Series on the "
        "page Frames."
    )


def left_out(found: Sequence[Series], chosen: int) -> tuple[str, ...]:
    """Say what was left out beside the chosen series, to go on after the file's name."""
    others = [series for k, series in enumerate(found) if k != chosen]
    if not others:
        return ()
    what = "; ".join(
        f"{f'{series.name[:_LONGEST_NAME]}, ' * bool(series.name)}{series.said()}"
        for series in others[:_NAMED]
    )
    more = f" and {len(others) - _NAMED} more" if len(others) > _NAMED else ""
    return (f"holds other pictures as well, which are left out ({what}{more}).",)


def _named(found: Sequence[Series]) -> str:
    parts = []
    for index, series in enumerate(found[:_NAMED]):
        name = f" '{series.name[:_LONGEST_NAME]}'" if series.name else ""
        parts.append(f"{index + 1}{name} ({series.said()})")
    more = f" and {len(found) - _NAMED} more" if len(found) > _NAMED else ""
    return f"{len(found)} series of pictures, {', '.join(parts)}{more}"
