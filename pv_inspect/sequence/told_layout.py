"""The layout of the module as the settings and ``module.json`` tell it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pv_inspect.common.gap_text import NO_GAPS, CellSizes, WideGaps, gaps_from, sizes_from
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.settings import Settings

__all__ = ["says_gaps", "says_sizes", "told_layout"]

_SHAPE = ("rows", "cols", "cell_aspect")
_GAPS = ("row_gaps", "col_gaps", "cell_gap")
_SIZES = ("row_heights", "col_widths")


def told_layout(hint: Mapping[str, Any], settings: Settings, source: Path) -> ModuleLayout:
    """Return the module's layout; settings win over ``module.json``.

    Parameters
    ----------
    hint : mapping
        What ``module.json`` says.
    settings : Settings
    source : Path
        Where the frames come from, for messages.

    Raises
    ------
    InspectionError
        If neither says how many rows and columns of cells the module has.
    """
    known = _known((*_SHAPE, *_GAPS, *_SIZES), hint, settings)
    missing = [key for key in ("rows", "cols") if key not in known]
    if missing:
        raise InspectionError(
            f"The number of {' and '.join(missing)} of cells is unknown for {source}: "
            f"give {' and '.join('--' + key for key in missing)}, or put a module.json with "
            "rows and cols beside the frames."
        )
    gap = float(known.get("cell_gap", 0.0))
    mm = settings.cell_width_mm
    return ModuleLayout(
        known["rows"],
        known["cols"],
        float(known.get("cell_aspect", 1.0)),
        _pairs(gaps_from, "row_gaps", known, mm),
        _pairs(gaps_from, "col_gaps", known, mm),
        (gap, gap),
        _pairs(sizes_from, "row_heights", known, mm),
        _pairs(sizes_from, "col_widths", known, mm),
    )


def says_gaps(hint: Mapping[str, Any], settings: Settings) -> bool:
    """Whether it is said which gaps are wide, or that none is."""
    return bool(_known(_GAPS, hint, settings))


def says_sizes(hint: Mapping[str, Any], settings: Settings) -> bool:
    """Whether rows or columns are named whose cells are unlike the others."""
    return any(sizes_from(text, 1.0) for text in _known(_SIZES, hint, settings).values())


def _known(keys: tuple[str, ...], hint: Mapping[str, Any], settings: Settings) -> dict[str, Any]:
    told = {key: hint[key] for key in keys if key in hint}
    set_here = {key: getattr(settings, key) for key in keys}
    return told | {key: value for key, value in set_here.items() if value is not None}


def _pairs(
    read: Callable[[str, float | None], WideGaps | CellSizes],
    key: str,
    known: dict[str, Any],
    cell_width_mm: float | None,
) -> WideGaps | CellSizes:
    try:
        return read(str(known.get(key, NO_GAPS)), cell_width_mm)
    except ValueError as error:
        raise InspectionError(f"{key}: {error}.") from None
