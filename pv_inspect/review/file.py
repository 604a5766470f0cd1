"""The file of a review: opened when needed, one transaction at a time, errors in one sentence."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import RLock
from time import monotonic, sleep
from typing import Self

from pv_inspect.errors import InspectionError
from pv_inspect.review.checking import check_schema
from pv_inspect.review.schema import TABLES, damaged, failure, opened

__all__ = ["REVIEW_FILE", "ReviewFile"]

REVIEW_FILE = "review.sqlite"
# Between the two renames of a replacement there is no folder: how long and how often it is sought.
_REPLACED_S, _POLL_S = 0.5, 0.005
# No question takes a second; a file that was made to keep us busy is given up.
_PATIENCE_S = 8.0


class ReviewFile:
    """Connection to the database of a result folder.

    Parameters
    ----------
    folder : Path
        Result folder.
    busy_s : float
        How long to wait for another process that is writing.
    """

    def __init__(self, folder: Path, busy_s: float = 2.0) -> None:
        self.path = Path(os.path.realpath(folder)) / REVIEW_FILE
        self._busy_s = busy_s
        self._lock = RLock()
        self._connection: sqlite3.Connection | None = None
        self._file: tuple[int, int] | None = None
        self._schema_version = 0
        self._end_s = 0.0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the file; it is opened again when it is needed."""
        with self._lock:
            if self._connection is not None:
                self._connection.close()
            self._connection = self._file = None

    def _exists(self) -> bool:
        try:
            return self.path.stat().st_size > 0
        except OSError:
            return False

    def _comes_back(self) -> bool:
        end = monotonic() + _REPLACED_S
        while not self._exists():
            if monotonic() > end:
                return False
            sleep(_POLL_S)
        return True

    def _open(self, create: bool) -> sqlite3.Connection | None:
        """Return the connection to the file that has the name now; None if there is none to read.

        Where a result is replaced without hard links, the file is another one afterwards.
        """
        if self._connection is not None and not self._comes_back():
            raise InspectionError(
                f"{self.path} is gone although it was in use: put it back, or close this "
                "module and open it again."
            )
        if not create and not self._exists():
            return None
        if self.path.exists() and not self.path.is_file():
            raise damaged(self.path, "it is no file")
        if self._connection is None or self._identity() != self._file:
            self.close()
            self._connection = opened(self.path, create, self._busy_s, self._is_late)
            self._file = self._identity()
            self._schema_version = self._version_of_schema(self._connection)
        elif (version := self._version_of_schema(self._connection)) != self._schema_version:
            check_schema(self._connection, TABLES, self.path)
            self._schema_version = version
        return self._connection

    def _is_late(self) -> bool:
        return monotonic() > self._end_s

    @staticmethod
    def _version_of_schema(connection: sqlite3.Connection) -> int:
        return int(connection.execute("PRAGMA schema_version").fetchone()[0])

    def _identity(self) -> tuple[int, int]:
        found = self.path.stat()
        return found.st_dev, found.st_ino

    def _begun(self) -> sqlite3.Connection:
        """Begin a transaction on the file that has the name now.

        A result that is replaced without hard links holds the transaction up until the file is
        another one; what was stored in the old one would be lost.
        """
        end = monotonic() + _REPLACED_S
        while True:
            try:
                connection = self._open(create=True)
                assert connection is not None
                connection.execute("BEGIN IMMEDIATE")
            except (FileNotFoundError, sqlite3.OperationalError) as error:
                if monotonic() > end or not _is_missing(error):
                    raise
                sleep(_POLL_S)
                continue
            with suppress(OSError):
                if self._identity() == self._file:
                    return connection
            connection.execute("ROLLBACK")

    @contextmanager
    def reading(self) -> Iterator[sqlite3.Connection | None]:
        """Read in the block; None if nothing was ever stored."""
        with self._lock:
            self._end_s = monotonic() + self._busy_s + _PATIENCE_S
            try:
                yield self._open(create=False)
            except sqlite3.Error as error:
                raise failure(error, self.path) from None
            except (ValueError, TypeError, OverflowError, RecursionError) as error:
                raise damaged(self.path, str(error)) from None
            except OSError as error:
                raise InspectionError(f"{self.path} can't be read: {error.strerror}.") from None

    @contextmanager
    def writing(self) -> Iterator[sqlite3.Connection]:
        """One transaction, on the disk when the block ends; nothing has changed if it raises."""
        with self._lock:
            self._end_s = monotonic() + self._busy_s + _PATIENCE_S
            try:
                connection = self._begun()
                try:
                    yield connection
                    connection.execute("COMMIT")
                except BaseException:
                    if connection.in_transaction:
                        connection.execute("ROLLBACK")
                    raise
            except sqlite3.Error as error:
                raise failure(error, self.path) from None
            except UnicodeEncodeError:
                raise InspectionError(
                    "The note or the name holds characters that can't be stored: type it again."
                ) from None
            except (ValueError, TypeError, OverflowError, RecursionError) as error:
                raise damaged(self.path, str(error)) from None
            except OSError as error:
                raise InspectionError(f"{self.path} can't be written: {error.strerror}.") from None


def _is_missing(error: FileNotFoundError | sqlite3.OperationalError) -> bool:
    """Whether the file or its folder was not there."""
    if isinstance(error, FileNotFoundError):
        return True
    return error.sqlite_errorcode & 0xFF == sqlite3.SQLITE_CANTOPEN
