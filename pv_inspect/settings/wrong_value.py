"""A wrong value of a setting, told in one sentence."""

from __future__ import annotations

from pydantic import ValidationError

from pv_inspect.settings.declaration import DeclaredModel

__all__ = ["sentence_of"]


def sentence_of(error: ValidationError, model: type[DeclaredModel]) -> str:
    """Return one sentence: which setting, what was got, what is expected."""
    first = error.errors()[0]
    name = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        known = ", ".join(model.model_fields)
        return f"There is no setting {name!r}: use one of {known}."
    unit = model.unit_of(name) if name in model.model_fields else ""
    why = f"{first['msg'][0].lower()}{first['msg'][1:]}"
    try:
        found = repr(first["input"])
    except ValueError:  # Python writes out no number of thousands of digits
        found = "a number of thousands of digits"
    return f"Setting {name} is {found} [{unit}]: {why}."
