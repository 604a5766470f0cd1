"""Two folders change places in one step of the file system, where it can do that."""

from __future__ import annotations

import ctypes
import errno
import os
import sys
from pathlib import Path

__all__ = ["exchange"]

# <linux/fs.h> and <fcntl.h>; <sys/stdio.h> of macOS.
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2
_RENAME_SWAP = 2
# What a kernel or a file system answers that can't do it.
_UNKNOWN = (errno.ENOSYS, errno.EINVAL, errno.EOPNOTSUPP, errno.ENOTSUP)


def exchange(a: Path, b: Path) -> bool:
    """Let two folders change places; at no moment does either name lead to nothing.

    Parameters
    ----------
    a, b : Path
        On the same file system.

    Returns
    -------
    bool
        False if the system can't do it; then nothing has changed.

    Raises
    ------
    OSError
        If it can and fails.
    """
    names = os.fsencode(a), os.fsencode(b)
    try:
        system = ctypes.CDLL(None, use_errno=True)
        if sys.platform.startswith("linux"):
            failed = system.renameat2(_AT_FDCWD, names[0], _AT_FDCWD, names[1], _RENAME_EXCHANGE)
        elif sys.platform == "darwin":
            failed = system.renamex_np(*names, _RENAME_SWAP)
        else:
            return False
    except (AttributeError, OSError, TypeError):  # a C library that does not have it
        return False
    if not failed:
        return True
    code = ctypes.get_errno()
    if code in _UNKNOWN:
        return False
    raise OSError(code, os.strerror(code), str(a), None, str(b))
