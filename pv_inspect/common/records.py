"""JSON files of this program and of others, read with limits and checked against a model.

Whatever is wrong ends in one sentence that names the file and the field.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

__all__ = [
    "Flag",
    "Matrix3",
    "Number",
    "Pair",
    "Place",
    "Record",
    "StoredRecord",
    "Text",
    "Whole",
    "checked",
    "json_from",
    "read_text",
]

# Geometry and results of 300 frames of 12 x 24 cells have 30 MB.
MOST_BYTES = 2**27
# Every value, list and object takes some ten bytes of text and about a hundred of memory.
_MOST_VALUES = 8_000_000
_LONGEST_NUMBER = 40

Number = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e15, le=1e15)]
Whole = Annotated[int, Field(strict=True, ge=0, le=10**9)]
Text = Annotated[str, Field(strict=True, max_length=10_000)]
Flag = Annotated[bool, Field(strict=True)]
Pair = tuple[Number, Number]
Matrix3 = tuple[tuple[Number, Number, Number], tuple[Number, Number, Number],
                tuple[Number, Number, Number]]  # fmt: skip
# Of a row or column of cells, from 0.
Place = Annotated[int, Field(strict=True, ge=0, le=9999)]


class Record(BaseModel):
    """What a file holds; entries that this version does not know are left alone."""

    model_config = ConfigDict(frozen=True, extra="ignore")


class StoredRecord(Record):
    """What this program keeps in a file of its own, with the number of the file's format."""

    newest_format: ClassVar[int] = 1

    format: Annotated[int, Field(strict=True, ge=1)] = 1

    @field_validator("format")
    @classmethod
    def _known(cls, value: int) -> int:
        if value > cls.newest_format:
            raise ValueError(
                f"it was written by a newer version of pv-inspect (format {value}, this one knows "
                f"{cls.newest_format})"
            )
        return value


# What PowerShell writes begins with one of them.
_UTF_16_MARKS = (b"\xff\xfe", b"\xfe\xff")
_Model = TypeVar("_Model", bound=Record)


def read_text(path: Path, most_bytes: int = MOST_BYTES) -> str:
    """Read a text file that somebody else may have made.

    Raises
    ------
    OSError
        If it can't be read.
    ValueError
        If it is no regular file, too large, or no text.
    """
    if path.exists() and not path.is_file():
        raise ValueError("it is no file")
    if (size := path.stat().st_size) > most_bytes:
        raise ValueError(f"it has {size} bytes, at most {most_bytes} are expected")
    with path.open("rb") as file:
        wide = file.read(2) in _UTF_16_MARKS
    try:
        return path.read_text(encoding="utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError:
        # A binary file may begin with a mark of UTF-16 by chance: both that are read are named.
        raise ValueError("it is no text in UTF-8 or UTF-16") from None


def json_from(text: str) -> Any:
    """Parse JSON as the standard has it: finite numbers, no name twice, no endless nesting.

    Raises
    ------
    ValueError
        One clause that says what is wrong.

    >>> json_from('{"a": 1, "a": 2}')
    Traceback (most recent call last):
    ...
    ValueError: it holds 'a' twice
    """
    if sum(map(text.count, ",[{")) > _MOST_VALUES:
        raise ValueError("it holds more values than any of ours")
    try:
        return json.loads(
            text,
            parse_int=_whole,
            parse_float=_number,
            parse_constant=_no_number,
            object_pairs_hook=_unique,
        )
    except json.JSONDecodeError as error:
        raise ValueError(f"it is no JSON: {error}") from None
    except RecursionError:
        raise ValueError("its lists lie too deep within each other") from None


def checked(model: type[_Model], content: Any) -> _Model:
    """Check what a file holds.

    Raises
    ------
    ValueError
        One clause that names the field, what it holds and what is expected.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise ValueError(_clause(error)) from None


def _clause(error: ValidationError) -> str:
    first = error.errors(include_url=False, include_context=False)[0]
    field = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in first["loc"])
    field = field.lstrip(".") or "the whole"
    if first["type"] == "missing":
        return f"{field} is missing"
    found = repr(first["input"])
    found = found if len(found) <= 40 else f"{found[:37]}..."
    why = first["msg"].removeprefix("Value error, ").removeprefix("Input ")
    return f"{field} is {found}: it {why}"


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"it holds {twice[:40]!r} twice")
    return found


def _whole(text: str) -> int:
    if len(text) > _LONGEST_NUMBER:
        raise ValueError(f"it holds a number of {len(text)} digits")
    return int(text)


def _number(text: str) -> float:
    value = float(text)
    if value in (float("inf"), float("-inf")):
        raise ValueError(f"it holds {text[:20]}, which is beyond any number")
    return value


def _no_number(text: str) -> float:
    raise ValueError(f"it holds {text}, which is no number")
