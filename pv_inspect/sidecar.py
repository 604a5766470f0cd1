"""``module.json``, the note on the module beside its frames: rows, cols, cell_aspect."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pv_inspect.errors import InspectionError
from pv_inspect.records import json_from, read_text

__all__ = ["read_sidecar"]

_MOST_BYTES = 2**20


def read_sidecar(root: Path, paths: list[Path]) -> dict[str, Any]:
    """Find and read what the user noted about the module beside the frames.

    Parameters
    ----------
    root : Path
        What was opened.
    paths : list of Path
        The image files in it.

    Returns
    -------
    dict
        Those of "rows", "cols" (int) and "cell_aspect" (float) that are given; empty without a
        file.

    Raises
    ------
    InspectionError
        If the file is no JSON object or a value is not what it should be.
    """
    for candidate in _sidecars(root, paths):
        if candidate.is_file():
            return _parse_sidecar(candidate)
    return {}


def _sidecars(root: Path, paths: list[Path]) -> list[Path]:
    folder = paths[0].parent
    found = []
    if root == paths[0] or len(paths) == 1:
        found.append(paths[0].with_suffix(".json"))
    found.append(folder / "module.json")
    if folder.resolve().name == "frames":
        found.append(folder.resolve().parent / "module.json")
    return found


def _parse_sidecar(path: Path) -> dict[str, Any]:
    try:
        content = json_from(read_text(path, _MOST_BYTES))
    except (OSError, ValueError) as error:
        raise InspectionError(
            f"{path} can't be read as JSON ({error}): correct it or remove it."
        ) from None
    if not isinstance(content, dict):
        raise InspectionError(
            f'{path} holds no JSON object: write it like {{"rows": 6, "cols": 10}}.'
        )
    hint: dict[str, Any] = {}
    for key in ("rows", "cols"):
        value = content.get(key)
        if value is None:
            continue
        if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= 200:
            raise InspectionError(
                f"{path}: {key} is {value!r}, but a whole number from 1 to 200 is expected: "
                "correct it."
            )
        hint[key] = value
    aspect = content.get("cell_aspect")
    if aspect is not None:
        number = isinstance(aspect, (int, float)) and not isinstance(aspect, bool)
        if not (number and 0.1 <= aspect <= 10):
            raise InspectionError(
                f"{path}: cell_aspect is {aspect!r}, but cell width / cell height between 0.1 "
                "and 10 is expected: correct it."
            )
        hint["cell_aspect"] = float(aspect)
    return hint
