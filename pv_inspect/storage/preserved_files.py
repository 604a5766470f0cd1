"""What others have put into a folder is taken along when the folder is replaced as a whole."""

from __future__ import annotations

import errno
import os
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path, PurePath

from pv_inspect.storage.temporaries import PARTIAL, is_dead, is_temporary, own

__all__ = ["Carried", "carried", "take_missing"]

IsOurs = Callable[[PurePath], bool]

_DATABASE = ".sqlite"
_DATABASE_HELPERS = tuple(f"{_DATABASE}-{end}" for end in ("journal", "wal", "shm"))
# How long another process may write into a database that is copied.
_BUSY_S = 3.0


@dataclass
class Carried:
    """What was taken along.

    Parameters
    ----------
    folders : set of PurePath
    files : dict of PurePath to (state of the original, state of what was taken)
    """

    folders: set[PurePath] = field(default_factory=set)
    files: dict[PurePath, tuple[object, object]] = field(default_factory=dict)

    def catch_up(self, old: Path, new: Path, is_ours: IsOurs) -> None:
        """Take along what came into the old folder after it was looked through.

        To be called when the new folder has taken its place: from then on nobody writes into the
        old one by its name.

        Raises
        ------
        OSError
            If a file can't be taken along; it is still in the old folder.
        """
        for relative, path in _foreign(old, is_ours):
            target = new / relative
            if path.is_dir() and not path.is_symlink():
                if relative not in self.folders:
                    target.mkdir(parents=True, exist_ok=True)
            elif not os.path.lexists(target):
                if relative not in self.files:  # else it was removed from the new one
                    _link_or_copy(path, target)
            elif not _same(path, target):
                were = self.files.get(relative, (None, None))
                if _state(path) != were[0]:
                    # Where both were written in the same instant, both are kept.
                    _replace(path, target, aside=_state(target) != were[1])


@contextmanager
def carried(old: Path, new: Path, is_ours: IsOurs) -> Iterator[Carried]:
    """Take along what is in a folder and not ours; for the block, databases that were copied rest.

    Hard links where the file system has them: a database that is open stays the same file. Where
    it has none, a database is copied as one transaction and nobody can write into it until the
    block ends; whoever waited for that finds another file then (see `review.file`).

    Parameters
    ----------
    old, new : Path
        Folders; nothing is taken if ``old`` does not exist.
    is_ours : callable
        Tells of a path relative to the folder whether it is replaced.

    Raises
    ------
    OSError
        If a file can't be taken along.
    """
    done = Carried()
    with ExitStack() as stack:
        for relative, path in _foreign(old, is_ours):
            target = new / relative
            if path.is_dir() and not path.is_symlink():
                done.folders.add(relative)
                target.mkdir(parents=True, exist_ok=True)
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            try:
                os.link(path, target, follow_symlinks=False)
            except FileNotFoundError:
                continue  # removed by its owner just now
            except (OSError, NotImplementedError):
                before = _copy(path, target, stack)
            else:
                before = _state(target)
            done.files[relative] = before, _state(target)
        yield done


def take_missing(left: Path, out: Path, is_ours: IsOurs) -> None:
    """Take what only a folder that was left by a cut holds, and is not ours.

    Of a file that is newer there than in ``out``, both are kept.

    Raises
    ------
    OSError
        If something can't be taken; it is still where it was.
    """
    for relative, path in _foreign(left, is_ours):
        target = out / relative
        if path.is_dir() and not path.is_symlink():
            target.mkdir(parents=True, exist_ok=True)
        elif not os.path.lexists(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            _link_or_copy(path, target)
        elif not _same(path, target) and path.lstat().st_mtime_ns > target.lstat().st_mtime_ns:
            _replace(path, target, aside=True)


def _foreign(folder: Path, is_ours: IsOurs) -> Iterator[tuple[PurePath, Path]]:
    for path in sorted(folder.rglob("*")):
        relative = path.relative_to(folder)
        left = is_temporary(path.name) and (is_dead(path) or path.name.endswith(".lock"))
        if not is_ours(relative) and not left:
            yield relative, path


def _link_or_copy(path: Path, target: Path) -> None:
    try:
        os.link(path, target, follow_symlinks=False)
    except FileNotFoundError:
        return
    except (OSError, NotImplementedError):
        with ExitStack() as stack:
            _copy(path, target, stack)


def _copy(path: Path, target: Path, stack: ExitStack) -> object:
    """Copy a file; return the state of the original that the copy shows."""
    helper = path.name.endswith(_DATABASE_HELPERS)
    if helper and path.with_name(path.name.rpartition("-")[0]).exists():
        return _state(path)  # what is in it goes with the database
    if path.suffix == _DATABASE and not path.is_symlink():
        try:
            _copy_database(path, target, stack)
            return _state(path)
        except sqlite3.OperationalError as error:
            held = (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED)
            if getattr(error, "sqlite_errorcode", 0) & 0xFF in held:
                raise OSError(errno.EBUSY, f"{path.name} is in use by another program") from None
        except sqlite3.DatabaseError:
            pass  # no database, in spite of its name
        with suppress(OSError):
            target.unlink()
    before = _state(path)
    with suppress(FileNotFoundError):
        shutil.copy2(path, target, follow_symlinks=False)
    return before


def _copy_database(path: Path, target: Path, stack: ExitStack) -> None:
    # Through SQLite: to close the file here would take away the locks that this process has on it.
    address = f"{path.absolute().as_uri()}?mode=rw"
    writer = sqlite3.connect(address, uri=True, timeout=_BUSY_S, isolation_level=None)
    stack.callback(writer.close)
    writer.execute("BEGIN IMMEDIATE")
    # A connection that may write can't be copied from.
    with (
        closing(sqlite3.connect(address, uri=True, timeout=_BUSY_S)) as source,
        closing(sqlite3.connect(target)) as copy,
    ):
        source.backup(copy)
    shutil.copystat(path, target)


def _replace(path: Path, target: Path, aside: bool = False) -> None:
    """Put a file in the place of another; ``aside``: beside it, under a name that is free."""
    partial = own(target, PARTIAL)
    _link_or_copy(path, partial)
    if aside:
        n = 1
        while os.path.lexists(place := target.with_name(f"{target.name}.other-{n}")):
            n += 1
        target = place
    partial.replace(target)


def _same(a: Path, b: Path) -> bool:
    first, second = a.lstat(), b.lstat()
    return (first.st_dev, first.st_ino) == (second.st_dev, second.st_ino)


def _state(path: Path) -> object:
    try:
        found = path.lstat()
    except OSError:
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns
