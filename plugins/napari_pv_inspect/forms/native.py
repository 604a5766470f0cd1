"""A value widget of magicgui around a Qt widget of ours.

The one place that knows how magicgui's Qt backend is built; seen with magicgui 0.10.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from magicgui.backends._qtpy.widgets import QBaseValueWidget
from magicgui.widgets.bases import ValueWidget
from qtpy.QtWidgets import QWidget

__all__ = ["NativeWidget"]


class _Backend(QBaseValueWidget):
    """Adapts a Qt widget with a getter, a silent setter and the signal ``changed``."""

    def __init__(
        self,
        build: Callable[[], QWidget],
        getter: str = "value",
        setter: str = "show_value",
        parent: QWidget | None = None,
    ) -> None:
        def built(parent: QWidget | None = None) -> QWidget:
            widget = build()
            widget.setParent(parent)
            return widget

        super().__init__(built, getter, setter, "changed", parent=parent)  # type: ignore[arg-type]


class NativeWidget(ValueWidget[Any]):
    """A widget of magicgui whose native part is made by ``build``.

    Parameters
    ----------
    build : callable
        Makes the Qt widget.
    getter, setter : str
        Names of its methods; the setter does not tell that the value changed.
    **kwargs
        Of `magicgui.widgets.bases.ValueWidget`.
    """

    def __init__(
        self,
        build: Callable[[], QWidget],
        getter: str = "value",
        setter: str = "show_value",
        **kwargs: Any,
    ) -> None:
        parts = {"build": build, "getter": getter, "setter": setter}
        super().__init__(widget_type=_Backend, backend_kwargs=parts, **kwargs)
