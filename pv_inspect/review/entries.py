"""Lines of the history of a review, and undo and redo on it.

Every line holds the whole state of one cell for one rater from then on. An undo or redo is a line
as well, so that nothing is ever lost.
"""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pv_inspect.errors import InspectionError
from pv_inspect.review.checking import MOST_ENTRIES
from pv_inspect.review.verdicts import Cell, Verdict, VerdictKind, now

__all__ = [
    "CONTENT",
    "LINE",
    "Change",
    "Entry",
    "append",
    "entry_from",
    "inserted",
    "latest",
    "stacks",
    "stepped",
]

CONTENT = (
    "kind",
    "note",
    "time",
    "settings",
    "software",
    "crack_length_cells",
    "isolated_area_share",
    "mask",
)
_TEXTS = ("kind", "note", "time", "settings", "software")
# What `entry_from` reads.
LINE = f'id, action, stored, rater, "row", col, {", ".join(CONTENT)}'


@dataclass(frozen=True)
class Entry:
    """One line of the history.

    Parameters
    ----------
    number : int
        Grows with time.
    action : str
        ``edit``, ``undo`` or ``redo``.
    stored : str
        ISO 8601, UTC.
    rater : str
    cell : (int, int)
        (row, column) from 0.
    verdict : Verdict or None
        The verdict from then on; None if there is none.
    corrected : bool
        Whether there is a corrected crack mask from then on.
    note : str
        Note that waits for a verdict from then on.
    """

    number: int
    action: str
    stored: str
    rater: str
    cell: Cell
    verdict: Verdict | None
    corrected: bool
    note: str = ""


@dataclass(frozen=True)
class Change:
    """What an undo or redo has changed.

    Parameters
    ----------
    cell : (int, int)
        (row, column) from 0.
    verdict : Verdict or None
        The verdict that holds now.
    mask_changed : bool
        Whether the corrected crack mask is another one now.
    superseded : bool
        Nothing was changed: what the edit said had been replaced by something newer.
    note : str
        Note that waits for a verdict now.
    """

    cell: Cell
    verdict: Verdict | None
    mask_changed: bool
    superseded: bool = False
    note: str = ""


def entry_from(line: tuple[Any, ...]) -> Entry:
    """Read a line, the columns of `LINE`.

    Raises
    ------
    ValueError, TypeError
        If it is damaged.
    """
    number, action, stored, rater, row, col, *rest = line
    content = dict(zip(CONTENT, rest, strict=True))
    # Another program may have written since the file was checked as a whole.
    texts = (action, stored, rater, *(content[name] or "" for name in _TEXTS))
    numbers = (content["crack_length_cells"] or 0.0, content["isolated_area_share"] or 0.0)
    if not (
        all(isinstance(value, str) for value in texts)
        and all(isinstance(value, int | float) and math.isfinite(value) for value in numbers)
        and all(isinstance(value, int) for value in (number, row, col))
    ):
        raise TypeError(f"entry {number} of the history has values of another type")
    corrected = content.pop("mask") is not None
    kind = content.pop("kind")
    if kind is None:
        note = content["note"] or ""
        return Entry(number, action, stored, rater, (row, col), None, corrected, note)
    verdict = Verdict(row, col, VerdictKind(kind), rater, **content)
    return Entry(number, action, stored, rater, (row, col), verdict, corrected)


def latest(
    connection: sqlite3.Connection, rater: str, cell: Cell, last: int | None = None
) -> dict[str, object]:
    """State of a cell for a rater, as it was when the entry ``last`` was the latest."""
    found = connection.execute(
        f'SELECT {", ".join(CONTENT)} FROM history WHERE rater = ?1 AND "row" = ?2 '
        "AND col = ?3 AND (?4 IS NULL OR id <= ?4) ORDER BY id DESC LIMIT 1",
        (rater, *cell, last),
    ).fetchone()
    return dict(zip(CONTENT, found or [None] * len(CONTENT), strict=True))


def append(
    connection: sqlite3.Connection,
    action: str,
    edit: int | None,
    rater: str,
    cell: Cell,
    content: dict[str, object],
) -> int:
    """Add a line and return its number; ``edit`` is the line that an undo or redo is about."""
    values: dict[str, object] = {"action": action, "edit": edit, "stored": now(), "rater": rater}
    values |= {"row": cell[0], "col": cell[1]} | {name: content[name] for name in CONTENT}
    return inserted(connection, "history", values)


def inserted(
    connection: sqlite3.Connection,
    table: str,
    values: Mapping[str, object],
    replace: bool = False,
) -> int:
    """Add a line to a table, read it back and return its number.

    Numbers that are not finite are stored as unknown. With ``replace`` an earlier line with the
    same key goes, and the new one is the last of the table all the same.

    Raises
    ------
    InspectionError
        If what is there is not what was given, or the table is full.
    """
    given = {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in values.items()
    }
    names, marks = ", ".join(f'"{name}"' for name in given), ", ".join("?" * len(given))
    verb = "INSERT OR REPLACE" if replace else "INSERT"
    added = connection.execute(
        f"{verb} INTO {table} ({names}) VALUES ({marks})", tuple(given.values())
    )
    number = added.lastrowid or 0
    found = connection.execute(f"SELECT {names} FROM {table} WHERE rowid = ?", (number,)).fetchone()
    if found != tuple(given.values()):
        raise InspectionError(
            "The database of the review did not keep what was to be stored: nothing was stored; "
            "move the file elsewhere and begin a new one."
        )
    if number > MOST_ENTRIES:
        raise InspectionError(
            f"A review has at most {MOST_ENTRIES} entries: save the result into another folder "
            "and go on there (all that was stored before is safe)."
        )
    return number


def stepped(
    connection: sqlite3.Connection, action: str, edit: int, rater: str, cell: Cell
) -> dict[str, object] | None:
    """State of a cell once an edit is taken back or brought back; None if it is superseded.

    Only what the edit changed goes back, and only while nothing newer was said about it.
    """
    made, before = (latest(connection, rater, cell, last) for last in (edit, edit - 1))
    old, new = (made, before) if action == "undo" else (before, made)
    current = latest(connection, rater, cell)
    changed = [name for name in CONTENT if made[name] != before[name]]
    if any(current[name] != old[name] for name in changed):
        return None
    return current | {name: new[name] for name in changed}


def stacks(connection: sqlite3.Connection, rater: str) -> tuple[list[int], list[int]]:
    """Numbers of the edits of a rater that can be undone, and of those that can be redone."""
    # Sets that keep their order.
    done: dict[int, None] = {}
    undone: dict[int, None] = {}
    for number, action, edit in connection.execute(
        "SELECT id, action, edit FROM history WHERE rater = ? ORDER BY id", (rater,)
    ):
        # Not always the last one: the same rater may work in two windows.
        if action == "undo":
            done.pop(edit, None)
            undone.pop(edit, None)
            undone[edit] = None
        elif action == "redo":
            undone.pop(edit, None)
            done.pop(edit, None)
            done[edit] = None
        else:
            done[number] = None
            undone.clear()
    return list(done), list(undone)
