"""Settings that are good for more than one module, as TOML files. No Qt."""

from __future__ import annotations

import os
from pathlib import Path

from napari_pv_inspect.tuning import IMAGE_FIELDS
from pv_inspect.errors import InspectionError
from pv_inspect.settings import Settings

__all__ = ["PRESET_FIELDS", "read_preset", "write_preset"]

PRESET_FIELDS = (*IMAGE_FIELDS, "second_look", "max_iterations", "detector", "crack_threshold")
"""Fields of a preset: nothing about one module, its frames or its camera."""


def write_preset(settings: Settings, path: Path) -> None:
    """Write a preset; the file is whole or, if anything fails, as it was.

    Raises
    ------
    InspectionError
        If it can't be written.
    """
    text = settings.to_toml(PRESET_FIELDS)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with partial.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise InspectionError(
            f"{path} can't be written ({error.strerror}): choose another folder or free some space."
        ) from None


def read_preset(path: Path) -> Settings:
    """Read a preset; what it leaves out is automatic or usual.

    Any settings file will do; its fields about a module are not taken over (`PRESET_FIELDS`).

    Raises
    ------
    InspectionError
        If it is no settings file.
    """
    return Settings.from_toml(path)
