"""A folder of three small files that have to agree; loads nothing but what writes it."""

from __future__ import annotations

from pathlib import Path, PurePath

from pv_inspect.storage.folders import replace_folder

MARKER = "result.json"
NAMES = ("a.tif", "b.tif", MARKER)


def is_ours(path: PurePath) -> bool:
    return str(path) in NAMES


def fill(out: Path, text: str) -> None:
    replace_folder(out, [(name, text.encode()) for name in NAMES], MARKER, is_ours)


def whole(out: Path) -> str:
    """What all files of ours say; they have to say the same."""
    said = {(out / name).read_text() for name in NAMES}
    assert len(said) == 1, said
    return said.pop()


def names_in(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}
