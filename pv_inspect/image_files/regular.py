"""Opening files that may be anything: a pipe, a device, a link to itself, or gone."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from pv_inspect.image_files.problems import ImageFileError, damaged, unreadable

__all__ = ["FileState", "exactly", "file_state", "open_regular"]

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


@dataclass(frozen=True)
class FileState:
    """What tells one file from another, and from itself after a change.

    Parameters
    ----------
    device, inode : int
        Equal for all names of one file: links, and the file itself.
    size : int
        Bytes.
    changed_ns : int
        Time of the last change of the content, ns.
    """

    device: int
    inode: int
    size: int
    changed_ns: int

    @classmethod
    def of(cls, found: os.stat_result) -> FileState:
        """Take it from what the system says."""
        return cls(found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns)

    @property
    def identity(self) -> tuple[int, int]:
        """Equal for all names of one file."""
        return self.device, self.inode


def file_state(path: Path) -> FileState:
    """Return the state of a regular file, links followed, without opening it.

    Raises
    ------
    ImageFileError
        If there is no such file, or it is a pipe, a device, a folder or a link without end.
    """
    try:
        found = path.stat()
    except OSError as error:
        raise _of_link(path, error) from None
    except ValueError as error:  # a null character
        raise damaged(str(error)) from None
    for is_kind, name in _KINDS:
        if is_kind(found.st_mode):
            raise ImageFileError(f"is no file but {name}: leave it out.")
    return FileState.of(found)


@contextmanager
def open_regular(path: Path, expected: FileState | None = None) -> Iterator[BinaryIO]:
    """Open a regular file for reading; never waits for a writer at the other end of a pipe.

    Parameters
    ----------
    path : Path
    expected : FileState, optional
        State when the file was looked at before.

    Raises
    ------
    ImageFileError
        If it can't be opened or read, is no regular file, or has changed.
    """
    file_state(path)
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        with os.fdopen(os.open(path, flags), "rb") as file:
            now = os.fstat(file.fileno())
            if not stat.S_ISREG(now.st_mode):
                raise ImageFileError("is no file: leave it out.")
            if expected is not None and (now.st_size, now.st_mtime_ns) != (
                expected.size,
                expected.changed_ns,
            ):
                raise ImageFileError("has changed since it was opened: open the frames again.")
            yield file
    except OSError as error:
        raise unreadable(error) from None


def exactly(file: BinaryIO, at: int, size: int) -> bytes:
    """Read ``size`` bytes from position ``at``.

    Raises
    ------
    ImageFileError
        If the file ends before.
    """
    file.seek(at)
    data = file.read(size)
    if len(data) != size:
        raise damaged("the file ends too early")
    return data


def _of_link(path: Path, error: OSError) -> ImageFileError:
    if error.errno == errno.ELOOP:
        return ImageFileError("is a link that leads back to itself: remove it.")
    if isinstance(error, FileNotFoundError) and path.is_symlink():
        return ImageFileError(f"is a link to {path.readlink()}, which is not there: remove it.")
    return unreadable(error)
