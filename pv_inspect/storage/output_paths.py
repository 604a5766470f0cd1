"""Where an output may go: what is wrong with a place is told before the work begins."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

from pv_inspect.errors import InspectionError

__all__ = ["FULL", "cant_write", "check_not_inside", "output_folder", "shown"]

FULL = (errno.ENOSPC, errno.EDQUOT)
"""Errors of a disk, or a share of it, that is full."""
_DENIED = (errno.EACCES, errno.EPERM, errno.EROFS)
_SHOWN = 160


def output_folder(out: Path, replaced: bool = False) -> Path:
    """Return the place of an output folder without links.

    Parameters
    ----------
    out : Path
        There may be nothing yet.
    replaced : bool
        The folder is going to be replaced as a whole.

    Returns
    -------
    Path
        Absolute.

    Raises
    ------
    InspectionError
        If no folder can be there: a file, a link that leads nowhere, the root, a name that is too
        long; or, if it is replaced, the current folder.
    """
    try:
        given = Path.cwd() / Path(out).expanduser()
        for path in (*reversed(given.parents), given):
            _check_step(path, given)
        found = Path(os.path.realpath(given))
    except RuntimeError:
        raise InspectionError(
            f"{shown(out)} begins with ~, but no such home folder is known: write the whole path."
        ) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InspectionError(
            f"{shown(out)} can't be a folder ({reason}): give another one for the result."
        ) from None
    if found == Path(found.anchor):
        raise InspectionError(
            f"{found} is the root of the file system: give a folder in it for the result, for "
            f"example {found / 'result'}."
        )
    if replaced and found in (Path.cwd(), *Path.cwd().parents):
        raise InspectionError(
            f"{shown(found)} is the current folder or holds it, and a result replaces its folder "
            "as a whole: give a folder in it, for example ./result."
        )
    return found


def check_not_inside(out: Path, given: Path, what: str) -> None:
    """Refuse to replace a folder that what is read lies in.

    Raises
    ------
    InspectionError
        If ``given`` is ``out`` or in it.
    """
    place, source = Path(os.path.realpath(out)), Path(os.path.realpath(given))
    if place == source or place in source.parents:
        raise InspectionError(
            f"{what} in {shown(source)} would be replaced together with {shown(place)}: give "
            "another folder with --out."
        )


def cant_write(out: Path, folder: Path, error: OSError) -> InspectionError:
    """One sentence about why nothing can be created in a folder.

    Parameters
    ----------
    out : Path
        What was to be written.
    folder : Path
        Where creating something failed.
    error : OSError
    """
    if error.errno in FULL:
        reason, remedy = "the disk is full", "free some space or give a folder on another disk"
    elif error.errno in _DENIED:
        reason = f"{shown(folder)} is read-only ({error.strerror})"
        remedy = "allow writing there or give another folder"
    else:
        reason = f"nothing can be created in {shown(folder)} ({error.strerror or error})"
        remedy = "give another folder"
    return InspectionError(f"The result can't be written to {shown(out)}: {reason}; {remedy}.")


def shown(path: Path) -> str:
    """Return a path as it is told to a person: the middle of a very long one is left out."""
    text = str(path)
    half = _SHOWN // 2
    return text if len(text) <= _SHOWN else f"{text[: half - 3]}...{text[-half:]}"


def _check_step(path: Path, given: Path) -> None:
    """Check a folder on the way to the output, or the output itself."""
    try:
        found = path.stat()
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise InspectionError(
                f"{shown(path)} is a link that leads back to itself: remove it or give another "
                "folder for the result."
            ) from None
        if error.errno in (errno.ENOENT, errno.ENOTDIR):
            if path.is_symlink():
                raise InspectionError(
                    f"{shown(path)} is a link to {shown(path.readlink())}, which does not exist: "
                    "make that folder or give another one for the result."
                ) from None
            return
        raise
    if stat.S_ISDIR(found.st_mode):
        return
    if path == given:
        raise InspectionError(f"{shown(path)} is a file: give a folder for the result.")
    raise InspectionError(
        f"{shown(path)} is a file, so that there can't be a folder {shown(given)}: give another "
        "folder for the result."
    )
