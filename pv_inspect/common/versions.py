"""Versions of what a result depends on."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

from pv_inspect._version import __version__

__all__ = ["versions"]

_PACKAGES = ("numpy", "scipy", "opencv-python-headless", "numba", "scikit-image", "tifffile")


def versions() -> dict[str, str]:
    """Return name and version of pv-inspect, Python and the packages that compute."""
    found = {"pv-inspect": __version__, "python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # another build of the same package, under another name
            continue
    return found
