"""Files of weights that lie in installed packages, found without importing those packages."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, files
from pathlib import Path

from pv_inspect.errors import InspectionError

__all__ = ["file_of_package"]


def file_of_package(package: str, file: str, install: str) -> Path:
    """Return where a file of an installed package lies.

    Parameters
    ----------
    package : str
        As pip knows it.
    file : str
        Its path below the folder of all packages, with slashes.
    install : str
        The command that installs the package.

    Raises
    ------
    InspectionError
        If the package is not installed or has no such file.
    """
    try:
        known = files(package)
    except PackageNotFoundError:
        raise InspectionError(
            f"The weights are in the package {package}, which is not installed: {install}."
        ) from None
    for entry in known or ():
        path = Path(str(entry.locate()))
        if entry.as_posix() == file and path.is_file():
            return path
    raise InspectionError(
        f"The package {package} is installed, but without {file}; another version may have it: "
        f"{install}."
    )
