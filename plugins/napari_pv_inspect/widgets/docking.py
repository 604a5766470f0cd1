"""Finds the dock that a widget is in."""

from __future__ import annotations

from qtpy.QtWidgets import QDockWidget, QWidget

__all__ = ["dock_of"]


def dock_of(widget: QWidget | None) -> QDockWidget | None:
    """Return the dock that a widget is in, None if it is in none."""
    while widget is not None and not isinstance(widget, QDockWidget):
        widget = widget.parentWidget()
    return widget
