"""``module.json``, the note on the module beside its frames: rows, cols, aspect, gaps."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from pv_inspect.common.gap_text import checked_gaps, checked_sizes
from pv_inspect.common.records import json_from, read_text
from pv_inspect.errors import InspectionError
from pv_inspect.image_files.problems import ImageFileError
from pv_inspect.image_files.regular import file_state

__all__ = ["read_sidecar"]

# A note of three numbers and some remarks.
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
        Those of "rows", "cols" (int), "cell_aspect", "cell_gap" (float), "row_gaps", "col_gaps",
        "row_heights" and "col_widths" (str, see `pv_inspect.common.gap_text`) that are given;
        empty without a file.

    Raises
    ------
    InspectionError
        If the file can't be read, is no JSON object, or a value is not what it should be.
    """
    for candidate in _sidecars(root, paths):
        if os.path.lexists(candidate):
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
        file_state(path)
        content = json_from(read_text(path, _MOST_BYTES))
    except ImageFileError as problem:
        raise InspectionError(f"{path} {problem}") from None
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
                f"{path}: {key} is {_shown(value)}, but a whole number from 1 to 200 is expected: "
                "correct it."
            )
        hint[key] = value
    aspect = content.get("cell_aspect")
    if aspect is not None:
        number = isinstance(aspect, (int, float)) and not isinstance(aspect, bool)
        if not (number and 0.1 <= aspect <= 10):
            raise InspectionError(
                f"{path}: cell_aspect is {_shown(aspect)}, but cell width / cell height between "
                "0.1 and 10 is expected: correct it."
            )
        hint["cell_aspect"] = float(aspect)
    gap = content.get("cell_gap")
    if gap is not None:
        number = isinstance(gap, (int, float)) and not isinstance(gap, bool)
        if not (number and 0 <= gap <= 0.5):
            raise InspectionError(
                f"{path}: cell_gap is {_shown(gap)}, but the width of the gap between all cells is "
                "expected, 0 to 0.5 cell widths: correct it."
            )
        hint["cell_gap"] = float(gap)
    for key in ("row_gaps", "col_gaps", "row_heights", "col_widths"):
        if content.get(key) is not None:
            hint[key] = _pairs(path, key, content[key])
    return hint


def _pairs(path: Path, key: str, value: object) -> str:
    """Wide gaps, or widths of cells, written "10:0.1" or {"10": 0.1}."""
    if isinstance(value, dict):
        value = ", ".join(f"{after}:{width}" for after, width in value.items())
    try:
        if not isinstance(value, str):
            what = "gaps" if key.endswith("gaps") else "widths"
            raise ValueError(f'{_shown(value)} is no list of {what}: write it like {{"10": 0.1}}')
        return checked_gaps(value) if key.endswith("gaps") else checked_sizes(value)
    except ValueError as error:
        raise InspectionError(f"{path}: {key}: {error}.") from None


def _shown(value: object) -> str:
    """Show a wrong value, whatever it is, in a few characters."""
    try:
        text = repr(value)
    except RecursionError:
        return f"a {type(value).__name__}"
    return text if len(text) <= 60 else f"{text[:50]} ..."
