"""Whether the database of a review is one of ours, before anything in it is believed.

A database can hold programs: triggers that drop what is stored, views that never end. SQLite also
takes text where a column says number. So the schema has to be ours to the letter, and every value
of the type that its column names.
"""

from __future__ import annotations

import sqlite3
from functools import cache
from pathlib import Path

from pv_inspect.errors import InspectionError
from pv_inspect.review.verdicts import HIGHEST, VerdictKind

__all__ = ["MOST_BYTES", "MOST_ENTRIES", "check_schema", "check_values", "guard", "limit_size"]

# A hundred corrections of each of 144 cells, with a mask of 4 KiB each, are 60 MB.
MOST_BYTES = 2**28
MOST_ENTRIES = 300_000
# Longest text or mask; a mask of a cell of 1000 x 1000 px takes less than 0.2 MB.
_MOST_VALUE_BYTES = 2**24
# What `ANALYZE` leaves does no harm.
_STATISTICS = {"sqlite_stat1": "tbl,idx,stat", "sqlite_stat4": "tbl,idx,neq,nlt,ndlt,sample"}

_Schema = dict[tuple[str, str], str]
_TEXT, _WHOLE = "a text", "a whole number"
# SQL that holds for a right value of a column, and what is expected then.
_PLACE = (f"typeof({{0}}) = 'integer' AND {{0}} BETWEEN 0 AND {HIGHEST}", "a number from 0")
_ID = (f"typeof({{0}}) = 'integer' AND {{0}} BETWEEN 1 AND {MOST_ENTRIES}", _WHOLE)
_SAID = ("typeof({0}) = 'text'", _TEXT)
_OPEN_ID = (f"{{0}} IS NULL OR ({_ID[0]})", _WHOLE)
_OPEN_TEXT = ("typeof({0}) IN ('text', 'null')", _TEXT)
_MEASURE = (
    "{0} IS NULL OR (typeof({0}) IN ('real', 'integer') AND {0} BETWEEN 0 AND 1e9)",
    "a number from 0",
)
_KINDS = ", ".join(f"'{kind.value}'" for kind in VerdictKind)
_COLUMNS = {
    "history": {
        "id": _ID,
        "action": ("typeof({0}) = 'text' AND {0} IN ('edit', 'undo', 'redo')", "an action"),
        "edit": _OPEN_ID,
        "stored": _SAID,
        "rater": ("typeof({0}) = 'text' AND trim({0}) <> ''", "a name"),
        "row": _PLACE,
        "col": _PLACE,
        "kind": (f"{{0}} IS NULL OR (typeof({{0}}) = 'text' AND {{0}} IN ({_KINDS}))", "a verdict"),
        "note": _OPEN_TEXT,
        "time": _OPEN_TEXT,
        "settings": _OPEN_TEXT,
        "software": _OPEN_TEXT,
        "crack_length_cells": _MEASURE,
        "isolated_area_share": _MEASURE,
        "mask": _OPEN_ID,
    },
    "masks": {"id": _ID, "png": ("typeof({0}) = 'blob'", "a picture")},
    "module_data": {"id": _ID, "stored": _SAID, "data": _SAID},
    "state": {
        "rater": ("typeof({0}) = 'text' AND trim({0}) <> ''", "a name"),
        "stored": _SAID,
        "row": _PLACE,
        "col": _PLACE,
    },
    "sqlite_sequence": {
        "seq": (f"typeof({{0}}) = 'integer' AND {{0}} BETWEEN 0 AND {MOST_ENTRIES}", _WHOLE)
    },
}
# A judged cell has all of these.
_JUDGED = ("note", "time", "settings", "software")


def guard(connection: sqlite3.Connection) -> None:
    """Let the database run no functions of its own, attach no file and hold no huge value."""
    connection.execute("PRAGMA trusted_schema = OFF")
    connection.execute("PRAGMA cell_size_check = ON")
    connection.execute("PRAGMA mmap_size = 0")
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MOST_VALUE_BYTES)
    connection.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
    connection.setlimit(sqlite3.SQLITE_LIMIT_TRIGGER_DEPTH, 1)


def check_schema(connection: sqlite3.Connection, tables: str, path: Path) -> None:
    """Refuse a database whose tables, indexes, triggers and views are not exactly ours.

    Parameters
    ----------
    connection : sqlite3.Connection
    tables : str
        SQL that makes our own.
    path : Path
        For the sentence.

    Raises
    ------
    InspectionError
        It names what is foreign, changed or missing.
    """
    size = path.stat().st_size
    if size > MOST_BYTES:
        raise InspectionError(
            f"{path} has {size / 1e6:.0f} MB, a review has at most {MOST_BYTES / 1e6:.0f}: put a "
            "copy of your review in its place; it was not changed."
        )
    ours, found = _ours(tables), _schema(connection)
    for (kind, name), sql in found.items():
        if (kind, name) not in ours:
            raise _foreign(path, f"it holds the {kind} {name[:40]!r} that no review has")
        if sql != ours[kind, name]:
            raise _foreign(path, f"its {kind} {name!r} is made in another way than a review's")
    for kind, name in ours.keys() - found.keys():
        raise _foreign(path, f"it has no {kind} {name!r}")


def check_values(connection: sqlite3.Connection, path: Path) -> None:
    """Refuse a database with a value of another type than its column.

    The schema has to be checked before.

    Raises
    ------
    InspectionError
        It names the entry and the column.
    """
    for table, columns in _COLUMNS.items():
        rules = [(n, rule.format(f'"{n}"'), what) for n, (rule, what) in columns.items()]
        if table == "history":
            judged = " AND ".join(f"{name} IS NOT NULL" for name in _JUDGED)
            rules.append(("kind", f"kind IS NULL OR ({judged})", "a verdict with its time"))
        wrong = " OR ".join(f"NOT ({rule})" for _, rule, _ in rules)
        if connection.execute(f"SELECT 1 FROM {table} WHERE {wrong} LIMIT 1").fetchone() is None:
            continue
        for name, rule, what in rules:
            value = (
                f"""iif(typeof("{name}") IN ('text', 'blob'), substr("{name}", 1, 30), "{name}")"""
            )
            entry = connection.execute(
                f"SELECT rowid, {value} FROM {table} WHERE NOT ({rule}) LIMIT 1"
            ).fetchone()
            if entry is not None:
                raise _foreign(
                    path,
                    f"{table}, entry {entry[0]}: {name} is {entry[1]!r}, expected is {what}",
                )


def limit_size(connection: sqlite3.Connection) -> None:
    """Let the file grow no further than it may be when it is opened again."""
    (page_bytes,) = connection.execute("PRAGMA page_size").fetchone()
    connection.execute(f"PRAGMA max_page_count = {MOST_BYTES // max(int(page_bytes), 512)}")


def _foreign(path: Path, what: str) -> InspectionError:
    return InspectionError(
        f"{path} was changed by another program ({what}): put a copy of your review in its place; "
        "it was not changed now."
    )


@cache
def _ours(tables: str) -> _Schema:
    connection = sqlite3.connect(":memory:")
    try:
        connection.executescript(tables)
        return _schema(connection)
    finally:
        connection.close()


def _schema(connection: sqlite3.Connection) -> _Schema:
    """Statement by kind and name of what it made."""
    found = connection.execute("SELECT type, name, sql FROM sqlite_master").fetchall()
    schema = {(str(kind), str(name)): " ".join(str(sql).split()) for kind, name, sql in found}
    for name, columns in _STATISTICS.items():
        if schema.get(("table", name)) == f"CREATE TABLE {name}({columns})":
            del schema["table", name]
    return schema
