"""The order of names that a person expects: frame_2 before frame_10."""

from __future__ import annotations

import re

__all__ = ["natural_key"]


def natural_key(name: str) -> list[tuple[int, int | str]]:
    """Sort key that puts frame_2 before frame_10.

    >>> sorted(["frame_10.tif", "frame_2.tif"], key=natural_key)
    ['frame_2.tif', 'frame_10.tif']
    """
    parts = re.split(r"(\d+)", name.casefold())
    return [(0, int(p)) if p.isdecimal() else (1, p) for p in parts]
