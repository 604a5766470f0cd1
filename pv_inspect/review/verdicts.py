"""What an expert says about a cell."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any, NamedTuple

from pv_inspect._version import __version__
from pv_inspect.errors import InspectionError
from pv_inspect.settings import Settings

__all__ = ["Cell", "ModuleData", "Verdict", "VerdictKind", "fingerprint", "now", "of_rater"]

# (row, column) from 0.
Cell = tuple[int, int]
# No module has that many rows or columns.
HIGHEST = 9999
# No current, time or temperature of a module.
_BEYOND_ANY = 1e9


class VerdictKind(StrEnum):
    """The verdicts, the usual reading of cracks in electroluminescence images.

    The value is the name in files. The key is the letter by which a verdict is given, and known
    in pictures, where colour alone would not do.
    """

    OK = "ok"
    CRACK_A = "crack_a"
    CRACK_B = "crack_b"
    CRACK_C = "crack_c"
    INACTIVE = "inactive_area"
    FINGER = "finger_interruption"
    OTHER = "other"
    UNSURE = "unsure"

    @property
    def label(self) -> str:
        """Name for people."""
        return _ABOUT[self].label

    @property
    def key(self) -> str:
        """The letter, in lower case."""
        return _ABOUT[self].key

    @property
    def colour(self) -> str:
        """``#rrggbb`` of the palette of Okabe and Ito, readable with colour-vision deficiency."""
        return _ABOUT[self].colour

    @property
    def meaning(self) -> str:
        """When to give it, in a sentence."""
        return _ABOUT[self].meaning

    @classmethod
    def of_key(cls, key: str) -> VerdictKind | None:
        """Verdict that a key gives, None if it gives none."""
        return next((kind for kind in cls if kind.key == key.lower()), None)


class _About(NamedTuple):
    label: str
    key: str
    colour: str
    meaning: str


_ABOUT = {
    VerdictKind.OK: _About("ok", "k", "#009e73", "Nothing that matters."),
    VerdictKind.CRACK_A: _About(
        "crack A",
        "a",
        "#56b4e9",
        "A fine crack; no area is darker behind it, nothing is cut off electrically.",
    ),
    VerdictKind.CRACK_B: _About(
        "crack B",
        "b",
        "#e69f00",
        "A crack behind which an area is darker but still emits: it is partly cut off.",
    ),
    VerdictKind.CRACK_C: _About(
        "crack C",
        "c",
        "#d55e00",
        "A crack behind which an area is dark: it is cut off from the busbars.",
    ),
    VerdictKind.INACTIVE: _About(
        "inactive area",
        "i",
        "#cc79a7",
        "A dark area, or the whole cell, for another reason than a crack that is seen.",
    ),
    VerdictKind.FINGER: _About(
        "finger interruption",
        "f",
        "#f0e442",
        "Dark stripes along fingers that are interrupted; the wafer is whole.",
    ),
    VerdictKind.OTHER: _About("other", "x", "#0072b2", "Something else; the note says what."),
    VerdictKind.UNSURE: _About("unsure", "u", "#999999", "Looked at, and it can't be told."),
}


def now() -> str:
    """Time, ISO 8601 in UTC, to the millisecond."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def fingerprint(settings: Settings) -> str:
    """Twelve letters that are the same for the same settings only."""
    text = json.dumps(settings.model_dump(mode="json"), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


@dataclass(frozen=True)
class Verdict:
    """What one rater says about one cell.

    Parameters
    ----------
    row, col : int
        Position in the module, from 0.
    kind : VerdictKind
    rater : str
        Name; it must not be empty.
    note : str
    settings : str
        `fingerprint` of the settings that made the image that was judged.
    time : str
        ISO 8601, UTC.
    software : str
        Version of pv-inspect.
    crack_length_cells : float or None
        Length of the cracks after the rater's correction of the mask, cell widths; None if the
        rater has not corrected it.
    isolated_area_share : float or None
        Share of the cell that the corrected cracks would cut off; None also if no busbars are
        known.

    Raises
    ------
    InspectionError
        If the position is negative or beyond any module, or the rater has no name.
    """

    row: int
    col: int
    kind: VerdictKind
    rater: str
    note: str = ""
    settings: str = ""
    time: str = field(default_factory=now)
    software: str = __version__
    crack_length_cells: float | None = None
    isolated_area_share: float | None = None

    def __post_init__(self) -> None:
        check_entry((self.row, self.col), self.rater)

    @property
    def cell(self) -> Cell:
        """(row, column) from 0."""
        return self.row, self.col


def check_entry(cell: Cell, rater: str) -> None:
    """Refuse what can't be an entry of a review.

    Raises
    ------
    InspectionError
        If the position is negative or the rater has no name.
    """
    if not rater.strip():
        raise InspectionError(
            "A verdict has no rater: give your name, so that two raters can be told apart."
        )
    if min(cell) < 0 or max(cell) > HIGHEST:
        raise InspectionError(
            f"There is no cell in row {cell[0]}, column {cell[1]}: both are counted from 0, and "
            f"end at {HIGHEST}."
        )


def of_rater(verdicts: Iterable[Verdict], rater: str) -> dict[Cell, Verdict]:
    """Verdicts of one rater by cell."""
    return {verdict.cell: verdict for verdict in verdicts if verdict.rater == rater}


@dataclass(frozen=True)
class ModuleData:
    """What a person knows about the module and its exposure; None or "" where it is not known.

    Parameters
    ----------
    serial_number : str
    current_a : float or None
        Current while the frames were taken, A.
    exposure_s : float or None
        Exposure time of a frame, s.
    temperature_c : float or None
        Temperature of the module, degrees Celsius.

    Raises
    ------
    InspectionError
        If a number is not finite, or one that has to be positive is not.
    """

    serial_number: str = ""
    current_a: float | None = None
    exposure_s: float | None = None
    temperature_c: float | None = None

    def __post_init__(self) -> None:
        least = {"current_a": 0.0, "exposure_s": 0.0, "temperature_c": -273.15}
        for name, low in least.items():
            value = getattr(self, name)
            # A huge whole number can't be asked whether it is finite.
            if value is not None and not low < value < _BEYOND_ANY:
                shown = str(value)[:20]
                raise InspectionError(f"{name} is {shown}: give a number above {low:g}.")

    @classmethod
    def from_mapping(cls, values: Mapping[str, object]) -> ModuleData:
        """Read what was stored; entries that this version does not know are left out.

        Raises
        ------
        TypeError
            If a value is of another type.
        InspectionError
            See the class.
        """
        known: dict[str, Any] = {k: v for k, v in values.items() if k in cls.__dataclass_fields__}
        for name, value in known.items():
            kinds = (str,) if name == "serial_number" else (int, float, type(None))
            if not isinstance(value, kinds) or isinstance(value, bool):
                raise TypeError(f"{name} is {str(value)[:40]!r}")
        return cls(**known)
