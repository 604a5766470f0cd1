"""Lines of the history of a review, and undo and redo on it.

Every line holds the whole state of one cell for one rater from then on. An undo or redo is a line
as well, so that nothing is ever lost.
"""

from __future__ import annotations

import sqlite3
from dataclasses import dataclass
from typing import Any

from pv_inspect.review.verdicts import Cell, Verdict, VerdictKind, now

__all__ = [
    "CONTENT",
    "LINE",
    "Change",
    "Entry",
    "append",
    "entry_from",
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
    names = ("action", "edit", "stored", "rater", '"row"', "col", *CONTENT)
    values = (action, edit, now(), rater, *cell, *(content[name] for name in CONTENT))
    marks = ", ".join("?" * len(names))
    added = connection.execute(f"INSERT INTO history ({', '.join(names)}) VALUES ({marks})", values)
    assert added.lastrowid is not None
    return added.lastrowid


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
    done: list[int] = []
    undone: list[int] = []
    for number, action, edit in connection.execute(
        "SELECT id, action, edit FROM history WHERE rater = ? ORDER BY id", (rater,)
    ):
        # Not always the last one: the same rater may work in two windows.
        if action == "undo":
            if edit in done:
                done.remove(edit)
            undone.append(edit)
        elif action == "redo":
            if edit in undone:
                undone.remove(edit)
            done.append(edit)
        else:
            done.append(number)
            undone.clear()
    return done, undone
