"""The verdicts of a result folder, kept in a database that outlives crashes."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.review.entries import (
    LINE,
    Change,
    Entry,
    append,
    entry_from,
    inserted,
    latest,
    stacks,
    stepped,
)
from pv_inspect.review.file import REVIEW_FILE, ReviewFile
from pv_inspect.review.mask_png import mask_from_png, mask_to_png
from pv_inspect.review.merging import Contents, contents, merge
from pv_inspect.review.schema import damaged
from pv_inspect.review.verdicts import Cell, ModuleData, Verdict, check_entry, now

__all__ = ["REVIEW_FILE", "ReviewState", "ReviewStore"]

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class ReviewState:
    """Where a rater has been.

    Parameters
    ----------
    rater : str
    row, col : int
        Selected cell.
    """

    rater: str
    row: int
    col: int


class ReviewStore(ReviewFile):
    """The review of one module: verdicts, corrected masks, module data, and where one was.

    A method that stores has stored durably when it returns; when it raises, nothing has changed
    and it may be called again with the same arguments. Several processes may use the same folder
    at the same time, each sees what the others have stored; one store may be shared by threads.
    The file is made by the first thing that is stored.

    Parameters
    ----------
    folder : Path
        Result folder.
    busy_s : float
        How long to wait for another process that is writing.

    Raises
    ------
    InspectionError
        By every method, in one sentence: the folder is write-protected, the disk is full, the file
        is damaged, of a newer version or held by another program.
    """

    def give(self, verdict: Verdict) -> int:
        """Store a verdict; a corrected mask of the cell stays, and its measures with it.

        Returns
        -------
        int
            Number of the edit, for `undo` and `redo`.
        """
        with self.writing() as connection:
            content = latest(connection, verdict.rater, verdict.cell)
            content |= {"kind": verdict.kind.value, "note": verdict.note, "time": verdict.time}
            content |= {"settings": verdict.settings, "software": verdict.software}
            if verdict.crack_length_cells is not None:
                content["crack_length_cells"] = verdict.crack_length_cells
                content["isolated_area_share"] = verdict.isolated_area_share
            return append(connection, "edit", None, verdict.rater, verdict.cell, content)

    def withdraw(self, cell: Cell, rater: str) -> int:
        """Take a verdict back: the cell is not judged any more. Mask and note stay.

        Returns
        -------
        int
            Number of the edit.
        """
        check_entry(cell, rater)
        with self.writing() as connection:
            content = latest(connection, rater, cell)
            content |= dict.fromkeys(("kind", "time", "settings", "software"))
            return append(connection, "edit", None, rater, cell, content)

    def note(self, cell: Cell, rater: str, text: str) -> int:
        """Store a note that waits for a verdict, or change that of a verdict.

        Returns
        -------
        int
            Number of the edit.
        """
        check_entry(cell, rater)
        with self.writing() as connection:
            content = latest(connection, rater, cell) | {"note": text}
            return append(connection, "edit", None, rater, cell, content)

    def correct(
        self,
        cell: Cell,
        rater: str,
        mask: Mask | None,
        crack_length_cells: float | None = None,
        isolated_area_share: float | None = None,
    ) -> int:
        """Store a corrected crack mask and what was measured on it; the verdict stays.

        Parameters
        ----------
        cell : (int, int)
            (row, column) from 0.
        rater : str
        mask : (h, w) bool or None
            None goes back to what the detector has found.
        crack_length_cells, isolated_area_share : float or None
            See `Verdict`; `pv_inspect.review.measuring` measures them.

        Returns
        -------
        int
            Number of the edit.
        """
        check_entry(cell, rater)
        with self.writing() as connection:
            content = latest(connection, rater, cell)
            content |= {"mask": None, "crack_length_cells": None, "isolated_area_share": None}
            if mask is not None:
                content |= {
                    "mask": inserted(connection, "masks", {"png": mask_to_png(mask)}),
                    "crack_length_cells": crack_length_cells,
                    "isolated_area_share": isolated_area_share,
                }
            return append(connection, "edit", None, rater, cell, content)

    def undo(self, rater: str, edit: int | None = None) -> Change | None:
        """Take back an edit of the rater, or the last one that is not taken back.

        Something newer about the same cell is left as it is.

        Returns
        -------
        Change or None
            None if there is no such edit.
        """
        return self._step(rater, "undo", edit)

    def redo(self, rater: str, edit: int | None = None) -> Change | None:
        """Bring back an edit of the rater, or the last one that was taken back; see `undo`."""
        return self._step(rater, "redo", edit)

    def can_undo(self, rater: str) -> bool:
        """Whether `undo` would do something."""
        with self.reading() as connection:
            return connection is not None and bool(stacks(connection, rater)[0])

    def can_redo(self, rater: str) -> bool:
        """Whether `redo` would do something."""
        with self.reading() as connection:
            return connection is not None and bool(stacks(connection, rater)[1])

    def current(self) -> tuple[Verdict, ...]:
        """Verdicts that hold now, of all raters, by row, column and rater."""
        with self.reading() as connection:
            if connection is None:
                return ()
            lines = connection.execute(
                f"SELECT {LINE} FROM history WHERE kind IS NOT NULL AND id IN "
                '(SELECT max(id) FROM history GROUP BY rater, "row", col) '
                'ORDER BY "row", col, rater'
            ).fetchall()
        entries = [self._entry(line) for line in lines]
        return tuple(entry.verdict for entry in entries if entry.verdict is not None)

    def waiting_notes(self, rater: str) -> dict[Cell, str]:
        """Notes of a rater about cells that the rater has not judged."""
        with self.reading() as connection:
            if connection is None:
                return {}
            lines = connection.execute(
                "SELECT \"row\", col, note FROM history WHERE kind IS NULL AND note <> '' "
                'AND id IN (SELECT max(id) FROM history WHERE rater = ? GROUP BY "row", col)',
                (rater,),
            ).fetchall()
        return {(int(row), int(col)): str(note) for row, col, note in lines}

    def history(self) -> tuple[Entry, ...]:
        """All that was ever stored about cells, the oldest first."""
        with self.reading() as connection:
            if connection is None:
                return ()
            lines = connection.execute(f"SELECT {LINE} FROM history ORDER BY id").fetchall()
        return tuple(self._entry(line) for line in lines)

    def raters(self) -> tuple[str, ...]:
        """Names of all who have stored anything about a cell, in alphabetical order."""
        with self.reading() as connection:
            if connection is None:
                return ()
            found = connection.execute("SELECT DISTINCT rater FROM history ORDER BY rater")
            return tuple(str(name) for (name,) in found)

    def mask(self, cell: Cell, rater: str) -> Mask | None:
        """Return the mask that a rater has corrected, (h, w) bool; None if it is not corrected."""
        with self.reading() as connection:
            if connection is None:
                return None
            found = connection.execute(
                "SELECT png FROM masks WHERE id = (SELECT mask FROM history "
                'WHERE rater = ? AND "row" = ? AND col = ? ORDER BY id DESC LIMIT 1)',
                (rater, *cell),
            ).fetchone()
        return None if found is None else self._mask(found[0])

    def masks(self, rater: str | None = None) -> dict[Cell, Mask]:
        """Corrected masks by cell, of one rater; of all raters the one that was stored last."""
        with self.reading() as connection:
            if connection is None:
                return {}
            lines = connection.execute(
                'SELECT "row", col, png FROM history JOIN masks ON masks.id = history.mask '
                'WHERE history.id IN (SELECT max(id) FROM history GROUP BY rater, "row", col) '
                "AND (?1 IS NULL OR rater = ?1) ORDER BY history.id",
                (rater,),
            ).fetchall()
        return {(int(row), int(col)): self._mask(png) for row, col, png in lines}

    def contents(self) -> Contents:
        """All that is stored, as it is at one moment; for `merge`."""
        with self.reading() as connection:
            if connection is None:
                return Contents()
            connection.execute("BEGIN")
            try:
                return contents(connection)
            finally:
                connection.execute("ROLLBACK")

    def merge(self, other: Contents) -> tuple[tuple[str, Cell], ...]:
        """Take over what another store holds, with its history; what is said here stays.

        Returns
        -------
        tuple of (rater, cell)
            Where both say something, and not the same.
        """
        with self.writing() as connection:
            return merge(connection, other)

    def describe(self, data: ModuleData) -> None:
        """Store what is known about the module; what was stored before is kept as history."""
        with self.writing() as connection:
            values = {"stored": now(), "data": json.dumps(asdict(data))}
            inserted(connection, "module_data", values)

    def module_data(self) -> ModuleData:
        """What is known about the module."""
        with self.reading() as connection:
            found = (
                connection
                and connection.execute(
                    "SELECT data FROM module_data ORDER BY id DESC LIMIT 1"
                ).fetchone()
            )
        if not found:
            return ModuleData()
        try:
            return ModuleData.from_mapping(json.loads(found[0]))
        except (ValueError, TypeError, AttributeError, RecursionError, InspectionError) as error:
            raise damaged(self.path, f"module data: {error}") from None

    def remember(self, state: ReviewState) -> None:
        """Store where a rater is, for the next session."""
        check_entry((state.row, state.col), state.rater)
        with self.writing() as connection:
            inserted(connection, "state", {**asdict(state), "stored": now()}, replace=True)

    def remembered(self, rater: str | None = None) -> ReviewState | None:
        """Where a rater was, or who was here last; None if nobody was."""
        with self.reading() as connection:
            found = (
                connection
                and connection.execute(
                    'SELECT rater, "row", col FROM state WHERE ?1 IS NULL OR rater = ?1 '
                    "ORDER BY rowid DESC LIMIT 1",  # a clock may go back
                    (rater,),
                ).fetchone()
            )
        return ReviewState(*found) if found else None

    def data_version(self) -> int:
        """Return a number that changes when another process or store has stored something.

        It costs little: a view may ask it every second and read `current` when it differs.
        """
        with self.reading() as connection:
            if connection is None:
                return 0
            return int(connection.execute("PRAGMA data_version").fetchone()[0])

    def _step(self, rater: str, action: str, edit: int | None) -> Change | None:
        if not self._exists():
            return None
        with self.writing() as connection:
            if edit is None:
                done, undone = stacks(connection, rater)
                stack = done if action == "undo" else undone
                if not stack:
                    return None
                edit = stack[-1]
            cell = connection.execute(
                "SELECT \"row\", col FROM history WHERE id = ? AND rater = ? AND action = 'edit'",
                (edit, rater),
            ).fetchone()
            if cell is None:
                return None
            before = latest(connection, rater, cell)
            after = stepped(connection, action, edit, rater, cell)
            if after is not None:
                append(connection, action, edit, rater, cell, after)
            found = connection.execute(
                f'SELECT {LINE} FROM history WHERE rater = ? AND "row" = ? AND col = ? '
                "ORDER BY id DESC LIMIT 1",
                (rater, *cell),
            ).fetchone()
        mask_changed = after is not None and before["mask"] != after["mask"]
        entry = self._entry(found)
        return Change(cell, entry.verdict, mask_changed, after is None, entry.note)

    def _entry(self, line: tuple[Any, ...]) -> Entry:
        try:
            return entry_from(line)
        except (ValueError, TypeError, InspectionError) as error:
            raise damaged(self.path, str(error)) from None

    def _mask(self, png: bytes) -> Mask:
        try:
            return mask_from_png(png)
        except ValueError as error:
            raise damaged(self.path, str(error)) from None
