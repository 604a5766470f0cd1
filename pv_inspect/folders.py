"""Replacing a folder as a whole: after a cut there is the old one or the new one, never a mixture.

The new folder grows beside the old one under a hidden name and is moved into place when every
file of it is on the disk.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path, PurePath

from pv_inspect.errors import InspectionError

__all__ = ["check_replaceable", "recovered", "replace_file", "replace_folder"]

IsOurs = Callable[[PurePath], bool]
_FULL = (errno.ENOSPC, errno.EDQUOT)


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
        If ``out`` is a file, a mount point, a folder that holds things but not the marker, or if
        nothing can be created beside it.
    """
    out = recovered(out)
    if out.exists():
        if not out.is_dir():
            raise InspectionError(f"{out} is a file: give a folder for the result.")
        try:
            names = {entry.name for entry in out.iterdir()}
        except OSError as error:
            raise InspectionError(
                f"{out} can't be read ({error.strerror}): give another folder for the result."
            ) from None
        if names and marker not in names:
            raise InspectionError(
                f"{out} is not empty and holds no earlier result ({marker} is missing): give a "
                "new or empty folder, so that none of your files is touched."
            )
        if out.is_mount():
            raise InspectionError(
                f"{out} is a mount point and can't be replaced as a whole: give a folder inside "
                f"it, for example {out / 'result'}."
            )
    parent = next(p for p in out.parents if p.exists())
    probe = parent / f".{out.name}.probe-{os.getpid()}"
    try:
        probe.mkdir()
        probe.rmdir()
    except OSError as error:
        raise InspectionError(
            f"The result can't be written to {out}: nothing can be created in {parent} "
            f"({error.strerror}); give another folder."
        ) from None
    return out


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
    out = check_replaceable(out, marker)
    partial, previous = _beside(out)
    missing_parents = [parent for parent in out.parents if not parent.exists()]
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        _remove(partial)
        partial.mkdir()
        for name, content in files:
            _write_file(partial / name, content)
        if out.exists():
            _carry_over(out, partial, is_ours)
        _sync_folder(partial)
        _move_into_place(partial, out, previous)
    except BaseException as error:
        shutil.rmtree(partial, ignore_errors=True)
        recovered(out)
        with suppress(OSError):
            for parent in missing_parents:
                parent.rmdir()
        if not isinstance(error, OSError):
            raise
        full = error.errno in _FULL
        reason = "the disk is full" if full else error.strerror or str(error)
        remedy = "free some space or give a folder on another disk" if full else "give another one"
        raise InspectionError(
            f"The result can't be written to {out}: {reason}; {remedy} (nothing was changed there)."
        ) from None


def replace_file(path: Path, content: bytes) -> None:
    """Write one file of an existing folder, as a whole or not at all.

    Raises
    ------
    InspectionError
        If it can't be written; then an earlier one is as it was.
    """
    partial = path.with_name(f".{path.name}.partial-{os.getpid()}")
    try:
        _write_file(partial, content)
        partial.replace(path)
    except OSError as error:
        with suppress(OSError):
            partial.unlink()
        reason = "the disk is full" if error.errno in _FULL else error.strerror or str(error)
        raise InspectionError(
            f"{path} can't be written: {reason}; free some space or allow writing there, and try "
            "again."
        ) from None
    _sync_folder(path.parent)


def recovered(out: Path) -> Path:
    """Return ``out`` without links, the old folder back in place if a replacement was cut.

    Between the two renames of a replacement there is, for an instant, nothing at ``out``.
    """
    out = Path(os.path.realpath(Path(out).expanduser()))
    previous = _beside(out)[1]
    with suppress(OSError):
        if not out.exists() and previous.is_dir():
            previous.rename(out)
    return out


def _beside(out: Path) -> tuple[Path, Path]:
    """Where the new folder grows, and where the old one waits while the new one moves in."""
    return out.with_name(f".{out.name}.partial"), out.with_name(f".{out.name}.previous")


def _move_into_place(partial: Path, out: Path, previous: Path) -> None:
    _remove(previous)
    if out.exists():
        out.rename(previous)
    partial.rename(out)
    _sync_folder(out.parent)
    # The new folder is in place: what can't be removed now is removed by the next run.
    shutil.rmtree(previous, ignore_errors=True)


def _carry_over(old: Path, new: Path, is_ours: IsOurs) -> None:
    """Take over what others (the review, the user) have put into the old folder.

    Hard links where the file system has them: a database that is open stays the same file.
    """
    for path in sorted(old.rglob("*")):
        relative = path.relative_to(old)
        if is_ours(relative):
            continue
        target = new / relative
        if path.is_dir() and not path.is_symlink():
            target.mkdir(parents=True, exist_ok=True)
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.link(path, target, follow_symlinks=False)
        except (OSError, NotImplementedError):
            shutil.copy2(path, target, follow_symlinks=False)


def _write_file(path: Path, content: bytes) -> None:
    """Write and flush to the disk: a full disk is noticed here, not after the rename."""
    path.parent.mkdir(exist_ok=True)
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


def _remove(folder: Path) -> None:
    if folder.is_dir():
        shutil.rmtree(folder)
