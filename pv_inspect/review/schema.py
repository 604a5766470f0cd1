"""The tables of a review, and how its file is opened."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from pathlib import Path

from pv_inspect.errors import InspectionError
from pv_inspect.review.checking import MOST_BYTES, check_schema, check_values, guard, limit_size

__all__ = ["TABLES", "VERSION", "damaged", "failure", "opened"]

VERSION = 1
# Instructions of the database; some milliseconds.
_STEPS_BETWEEN_LOOKS = 50_000
_APPLICATION = 0x70766972  # "pvir"

# Every entry of the history holds the whole state of one cell for one rater; the latest is the
# current one. Nothing is ever changed or removed.
TABLES = f"""
CREATE TABLE masks (
    id INTEGER PRIMARY KEY,
    png BLOB NOT NULL
);
CREATE TABLE history (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    action TEXT NOT NULL CHECK (action IN ('edit', 'undo', 'redo')),
    edit INTEGER REFERENCES history (id),
    stored TEXT NOT NULL,
    rater TEXT NOT NULL,
    "row" INTEGER NOT NULL,
    col INTEGER NOT NULL,
    kind TEXT,
    note TEXT,
    time TEXT,
    settings TEXT,
    software TEXT,
    crack_length_cells REAL,
    isolated_area_share REAL,
    mask INTEGER REFERENCES masks (id)
);
CREATE INDEX history_of_cell ON history (rater, "row", col, id);
CREATE TRIGGER history_is_not_changed BEFORE UPDATE ON history
    BEGIN SELECT RAISE(ABORT, 'the history is append-only'); END;
CREATE TRIGGER history_is_not_cut BEFORE DELETE ON history
    BEGIN SELECT RAISE(ABORT, 'the history is append-only'); END;
CREATE TABLE module_data (
    id INTEGER PRIMARY KEY,
    stored TEXT NOT NULL,
    data TEXT NOT NULL
);
CREATE TABLE state (
    rater TEXT PRIMARY KEY,
    stored TEXT NOT NULL,
    "row" INTEGER NOT NULL,
    col INTEGER NOT NULL
);
PRAGMA application_id = {_APPLICATION};
PRAGMA user_version = {VERSION};
"""

_FULL = (sqlite3.SQLITE_FULL,)
_DENIED = (
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_CANTOPEN,
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_AUTH,
)
_HELD = (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED)
_DAMAGED = (
    sqlite3.SQLITE_NOTADB,
    sqlite3.SQLITE_CORRUPT,
    sqlite3.SQLITE_ERROR,
    sqlite3.SQLITE_TOOBIG,
    sqlite3.SQLITE_MISMATCH,
)


def opened(
    path: Path, create: bool, busy_s: float, watch: Callable[[], bool] | None = None
) -> sqlite3.Connection:
    """Open the file of a review, with its tables; what is not ours to the letter is refused.

    Parameters
    ----------
    path : Path
        Absolute.
    create : bool
        Make the file and its tables if there are none.
    busy_s : float
        How long to wait for another process that is writing.
    watch : callable, optional
        Asked again and again while the database works; true ends what it is doing.

    Returns
    -------
    sqlite3.Connection
        In autocommit mode.

    Raises
    ------
    InspectionError
        If the file is damaged, of a newer version, or not ours: another schema, values of other
        types, too large.
    sqlite3.Error
        See `failure`.

    Notes
    -----
    A rollback journal and not a write-ahead log: it works on network drives, a commit is in the
    one file that counts, and that file may get a new name while it is open (the result folder is
    replaced as a whole, with hard links). The journal is emptied, not removed, for the same
    reason; with full synchronisation a commit has reached the disk when it returns.
    """
    connection = sqlite3.connect(
        f"{path.as_uri()}?mode={'rwc' if create else 'rw'}",
        uri=True,
        timeout=busy_s,
        isolation_level=None,
        check_same_thread=False,
    )
    try:
        connection.set_progress_handler(watch, _STEPS_BETWEEN_LOOKS)
        guard(connection)
        is_new = _is_new(connection, path)
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("PRAGMA journal_mode = TRUNCATE")
        limit_size(connection)
        if is_new and create:
            connection.execute("BEGIN IMMEDIATE")
            if _is_new(connection, path):  # another process may have been faster
                for statement in _statements(TABLES):
                    connection.execute(statement)
            connection.execute("COMMIT")
    except BaseException:
        connection.close()
        raise
    return connection


def failure(error: sqlite3.Error, path: Path) -> InspectionError:
    """One sentence about what kept something from being stored or read."""
    code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR) & 0xFF
    if code in _FULL and _size(path) > 0.98 * MOST_BYTES:
        return InspectionError(
            f"Nothing more can be stored in {path}: a review has at most {MOST_BYTES / 1e6:.0f} "
            "MB; save the result into another folder and go on there (all that was stored before "
            "is safe)."
        )
    if code in _FULL:
        return InspectionError(
            f"Nothing more can be stored in {path}: the disk is full; free some space and try "
            "again (all that was stored before is safe)."
        )
    if code in _DENIED:
        return InspectionError(
            f"{path} can't be written: the file or its folder is write-protected or gone; allow "
            "writing and try again (all that was stored before is safe)."
        )
    if code in _HELD:
        return InspectionError(
            f"{path} is held by another program: try again, and close the other program if that "
            "does not help."
        )
    if code == sqlite3.SQLITE_INTERRUPT:
        return damaged(path, "reading it took too long")
    if code in _DAMAGED:
        return damaged(path, str(error))
    return InspectionError(
        f"{path} can't be stored or read ({error}): check the disk and try again (all that was "
        "stored before is safe)."
    )


def damaged(path: Path, detail: str) -> InspectionError:
    """One sentence about a file that can't be understood; it is left as it is."""
    return InspectionError(
        f"{path} is damaged or no review of this program ({detail}): move it elsewhere and keep "
        "it, or put a copy of it in its place; it was not changed."
    )


def _is_new(connection: sqlite3.Connection, path: Path) -> bool:
    """Whether there are no tables yet; refuses what is not ours."""
    (application,) = connection.execute("PRAGMA application_id").fetchone()
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    (n_tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    if n_tables == 0 and version == 0:
        return True
    if application != _APPLICATION:
        raise damaged(path, "it is a database of another program")
    if version > VERSION:
        raise InspectionError(
            f"{path} was written by a newer version of pv-inspect (format {version}, this one "
            f"knows {VERSION}): update pv-inspect; the file was not changed."
        )
    check_schema(connection, TABLES, path)
    (found,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    if found != "ok":
        raise damaged(path, " ".join(str(found).split()))
    check_values(connection, path)
    return False


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _statements(script: str) -> list[str]:
    """Statements of a script; `executescript` would commit the transaction that is open."""
    found, begun = [], ""
    for line in script.splitlines(keepends=True):
        begun += line
        if sqlite3.complete_statement(begun):
            found.append(begun)
            begun = ""
    return found
