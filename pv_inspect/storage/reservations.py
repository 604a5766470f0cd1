"""Who may write to an output: one process at a time, and the others are told who it is."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from time import monotonic, sleep

from pv_inspect.common.signals import held_back
from pv_inspect.errors import InspectionError
from pv_inspect.storage.locks import FileLock, HeldError, folder_held
from pv_inspect.storage.output_paths import cant_write, output_folder, shown
from pv_inspect.storage.temporaries import PARTIAL, is_dead

__all__ = ["changing", "locked_output", "reserved_files"]

_POLL_S = 0.05
_TRIES = 20


@contextmanager
def locked_output(out: Path, path: Path, wait_s: float) -> Iterator[FileLock]:
    """Hold the lock of an output; its folder is made, and removed at the end if it is empty.

    Parameters
    ----------
    out : Path
        What is going to be written.
    path : Path
        File of the lock.
    wait_s : float
        How long to wait for another process.

    Raises
    ------
    InspectionError
        If another process holds it, or it can't be made.
    """
    lock, end = FileLock(path), monotonic() + wait_s
    made = [folder for folder in (path.parent, *path.parent.parents) if not folder.exists()]
    tries = 0
    with ExitStack() as stack:
        stack.callback(_remove_empty, made)
        while True:
            try:
                with held_back():
                    path.parent.mkdir(parents=True, exist_ok=True)
                    lock.acquire()
                    stack.callback(_release, lock)
                break
            except HeldError as error:
                if monotonic() >= end:
                    raise InspectionError(
                        f"Another pv-inspect ({error.owner}) is writing to {shown(out)}: wait "
                        "until it is done or give another folder."
                    ) from None
                sleep(_POLL_S)
            except OSError as error:
                tries += 1
                # Another one may have removed the empty folder just now.
                if not isinstance(error, FileNotFoundError) or tries > _TRIES:
                    parent = next(p for p in path.parents if p.exists())
                    raise cant_write(out, parent, error) from None
        yield lock


@contextmanager
def reserved_files(out: Path) -> Iterator[Path]:
    """Make a folder whose files are written one by one, and keep other processes out of it.

    Yields
    ------
    Path
        ``out`` without links; it is removed at the end if nothing was written into it.

    Raises
    ------
    InspectionError
        If no folder can be there, it is read-only, or another process is writing there.
    """
    out = output_folder(out)
    with locked_output(out, out / ".pv-inspect.run.lock", 0.0):
        for left in out.glob(f".*.{PARTIAL}-*"):
            if is_dead(left):
                with suppress(OSError):
                    left.unlink()
        yield out


@contextmanager
def changing(folder: Path) -> Iterator[None]:
    """Hold a folder while files in it are read and replaced; it is not replaced in the meantime.

    Raises
    ------
    InspectionError
        If another process holds it for long.
    """
    with ExitStack() as stack:
        try:
            stack.enter_context(folder_held(folder))
        except HeldError:
            raise InspectionError(
                f"Another pv-inspect is writing into {shown(folder)}: try again in a moment."
            ) from None
        yield


def _release(lock: FileLock) -> None:
    with held_back():
        lock.release()


def _remove_empty(folders: list[Path]) -> None:
    with suppress(OSError):
        for folder in folders:
            folder.rmdir()
