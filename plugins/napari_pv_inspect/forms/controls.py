"""The control of each setting, chosen by magicgui from its type and made as it is declared."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from magicgui.type_map import TypeMap
from magicgui.widgets import CheckBox, ComboBox
from magicgui.widgets.bases import ValueWidget
from qtpy.QtCore import Qt
from qtpy.QtWidgets import QComboBox

from napari_pv_inspect.forms.native import NativeWidget
from napari_pv_inspect.widgets.choice_mark import ChoiceMark
from napari_pv_inspect.widgets.file_field import FileField
from napari_pv_inspect.widgets.number_field import NumberField
from napari_pv_inspect.widgets.number_slider import NumberSlider
from napari_pv_inspect.widgets.text_field import NumbersField, TextField
from napari_pv_inspect.widgets.three_way import ThreeWay as ThreeWayBox
from pv_inspect.settings import Settings, Stage

__all__ = ["control_of", "label_of", "tooltip_of"]

# Units that say no more than the title does.
_WORDS = ("1", "cells", "frames", "file", "name", "probability", "noise units")


def label_of(name: str) -> str:
    """Title of a setting with its unit, as it stands beside the control."""
    title, unit = Settings.declared(name).title, Settings.unit_of(name)
    return f"{title[0].upper()}{title[1:]}" + ("" if unit in _WORDS else f", {unit}")


def tooltip_of(name: str) -> str:
    """What a setting means and its unit, as Settings declares them."""
    description = Settings.model_fields[name].description or name
    return f"{description} Unit: {Settings.unit_of(name)}."


class NumberControl(NativeWidget):
    """A number: with a slider if one is declared, with a mark or a word for automatic."""

    def __init__(self, name: str, **kwargs: Any) -> None:
        declared, (kind, optional) = Settings.declared(name), Settings.kind_of(name)
        automatic = declared.automatic if optional else ""
        limits = Settings.limits_of(name)
        if declared.slider is not None:
            build = partial(
                NumberSlider,
                label_of(name),
                declared.slider,
                limits,
                declared.decimals,
                declared.logarithmic,
                automatic,
            )
            super().__init__(build, name=name, **kwargs)
        else:
            decimals = 0 if kind is int else declared.decimals
            field = partial(NumberField, limits, decimals, automatic)
            super().__init__(field, "given", "show_given", name=name, **kwargs)


class FileControl(NativeWidget):
    """A file that may be none."""

    def __init__(self, name: str, **kwargs: Any) -> None:
        declared = Settings.declared(name)
        effect = " The frames are then read again." if declared.stage is Stage.LOAD else ""
        build = partial(
            FileField,
            label_of(name),
            declared.files,
            declared.automatic,
            f"{tooltip_of(name)}{effect}",
            f"Use none.{effect}",
        )
        super().__init__(build, name=name, **kwargs)


class TextControl(NativeWidget):
    """A text that may be left out."""

    def __init__(self, name: str, **kwargs: Any) -> None:
        super().__init__(partial(TextField, Settings.declared(name).automatic), name=name, **kwargs)


class PointControl(NativeWidget):
    """Two numbers that may be left out."""

    def __init__(self, name: str, **kwargs: Any) -> None:
        word = f"x, y: {Settings.declared(name).automatic}"
        super().__init__(partial(NumbersField, word), name=name, **kwargs)


class Mark:
    """Type of a choice of two that is shown as a mark."""


class MarkControl(NativeWidget):
    """A choice of two as a mark: the first if it is set."""

    def __init__(self, name: str, **kwargs: Any) -> None:
        (on, (words, _)), (off, _) = Settings.declared(name).choices.items()
        super().__init__(partial(ChoiceMark, words, on, off), name=name, **kwargs)


class ThreeWay:
    """Type of a yes or no that may be left to what is found."""


class ThreeWayControl(NativeWidget):
    """Yes, no, or as it is found."""

    def __init__(self, name: str, **kwargs: Any) -> None:
        declared = Settings.declared(name)
        yes, no = declared.choices.values()
        super().__init__(partial(ThreeWayBox, declared.automatic, yes, no), name=name, **kwargs)


# A map of our own: what other plugins make of these types is theirs.
_TYPES = TypeMap()
# Before int: a flag is one to Python.
_TYPES.register_type(bool, widget_type=CheckBox)
_TYPES.register_type(float, widget_type=NumberControl)
_TYPES.register_type(int, widget_type=NumberControl)
_TYPES.register_type(Path, widget_type=FileControl)
_TYPES.register_type(str, widget_type=TextControl)
_TYPES.register_type(Mark, widget_type=MarkControl)
_TYPES.register_type(ThreeWay, widget_type=ThreeWayControl)
_TYPES.register_type(tuple[float, float], widget_type=PointControl)


def control_of(name: str) -> ValueWidget[Any]:
    """Build the control of a setting.

    Returns
    -------
    ValueWidget
        Its ``value`` is that of the setting, None for automatic; ``changed`` tells of the user's
        changes and, as usual with magicgui, of those by program.
    """
    declared, (kind, optional) = Settings.declared(name), Settings.kind_of(name)
    options: dict[str, Any] = {"tooltip": tooltip_of(name)}
    words = [text for text, _ in declared.choices.values()]
    if kind is bool and optional:
        kind = ThreeWay
    elif len(words) == 2 and not words[1]:
        kind = Mark
    elif words:
        options["choices"] = [(text, value) for value, (text, _) in declared.choices.items()]
    control = _TYPES.create_widget(
        value=Settings.model_fields[name].default,
        annotation=kind | None if optional else kind,
        name=name,
        label=label_of(name),
        options=options,
    )
    assert isinstance(control, ValueWidget)
    control.native.setObjectName(name)
    if isinstance(control, ComboBox):
        _finish_choice(control.native, name)
    elif not isinstance(control, CheckBox):
        control.native.setAccessibleName(label_of(name))
    return control


def _finish_choice(box: QComboBox, name: str) -> None:
    """Say what every choice means, and let the box be narrow."""
    box.setAccessibleName(label_of(name))
    box.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
    box.setMinimumContentsLength(12)
    for k, (_, meaning) in enumerate(Settings.declared(name).choices.values()):
        box.setItemData(k, meaning, Qt.ItemDataRole.ToolTipRole)
