"""A form for the settings of one group, in step with the model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from itertools import groupby
from typing import Any

from magicgui.widgets.bases import ValueWidget
from qtpy.QtCore import Qt
from qtpy.QtWidgets import (
    QCheckBox,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from napari_pv_inspect.forms.controls import control_of, label_of, tooltip_of
from napari_pv_inspect.models.workbench import WorkbenchModel
from napari_pv_inspect.widgets.listen import listen
from napari_pv_inspect.widgets.number_field import NumberField
from napari_pv_inspect.widgets.number_slider import NumberSlider
from pv_inspect.settings import Group, Settings

__all__ = ["SettingsForm"]

MORE = "More"
MORE_TIP = "Show or fold the settings that are rarely changed."
SIDE_BY_SIDE = 3


class SettingsForm(QWidget):
    """All controls of a group of settings; those that are rarely changed fold away.

    Parameters
    ----------
    model : WorkbenchModel
    group : Group
    stand_ins : callable, optional
        Returns what counts at present where a setting is on automatic, by its name; None: nobody
        knows it yet.
    on_change : dict, optional
        What is called with a value that the user has given, for settings that take more than
        a change of the settings.
    """

    def __init__(
        self,
        model: WorkbenchModel,
        group: Group,
        stand_ins: Callable[[], Mapping[str, float | None]] = dict,
        on_change: Mapping[str, Callable[[Any], None]] | None = None,
        parent: QWidget | None = None,
    ) -> None:
        super().__init__(parent)
        self._model, self._stand_ins = model, stand_ins
        self._on_change = dict(on_change or {})
        names = [name for name in Settings.names_in(group) if not Settings.declared(name).set_by]
        usual = [name for name in names if not Settings.declared(name).advanced]
        self._rare = [name for name in names if Settings.declared(name).advanced]
        self._controls: dict[str, ValueWidget[Any]] = {}
        column = self._column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(4)
        self._numbers: QGridLayout | None = None
        self._last_line: QHBoxLayout | QGridLayout | None = None
        self._fill(column, usual)
        self.more = QToolButton()
        self._folded = QWidget()
        if self._rare:
            self._add_rare(column)
        listen(model.settings_changed, self._on_settings)
        self._on_settings()

    def __getitem__(self, name: str) -> Any:
        """Return the Qt widget of a setting."""
        return self._controls[name].native

    def value_of(self, name: str) -> Any:
        """Return the value of a setting as its control shows it."""
        return self._controls[name].value

    def beside_numbers(self, widget: QWidget) -> None:
        """Place a widget at the end of the row of numbers."""
        assert self._numbers is not None
        at = self._numbers.columnCount()
        taken = self._numbers.itemAtPosition(1, at - 1) is not None
        self._numbers.addWidget(widget, 1, at if taken else at - 1)

    def place_below(self, name: str, *widgets: QWidget) -> None:
        """Place widgets below the control of a setting that has a line of its own."""
        at = self._column.indexOf(self._controls[name].native)
        for k, widget in enumerate(widgets, start=1):
            self._column.insertWidget(at + k, widget)

    def refresh(self) -> None:
        """Show the settings again: what counts for automatic ones has changed."""
        self._on_settings()

    def _add_rare(self, column: QVBoxLayout) -> None:
        self.more.setCheckable(True)
        self.more.setAutoRaise(True)
        self.more.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
        inside = QVBoxLayout(self._folded)
        inside.setContentsMargins(0, 0, 0, 0)
        inside.setSpacing(4)
        # A line of its own would make the page scroll on small screens.
        if isinstance(self._last_line, QGridLayout):
            self._last_line.addWidget(self.more, 0, self._last_line.columnCount())
        else:
            (self._last_line or column).addWidget(self.more)
        self._fill(inside, self._rare)
        column.addWidget(self._folded)
        self.more.toggled.connect(self._on_fold)
        self._on_fold(False)

    def _fill(self, column: QVBoxLayout, names: list[str]) -> None:
        """Place controls one below the other, several plain numbers side by side."""
        for name in names:
            control = self._controls[name] = control_of(name)
            control.changed.connect(partial(self._on_value, name))
        for plain, some in groupby(names, lambda name: isinstance(self[name], NumberField)):
            run = list(some)
            if plain and len(run) > 1:
                self._add_numbers(column, run)
                continue
            for name in run:
                self._add_line(column, name)

    def _add_numbers(self, column: QVBoxLayout, names: list[str]) -> None:
        for start in range(0, len(names), SIDE_BY_SIDE):
            grid = QGridLayout()
            for at, name in enumerate(names[start : start + SIDE_BY_SIDE]):
                grid.addWidget(_label(name, self[name]), 0, at)
                grid.addWidget(self[name], 1, at)
            column.addLayout(grid)
            self._numbers = self._numbers or grid
            self._last_line = grid

    def _add_line(self, column: QVBoxLayout, name: str) -> None:
        control = self._controls[name]
        if isinstance(control.native, NumberSlider):  # has its title itself
            column.addWidget(control.native)
            self._last_line = None
            return
        line = QHBoxLayout()
        if not isinstance(control.native, QCheckBox):
            line.addWidget(_label(name, control.native))
        line.addWidget(control.native, 1)
        column.addLayout(line)
        self._last_line = line

    def _on_value(self, name: str, value: Any) -> None:
        change = self._on_change.get(name)
        if change is not None:
            change(value)
        else:
            self._model.change_settings(**{name: value})
        if getattr(self._model.settings, name) != value:  # it was refused
            self._on_settings()

    def _on_settings(self, _: Settings | None = None) -> None:
        settings, stand_ins = self._model.settings, self._stand_ins()
        for name, control in self._controls.items():
            value = getattr(settings, name)
            if control.value != value:
                with control.changed.blocked():
                    control.value = value
            if value is None and isinstance(control.native, NumberSlider):
                control.native.show_number(stand_ins.get(name))
        usual = Settings()
        changed = sum(getattr(settings, name) != getattr(usual, name) for name in self._rare)
        self.more.setText(f"{MORE} ({changed})" if changed else MORE)
        self.more.setToolTip(MORE_TIP + (f" {changed} differ from the default." if changed else ""))

    def _on_fold(self, shown: bool) -> None:
        self._folded.setVisible(shown)
        self.more.setArrowType(Qt.ArrowType.DownArrow if shown else Qt.ArrowType.RightArrow)


def _label(name: str, control: QWidget) -> QLabel:
    label = QLabel(label_of(name))
    label.setBuddy(control)
    label.setToolTip(tooltip_of(name))
    return label
