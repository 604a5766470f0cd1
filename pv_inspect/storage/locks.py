"""Locks between processes: who writes to an output, also on a network drive.

A killed holder blocks nobody: where the file system has locks the operating system releases them;
elsewhere a holder whose process is gone, or that has given no sign of life, counts as dead.
"""

from __future__ import annotations

import errno
import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from threading import Event, Thread
from time import monotonic, sleep
from typing import Self
from uuid import uuid4

__all__ = ["FOLDER_LOCK", "FileLock", "HeldError", "Owner", "folder_held", "is_gone", "this_host"]

# A holder on another computer touches its lock file this often, and is dead when it has not for so
# long: a few missed touches, and the minute for which a network drive may be slow.
_TOUCH_S, _DEAD_S = 20.0, 120.0
_POLL_S = 0.05
# What a file system without locks answers.
_NO_LOCKS = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL, errno.EBADF)
# Windows forbids to read what is locked: the lock lies far beyond the text.
_FAR = 2**30

FOLDER_LOCK = ".pv-inspect.lock"
"""File that stands for the lock of a folder where folders have none."""


@dataclass(frozen=True)
class Owner:
    """Who holds a lock.

    Parameters
    ----------
    pid : int
        0 if it is not known.
    host : str
    since : str
        Local time, ISO 8601.
    token : str
        Tells two holds of one process apart.
    """

    pid: int = 0
    host: str = ""
    since: str = ""
    token: str = ""

    @classmethod
    def now(cls) -> Owner:
        """Name this process, from now on."""
        return cls(os.getpid(), this_host(), datetime.now().isoformat(" ", "seconds"), uuid4().hex)

    def __str__(self) -> str:
        if not self.pid:
            return "its process is not known"
        day, _, time = self.since.partition(" ")
        today = day == datetime.now().date().isoformat()
        return f"process {self.pid} on {self.host}, since {time[:5] if today else self.since[:16]}"


class HeldError(Exception):
    """Somebody else holds the lock.

    Parameters
    ----------
    owner : Owner
    """

    def __init__(self, owner: Owner) -> None:
        super().__init__(str(owner))
        self.owner = owner


