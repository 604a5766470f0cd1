"""Names of files and folders that are being made: each process has its own, with its number."""

from __future__ import annotations

import os
import re
from hashlib import sha256
from pathlib import Path
from time import time
from uuid import uuid4

from pv_inspect.storage.locks import FOLDER_LOCK, is_gone, this_host

__all__ = [
    "MOVING",
    "PARTIAL",
    "PREVIOUS",
    "is_dead",
    "is_temporary",
    "leftovers",
    "lock_of",
    "own",
]

PARTIAL = "partial"
"""It is being written."""
MOVING = "moving"
"""It is whole and changes places with what has the name now; afterwards, what had it."""
PREVIOUS = "previous"
"""It had the name, and makes room for what moves in."""

_KINDS = f"{PARTIAL}|{MOVING}|{PREVIOUS}"
# Earlier versions wrote no process into the names of folders.
_NAME = re.compile(rf"^\.(.+)\.({_KINDS})(?:-(\d+)-[0-9a-f]{{8}}@(.*)|-\d+)?$", re.DOTALL)
# Bytes of a name that leave room for all that is added to it; file systems take 255.
_ROOM = 150
# Nothing of ours is being written for so long: what is older belongs to nobody. It serves where
# the process can't be asked for: on another computer, or when its number was given anew.
_ABANDONED_S = 86400.0


def own(path: Path, kind: str) -> Path:
    """Return a new name beside a path, of this process alone.

    Parameters
    ----------
    path : Path
    kind : str
        `PARTIAL`, `MOVING` or `PREVIOUS`.
    """
    host = re.sub(r"[^A-Za-z0-9.-]", "_", this_host())[:40]
    return path.with_name(f".{_stem(path)}.{kind}-{os.getpid()}-{uuid4().hex[:8]}@{host}")


def lock_of(path: Path) -> Path:
    """Name of the lock beside a path."""
    return path.with_name(f".{_stem(path)}.lock")


def leftovers(path: Path, *kinds: str) -> list[Path]:
    """Return what lies beside a path under names of these kinds, of any process, oldest first."""
    stem = _stem(path)
    found = []
    try:
        names = os.listdir(path.parent)  # noqa: PTH208
    except OSError:
        return []
    for name in names:
        match = _NAME.match(name)
        if match and match[1] == stem and match[2] in kinds:
            found.append(path.with_name(name))
    return sorted(found, key=_changed)


def is_temporary(name: str) -> bool:
    """Whether the name of a file is one of those made here."""
    return name == FOLDER_LOCK or _NAME.match(name) is not None


def is_dead(path: Path) -> bool:
    """Whether the process that made something under such a name works no more on it."""
    match = _NAME.match(path.name)
    if match is None:
        return False
    if match[3] is None:  # of an earlier version
        return True
    host = re.sub(r"[^A-Za-z0-9.-]", "_", this_host())[:40]
    if match[4] == host and is_gone(int(match[3]), this_host()):
        return True
    return time() - _changed(path) > _ABANDONED_S


def _changed(path: Path) -> float:
    try:
        return path.lstat().st_mtime
    except OSError:
        return time()


def _stem(path: Path) -> str:
    name = os.fsencode(path.name)
    if len(name) <= _ROOM:
        return path.name
    short = name[: _ROOM // 2].decode(errors="ignore")
    return f"{short}~{sha256(name).hexdigest()[:16]}"
