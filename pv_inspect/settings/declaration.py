"""How a setting is declared, once for the command line, the workbench and the documentation."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Self, Union, get_args, get_origin

from pydantic import BaseModel, Field, TypeAdapter

from pv_inspect.settings.stages import Stage

__all__ = ["Declaration", "DeclaredModel", "Group", "tunable"]


class Group(StrEnum):
    """The forms of the workbench; each shows the settings that belong together."""

    FRAMES = "Frames"
    MODULE = "Module"
    LENS = "Lens"
    IMAGE = "Module image"
    CRACKS = "Cracks"


@dataclass(frozen=True)
class Declaration:
    """What is declared of a setting, beside its type, default, limits and description.

    Parameters
    ----------
    stage : Stage
        The first stage that has to run again when it changes.
    group : Group
        The form of the workbench that shows it.
    title : str
        Its name for people, a few words; as within a sentence.
    unit : str
    option : tuple of str
        How the command line spells it, if not by its name with hyphens.
    slider : tuple of float, optional
        The usual values; a slider over them is shown if they are given.
    logarithmic : bool
        Equal ways of the slider are equal ratios.
    decimals : int
        As the workbench shows a number.
    automatic : str
        One word for how its value is found if it is not given; only if it need not be given.
    choices : dict
        Of the values of a choice: a few words, and what it means. A choice of two whose second has
        no words is shown as a mark beside the words of the first.
    files : str
        Which files it may be, as dialogs for files spell it: ``"Images (*.tif *.png)"``.
    advanced : bool
        Rarely changed: the form shows it when asked for more.
    live : bool
        The preview of a cell shows its effect.
    set_by : str
        What sets it in the workbench instead of a control in the form; "" if there is a control.
    """

    stage: Stage
    group: Group
    title: str
    unit: str = "1"
    option: tuple[str, ...] = ()
    slider: tuple[float, float] | None = None
    logarithmic: bool = False
    decimals: int = 2
    automatic: str = "automatic"
    choices: dict[str, tuple[str, str]] = field(default_factory=dict)
    files: str = ""
    advanced: bool = False
    live: bool = False
    set_by: str = ""


_FORM = TypeAdapter(Declaration)


def tunable(default: Any, declared: Declaration, description: str, **limits: Any) -> Any:
    """Declare a setting.

    Parameters
    ----------
    default : object
    declared : Declaration
    description : str
        What it means, in sentences.
    **limits
        ``ge``, ``gt``, ``le`` of `pydantic.Field`.
    """
    extra = _FORM.dump_python(declared, mode="json")
    return Field(default, description=description, json_schema_extra=extra, **limits)


class DeclaredModel(BaseModel):
    """A model whose fields are declared with `tunable`, and what their declarations say."""

    @classmethod
    def declared(cls, name: str) -> Declaration:
        """Return what is declared of a setting."""
        return _declared(cls, name)

    @classmethod
    def names_in(cls, group: Group) -> tuple[str, ...]:
        """Return the settings of a form, in the order of their declaration."""
        return tuple(name for name in cls.model_fields if cls.declared(name).group is group)

    @classmethod
    def kind_of(cls, name: str) -> tuple[Any, bool]:
        """Return the plain type of a setting, and whether it need not be given."""
        kind, optional = cls.model_fields[name].annotation, False
        if get_origin(kind) in (Union, UnionType):
            optional = NoneType in get_args(kind)
            (kind,) = (one for one in get_args(kind) if one is not NoneType)
        return _without_limits(kind), optional

    @classmethod
    def choices_of(cls, name: str) -> tuple[str, ...]:
        """Return the values of a setting that is a choice, else nothing."""
        kind, _ = cls.kind_of(name)
        return get_args(kind) if get_origin(kind) is Literal else ()

    @classmethod
    def unit_of(cls, name: str) -> str:
        """Unit of a setting, for labels and tooltips."""
        return cls.declared(name).unit

    @classmethod
    def options_of(cls, name: str) -> tuple[str, ...]:
        """How the command line spells a setting."""
        spelled = cls.declared(name).option
        long = any(text.startswith("--") for text in spelled)
        return spelled if long else (f"--{name.replace('_', '-')}", *spelled)

    @classmethod
    def limits_of(cls, name: str) -> tuple[float | None, float | None]:
        """Least and largest value of a setting, None where there is no limit."""
        limits = {
            kind: float(getattr(limit, kind))
            for limit in cls.model_fields[name].metadata
            for kind in ("ge", "gt", "le")
            if hasattr(limit, kind)
        }
        return limits.get("ge", limits.get("gt")), limits.get("le")

    @classmethod
    def slider_of(cls, name: str) -> tuple[float, float]:
        """Return the values that a slider of this setting spans.

        Raises
        ------
        ValueError
            If the setting has neither usual values nor limits.
        """
        low, high = cls.declared(name).slider or cls.limits_of(name)
        if low is None or high is None:
            raise ValueError(f"{name} has no range")
        return low, high

    @classmethod
    def stage_of(cls, name: str) -> Stage:
        """Return the first stage that a change of this setting makes stale."""
        return cls.declared(name).stage

    def first_stale_stage(self, other: Self) -> Stage | None:
        """Return the first stage that has to run again to get from ``self`` to ``other``."""
        stages = [
            self.stage_of(name)
            for name in type(self).model_fields
            if getattr(self, name) != getattr(other, name)
        ]
        return min(stages, key=lambda stage: stage.index, default=None)


@cache
def _declared(model: type[DeclaredModel], name: str) -> Declaration:
    return _FORM.validate_python(model.model_fields[name].json_schema_extra)


def _without_limits(kind: Any) -> Any:
    if get_origin(kind) is Annotated:
        return get_args(kind)[0]
    if get_origin(kind) is tuple:
        return tuple[tuple(_without_limits(one) for one in get_args(kind))]  # type: ignore[misc]
    return kind
