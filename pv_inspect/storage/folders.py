"""Replacing a folder as a whole: after a cut there is the old one or the new one, never a mixture.

The new folder grows beside the old one under a hidden name and changes places with it when every
file of it is on the disk. A lock beside it keeps other processes away for so long.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from time import monotonic, sleep
from typing import TypeVar
from uuid import uuid4

from pv_inspect.common.signals import check, held_back
from pv_inspect.errors import InspectionError
from pv_inspect.storage.exchange import exchange
from pv_inspect.storage.locks import FileLock, HeldError, folder_held
from pv_inspect.storage.output_paths import FULL, cant_write, output_folder, shown
from pv_inspect.storage.preserved_files import carried, take_missing
from pv_inspect.storage.reservations import locked_output
from pv_inspect.storage.temporaries import (
    MOVING,
    PARTIAL,
    PREVIOUS,
    is_dead,
    leftovers,
    lock_of,
    own,
)

__all__ = [
    "Reservation",
    "check_replaceable",
    "read_steadily",
    "recovered",
    "replace_file",
    "replace_folder",
    "reserved",
]

IsOurs = Callable[[PurePath], bool]
Identity = tuple[int, int] | None
T = TypeVar("T")

# Who writes once waits so long for another one who does; a run is not waited for.
_PATIENCE_S = 5.0
_GAP_S = 2.0  # between the two renames of another process
_POLL_S = 0.02
_READING_S = 10.0  # of a folder that is replaced again and again


def check_replaceable(out: Path, marker: str) -> Path:
    """Check that a folder can be made, or replaced by `replace_folder`.

    Parameters
    ----------
    out : Path
    marker : str
        File that every folder of ours holds.

    Returns
    -------
    Path
        ``out`` without links.

    Raises
    ------
    InspectionError
        If no folder can be there, if it is a mount point, read-only, or holds things but not the
        marker, or if nothing can be created beside it.
    """
    out = recovered(output_folder(out, replaced=True))
    if out.exists():
        try:
            names = {entry.name for entry in out.iterdir()}
        except OSError as error:
            raise InspectionError(
                f"{shown(out)} can't be read ({error.strerror}): give another folder for the "
                "result."
            ) from None
        if names and marker not in names:
            raise InspectionError(
                f"{shown(out)} is not empty and holds no earlier result ({marker} is missing): "
                "give a new or empty folder, so that none of your files is touched."
            )
        if out.is_mount():
            raise InspectionError(
                f"{shown(out)} is a mount point and can't be replaced as a whole: give a folder "
                f"inside it, for example {shown(out / 'result')}."
            )
        if not os.access(out, os.W_OK | os.X_OK):
            denied = OSError(errno.EACCES, os.strerror(errno.EACCES))
            raise cant_write(out, out, denied)
    parent = next(p for p in out.parents if p.exists())
    probe = parent / f".pv-inspect-probe-{uuid4().hex}"
    try:
        probe.mkdir()
        probe.rmdir()
    except OSError as error:
        raise cant_write(out, parent, error) from None
    return out


@dataclass(frozen=True, eq=False)
class Reservation:
    """A folder that this process alone replaces for the time being; see `reserved`.

    Parameters
    ----------
    out : Path
        Without links.
    marker : str
    is_ours : callable
    lock : FileLock
    before : (int, int) or None
        Which folder had the name at first.
    made : list of (int, int)
        Which folders `fill` has made.
    """

    out: Path
    marker: str
    is_ours: IsOurs
    lock: FileLock
    before: Identity
    made: list[Identity] = field(default_factory=list)

    def so_far(self) -> str:
        """Tell what has become of the folder, looked up now."""
        now = _identity(self.out)
        if now is not None and now in self.made:
            return f"the new result is in {shown(self.out)}"
        if now == self.before:
            return "nothing was changed there" if self.before else "nothing was written"
        return f"nothing was written, but {shown(self.out)} was changed by somebody else"

    def fill(self, files: Iterable[tuple[str, bytes]]) -> None:
        """Write the folder, all or nothing; see `replace_folder`."""
        out = self.out
        growing = own(out, PARTIAL), own(out, MOVING)
        try:
            check_replaceable(out, self.marker)
            growing[0].mkdir(parents=True)
            self.made.append(_identity(growing[0]))
            for name, content in files:
                (growing[0] / name).parent.mkdir(exist_ok=True)
                _write_file(growing[0] / name, content)
                check()
            self._move_into_place(*growing)
        except BaseException as error:
            with held_back():
                for folder in growing:
                    if _identity(folder) in self.made:
                        shutil.rmtree(folder, ignore_errors=True)
                _put_back(out)
            if not isinstance(error, OSError):
                raise
            reason, remedy = error.strerror or str(error), "give another one"
            if error.errno in FULL:
                reason = "the disk is full"
                remedy = "free some space or give a folder on another disk"
            elif error.errno == errno.EBUSY:
                remedy = "try again in a moment"
            raise InspectionError(
                f"The result can't be written to {shown(out)}: {reason}; {remedy} "
                f"({self.so_far()})."
            ) from None

    def _move_into_place(self, partial: Path, moving: Path) -> None:
        out, left = self.out, moving
        exists = out.exists()
        with (
            folder_held(out) if exists else nullcontext(),
            carried(out, partial, self.is_ours) as taken,
        ):
            _sync_folder(partial)
            if not self.lock.is_ours:
                raise InspectionError(
                    f"Another pv-inspect took {shown(out)} over while this one stood still: "
                    "nothing was changed there; give another folder."
                )
            with held_back():
                if not exists:
                    partial.rename(out)
                    _sync_folder(out.parent)
                    return
                partial.rename(moving)
                if not exchange(moving, out):
                    left = own(out, PREVIOUS)
                    out.rename(left)
                    moving.rename(out)
                _sync_folder(out.parent)
                try:
                    taken.catch_up(left, out, self.is_ours)
                except OSError as error:
                    raise InspectionError(
                        f"The new result is in {shown(out)}, but a file that was written meanwhile "
                        f"can't be taken along ({error.strerror}): it is in {left.name} beside it; "
                        "move it yourself."
                    ) from None
                # What can't be removed now is removed by the next run.
                shutil.rmtree(left, ignore_errors=True)


@contextmanager
def reserved(out: Path, marker: str, is_ours: IsOurs, wait_s: float = 0.0) -> Iterator[Reservation]:
    """Keep other processes from replacing a folder, from before the work until it is written.

    Parameters
    ----------
    out : Path
    marker : str
        As in `check_replaceable`.
    is_ours : callable
        Tells of a path relative to ``out`` whether this program writes it.
    wait_s : float
        How long to wait for another process.

    Raises
    ------
    InspectionError
        As `check_replaceable`, or if another process is writing there.
    """
    out = check_replaceable(out, marker)
    with locked_output(out, lock_of(out), wait_s) as lock:
        _put_back(out)
        _clear(out, is_ours)
        yield Reservation(out, marker, is_ours, lock, _identity(out))


def replace_folder(
    out: Path, files: Iterable[tuple[str, bytes]], marker: str, is_ours: IsOurs
) -> None:
    """Write a folder, all or nothing.

    Parameters
    ----------
    out : Path
        Made, or replaced; what is in it and not ours is kept.
    files : iterable of (name, content)
        Names relative to ``out``, with "/" between folders.
    marker : str
        As in `check_replaceable`.
    is_ours : callable
        Tells of a path relative to ``out`` whether this program writes it.

    Raises
    ------
    InspectionError
        If the folder can't be written; then an earlier one is as it was.
    """
    with reserved(out, marker, is_ours, _PATIENCE_S) as place:
        place.fill(files)


def replace_file(path: Path, content: bytes) -> None:
    """Write one file of an existing folder, as a whole or not at all.

    Raises
    ------
    InspectionError
        If it can't be written; then an earlier one is as it was.
    """
    if path.is_dir():
        raise InspectionError(
            f"{shown(path)} can't be written: it is a folder; remove it, or give another name."
        )
    partial = own(path, PARTIAL)
    try:
        _write_file(partial, content)
        partial.replace(path)
    except BaseException as error:
        with suppress(OSError):
            partial.unlink()
        if not isinstance(error, OSError):
            raise
        reason = error.strerror or str(error)
        remedy = "allow writing there, and try again"
        if error.errno in FULL:
            reason, remedy = "the disk is full", "free some space, and try again"
        elif error.errno in (errno.ENOENT, errno.ENOTDIR):
            reason = f"there is no folder {shown(path.parent)}"
            remedy = "make it first, or give another place"
        raise InspectionError(f"{shown(path)} can't be written: {reason}; {remedy}.") from None
    _sync_folder(path.parent)


def recovered(out: Path) -> Path:
    """Return ``out`` without links, the old folder back in place if a replacement was cut.

    Between the two renames of a replacement there is, for an instant, nothing at ``out``; where a
    process is alive there, it is waited for.
    """
    out = Path(os.path.realpath(Path(out).expanduser()))
    end = monotonic() + _GAP_S
    while not os.path.lexists(out) and leftovers(out, PREVIOUS) and monotonic() < end:
        try:
            with FileLock(lock_of(out)).acquire():
                _put_back(out)
            break
        except HeldError:
            sleep(_POLL_S)
        except OSError:  # nothing can be made there: it is not ours to mend
            break
    return out


def read_steadily(folder: Path, read: Callable[[], T]) -> T:
    """Read several files of a folder, again if it was replaced in between.

    Parameters
    ----------
    folder : Path
    read : callable
    """
    end = monotonic() + _READING_S
    while True:
        before = _state(recovered(folder))
        last = monotonic() > end
        try:
            found = read()
        except InspectionError:
            if last or _state(folder) == before:
                raise
        else:
            if last or _state(folder) == before:
                return found


def _put_back(out: Path) -> None:
    """Move the old folder back if nothing has taken its place; only for the holder of the lock."""
    if not os.path.lexists(out):
        for previous in reversed(leftovers(out, PREVIOUS)):
            with suppress(OSError):
                previous.rename(out)
                return


def _clear(out: Path, is_ours: IsOurs) -> None:
    """Remove what dead processes have left; only for the holder of the lock."""
    partial = leftovers(out, PARTIAL)
    for left in (*partial, *leftovers(out, MOVING, PREVIOUS)):
        if not is_dead(left):
            continue
        if left not in partial and out.exists():
            try:
                take_missing(left, out, is_ours)
            except OSError:
                continue  # the next one may have more room
        shutil.rmtree(left, ignore_errors=True)


def _identity(folder: Path) -> Identity:
    try:
        found = folder.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _state(folder: Path) -> tuple[int, ...] | None:
    """Identity of a folder and of its entries: a number that is free again may be given anew."""
    try:
        found = folder.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino, found.st_mtime_ns


def _write_file(path: Path, content: bytes) -> None:
    """Write and flush to the disk: a full disk is noticed here, not after the rename."""
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    with suppress(OSError):  # not every system can
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
