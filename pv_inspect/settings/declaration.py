"""How a setting is declared, once for the command line, the workbench and the documentation."""

from __future__ import annotations

from typing import Any

from pydantic import Field
from pydantic.config import JsonDict

from pv_inspect.settings.stages import Stage

__all__ = ["tunable"]


def tunable(
    default: Any,
    stage: Stage,
    unit: str,
    description: str,
    *,
    option: tuple[str, ...] = (),
    slider: tuple[float, float] | None = None,
    **limits: Any,
) -> Any:
    """Declare a setting, once for the command line, the workbench and the documentation.

    Parameters
    ----------
    default : object
    stage : Stage
        The first stage that has to run again when it changes.
    unit, description : str
    option : tuple of str
        How the command line spells it, if not by its name with hyphens.
    slider : tuple of float, optional
        The usual values, which a slider spans; the limits if not given.
    **limits
        ``ge``, ``gt``, ``le`` of `pydantic.Field`.
    """
    extra: JsonDict = {"stage": stage.value, "unit": unit, "option": list(option)}
    if slider is not None:
        extra["slider"] = list(slider)
    return Field(default, description=description, json_schema_extra=extra, **limits)
