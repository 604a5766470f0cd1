"""Verdicts as a table: one row per cell, all raters beside each other."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pv_inspect.common.csv_tables import csv_text
from pv_inspect.cracks import CellFeatures
from pv_inspect.cracks.features import FEATURES, texts
from pv_inspect.review.verdicts import Cell, Verdict

__all__ = ["DISAGREED", "agreed", "raters_of", "verdicts_csv"]

DISAGREED = "disagreed"
# Columns of each rater, with what they hold.
_OF_RATER: dict[str, Callable[[Verdict], str]] = {
    "verdict": lambda v: v.kind.value,
    "note": lambda v: v.note,
    "time": lambda v: v.time,
    "settings": lambda v: v.settings,
    "software": lambda v: v.software,
    "corrected_crack_length_cells": lambda v: _number(v.crack_length_cells),
    "corrected_isolated_area_share": lambda v: _number(v.isolated_area_share),
}


def raters_of(verdicts: Sequence[Verdict]) -> tuple[str, ...]:
    """Names of the raters, in alphabetical order."""
    return tuple(sorted({verdict.rater for verdict in verdicts}))


def agreed(verdicts: Sequence[Verdict]) -> dict[Cell, str]:
    """Verdict of each judged cell if all who judged it agree, else `DISAGREED`."""
    found: dict[Cell, str] = {}
    for verdict in verdicts:
        said = found.setdefault(verdict.cell, verdict.kind.value)
        if said != verdict.kind.value:
            found[verdict.cell] = DISAGREED
    return found


def verdicts_csv(cells: Sequence[CellFeatures], verdicts: Sequence[Verdict]) -> str:
    """Write the table of verdicts.

    Parameters
    ----------
    cells : sequence of CellFeatures
        One row each, in the order given.
    verdicts : sequence of Verdict
        The current ones of all raters.

    Returns
    -------
    str
        CSV: row and column from 1, the verdict that all agree on, for each rater ``verdict
        (NAME)``, ``note (NAME)`` and so on, then the features as in ``cells.csv``.
    """
    raters = raters_of(verdicts)
    given = {(verdict.cell, verdict.rater): verdict for verdict in verdicts}
    common = agreed(verdicts)
    columns = [f"{name} ({rater})" for rater in raters for name in _OF_RATER]
    rows: list[list[object]] = [["row", "col", "verdict", *columns, *FEATURES, "crack_class"]]
    for cell in cells:
        at = cell.row, cell.col
        found = [given.get((at, rater)) for rater in raters]
        said = ["" if v is None else value(v) for v in found for value in _OF_RATER.values()]
        rows.append(
            [cell.row + 1, cell.col + 1, common.get(at, ""), *said, *texts(cell), cell.crack_class]
        )
    return csv_text(rows)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"
