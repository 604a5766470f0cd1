"""Settings as TOML text, and what is wrong with a file of them in one sentence."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pv_inspect.common.records import read_text
from pv_inspect.errors import InspectionError

__all__ = ["read_toml", "toml_text"]

# Settings are a few kilobytes; what is given by mistake must not fill the memory.
_LARGEST_FILE_BYTES = 2**20


def read_toml(path: Path, most_bytes: int = _LARGEST_FILE_BYTES) -> dict[str, Any]:
    """Read the values of a TOML file; nothing is known yet about their names.

    Parameters
    ----------
    path : Path
    most_bytes : int
        A larger file is refused.

    Raises
    ------
    InspectionError
        If the file can't be read or is no TOML.
    """
    try:
        text = read_text(path, most_bytes)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InspectionError(
            f"{path} can't be read ({reason}): give an existing settings file."
        ) from None
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InspectionError(
            f"{path} is nested too deep, but settings are plain lines like rows = 6: give a "
            "TOML file of settings."
        ) from None
    except ValueError as error:  # also from numbers that are too long
        raise InspectionError(f"{path} is not valid TOML ({error}): correct that line.") from None


def toml_text(values: Mapping[str, Any]) -> str:
    """Return JSON values, of which none is null, as TOML."""
    lines = []
    for name, value in values.items():
        # JSON strings and lists of them are TOML as well.
        text = json.dumps(value) if isinstance(value, str | list | bool) else repr(value)
        lines.append(f"{name} = {text}")
    return "\n".join(lines) + "\n"
