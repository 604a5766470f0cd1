"""Takes one review over into another: nothing that is said there already is replaced."""

from __future__ import annotations

import sqlite3
from dataclasses import dataclass, field
from typing import Any

from pv_inspect.review.entries import CONTENT, inserted
from pv_inspect.review.verdicts import Cell

__all__ = ["Contents", "contents", "merge"]

_COLUMNS = ("action", "edit", "stored", "rater", "row", "col", *CONTENT)
_EDIT, _RATER, _CELL = 1, 3, slice(4, 6)
_MASK = _COLUMNS.index("mask")
_SAID = slice(_COLUMNS.index("kind"), _COLUMNS.index("note") + 1)

_Line = tuple[Any, ...]
# Who says something about which cell.
_Place = tuple[str, Cell]


@dataclass(frozen=True)
class Contents:
    """All that a database holds.

    Parameters
    ----------
    lines : tuple of (id, columns)
        The history, the oldest first.
    masks : dict of id to PNG
    module_data : tuple of (stored, data)
        The oldest first.
    states : tuple of (rater, stored, row, col)
    """

    lines: tuple[tuple[int, _Line], ...] = ()
    masks: dict[int, bytes] = field(default_factory=dict)
    module_data: tuple[_Line, ...] = ()
    states: tuple[_Line, ...] = ()

    @property
    def said(self) -> dict[_Place, tuple[Any, ...]]:
        """Verdict, note and mask that hold, by rater and cell, where there is any of them."""
        found = {}
        for _, line in self.lines:
            mask = None if line[_MASK] is None else self.masks[line[_MASK]]
            found[_place(line)] = (*line[_SAID], mask)
        return {place: said for place, said in found.items() if any(said)}


def contents(connection: sqlite3.Connection) -> Contents:
    """Read all that a database holds; inside of a transaction.

    Lines of a damaged history that refer to something missing are left out.
    """
    masks = dict(connection.execute("SELECT id, png FROM masks").fetchall())
    lines: dict[int, _Line] = {}
    names = ", ".join(f'"{name}"' for name in _COLUMNS)
    query = f"SELECT id, {names} FROM history ORDER BY id"
    for number, *values in connection.execute(query):
        if (values[_MASK] is None or values[_MASK] in masks) and (
            values[_EDIT] is None or values[_EDIT] in lines
        ):
            lines[int(number)] = tuple(values)
    return Contents(
        tuple(lines.items()),
        masks,
        tuple(connection.execute("SELECT stored, data FROM module_data ORDER BY id")),
        tuple(connection.execute('SELECT rater, stored, "row", col FROM state ORDER BY rowid')),
    )


def merge(connection: sqlite3.Connection, other: Contents) -> tuple[_Place, ...]:
    """Add what another database holds; inside of a transaction.

    Parameters
    ----------
    connection : sqlite3.Connection
        What it says about a cell for a rater stays; so do its module data, if there are any.
    other : Contents

    Returns
    -------
    tuple of (rater, cell)
        Where both say something, and not the same.
    """
    here = contents(connection)
    known, news = here.said, other.said
    begun = {_place(line) for _, line in here.lines}
    numbers, masks = dict[int, int](), dict[int, int]()
    for number, line in other.lines:
        place = _place(line)
        # What was said here and taken back again gives way.
        if place in known or (place in begun and place not in news):
            continue
        values = list(line)
        if (mask := line[_MASK]) is not None:
            if mask not in masks:
                masks[mask] = inserted(connection, "masks", {"png": other.masks[mask]})
            values[_MASK] = masks[mask]
        values[_EDIT] = None if line[_EDIT] is None else numbers[line[_EDIT]]
        added = dict(zip(_COLUMNS, values, strict=True))
        numbers[number] = inserted(connection, "history", added)
    if not here.module_data:
        for stored, data in other.module_data:
            inserted(connection, "module_data", {"stored": stored, "data": data})
    known_raters = {state[0] for state in here.states}
    for rater, stored, row, col in other.states:
        if rater not in known_raters:
            values_of = {"rater": rater, "stored": stored, "row": row, "col": col}
            inserted(connection, "state", values_of)
    return tuple(place for place, said in news.items() if known.get(place, said) != said)


def _place(line: _Line) -> _Place:
    row, col = line[_CELL]
    return str(line[_RATER]), (int(row), int(col))