class FileLock:
    """An advisory lock with its owner written in it; the file is gone when it is released.

    Parameters
    ----------
    path : Path
        File of the lock; its folder has to exist.

    Notes
    -----
    The operating system's lock decides where there is one (``flock``, on Windows a locked byte).
    Some network drives have none, or one that other computers do not see. So the owner is read as
    well: one on another computer holds the lock as long as it touches the file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._owner = Owner()
        self._handle = -1
        self._released = Event()
        self._toucher: Thread | None = None

    def acquire(self, wait_s: float = 0.0) -> Self:
        """Take the lock.

        Parameters
        ----------
        wait_s : float
            How long to wait for another holder.

        Raises
        ------
        HeldError
            If another one holds it all this time.
        OSError
            If the file can't be made.
        """
        end = monotonic() + wait_s
        while True:
            try:
                if self._try():
                    return self
                continue  # its last holder has just removed it
            except HeldError:
                if monotonic() >= end:
                    raise
            sleep(_POLL_S)

    def release(self) -> None:
        """Give the lock back; nothing happens if it is not held."""
        if self._handle < 0:
            return
        self._released.set()
        if self._toucher is not None:
            self._toucher.join()
            self._toucher = None
        handle, self._handle = self._handle, -1
        mine = read_owner(self.path).token == self._owner.token
        if sys.platform == "win32":  # an open file can't be removed there
            os.close(handle)
            handle = -1
        if mine:
            with suppress(OSError):
                self.path.unlink()
        if handle >= 0:
            os.close(handle)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    @property
    def is_ours(self) -> bool:
        """Whether it is still held; a computer that slept for long may have lost it to another."""
        return self._handle >= 0 and read_owner(self.path).token == self._owner.token

    def _try(self) -> bool:
        token = ""
        handle = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            real = _locked(handle)
            if real is False:
                raise HeldError(_owner_soon(self.path))
            if not _same(handle, self.path):
                os.close(handle)
                return False
            before = read_owner(self.path)
            if before.pid and _may_live(before, self.path, by_system=real is not None):
                raise HeldError(before)
            owner = Owner.now()
            token = owner.token
            os.lseek(handle, 0, os.SEEK_SET)
            os.ftruncate(handle, 0)
            os.write(handle, json.dumps(asdict(owner)).encode())
            os.fsync(handle)
            if real is None:
                sleep(_POLL_S)  # two that came at once: the one that wrote last has it
                if read_owner(self.path).token != owner.token:
                    raise HeldError(read_owner(self.path))
        except BaseException as error:
            if not isinstance(error, HeldError) and read_owner(self.path).token in ("", token):
                with suppress(OSError):  # ours, or made just now and empty
                    self.path.unlink()
            os.close(handle)
            raise
        self._owner, self._handle = owner, handle
        self._released.clear()
        self._toucher = Thread(target=self._touch, name="lock", daemon=True)
        self._toucher.start()
        return True

    def _touch(self) -> None:
        while not self._released.wait(_TOUCH_S):
            with suppress(OSError):
                os.utime(self.path)


@contextmanager
def folder_held(folder: Path, wait_s: float = 10.0) -> Iterator[None]:
    """Hold a folder for the moment in which something in it is changed.

    The lock is on the folder itself: nothing is left by it, and one who waited for it finds out
    that the folder has been replaced in the meantime. Where folders have no locks a file in it
    serves; where nothing can be written, the block runs without.

    Parameters
    ----------
    folder : Path
    wait_s : float
        How long to wait for another holder.

    Raises
    ------
    HeldError
        If another one holds it all this time.
    """
    end = monotonic() + wait_s
    handle, file = -1, None
    try:
        while handle < 0:
            try:
                handle = os.open(folder, os.O_RDONLY)
                got = _locked(handle)
            except OSError:  # no folder, or a system where one can't be opened
                got = None
            if got is None:
                with suppress(OSError):
                    file = FileLock(folder / FOLDER_LOCK).acquire(max(end - monotonic(), 0.0))
                break
            if got and _same(handle, folder):
                break
            os.close(handle)
            handle = -1
            if not got:
                if monotonic() >= end:
                    raise HeldError(Owner())
                sleep(_POLL_S)
        yield
    finally:
        if file is not None:
            file.release()
        if handle >= 0:
            os.close(handle)


def read_owner(path: Path) -> Owner:
    """Owner written in a lock file; unknown if there is none or it can't be read."""
    try:
        with path.open("rb") as file:
            record = json.loads(file.read(4096))
        return Owner(
            int(record["pid"]),
            str(record["host"])[:80],
            str(record["since"])[:40],
            str(record["token"])[:80],
        )
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return Owner()


def this_host() -> str:
    """Name of this computer."""
    if sys.platform == "win32":
        return os.environ.get("COMPUTERNAME", "")
    return os.uname().nodename


def is_gone(pid: int, host: str) -> bool:
    """Whether a process has provably ended."""
    # To ask for a process on Windows would end it.
    if host != this_host() or sys.platform == "win32":
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    except (OSError, OverflowError):
        return False
    return False


def _owner_soon(path: Path) -> Owner:
    """Owner of a lock that is held: it may be writing its name just now."""
    for _ in range(10):
        owner = read_owner(path)
        if owner.pid:
            return owner
        sleep(_POLL_S / 5)
    return Owner()


def _may_live(owner: Owner, path: Path, by_system: bool) -> bool:
    """Whether the one who is written in a lock file that we could open may still hold it."""
    if owner.host == this_host():
        # The system's lock was free: whoever has that number now is another process.
        return not by_system and not is_gone(owner.pid, owner.host)
    return _age_s(path) < _DEAD_S


def _age_s(path: Path) -> float:
    """Seconds since a file was touched, by the clock of its file system."""
    probe = path.with_name(f"{path.name}.{uuid4().hex[:8]}")
    try:
        with probe.open("xb"):
            now = probe.stat().st_mtime
        return now - path.stat().st_mtime
    except OSError:
        return 0.0
    finally:
        with suppress(OSError):
            probe.unlink()


def _same(handle: int, path: Path) -> bool:
    try:
        found, known = path.stat(), os.fstat(handle)
    except OSError:
        return False
    return (found.st_dev, found.st_ino) == (known.st_dev, known.st_ino)


def _locked(handle: int) -> bool | None:
    """Lock an open file without waiting; False: another holds it, None: there are no locks."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(handle, _FAR, os.SEEK_SET)
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if sys.platform != "win32" and error.errno in _NO_LOCKS:
            return None
        if error.errno in (errno.EAGAIN, errno.EACCES, errno.EDEADLK):
            return False
        raise
    return True
