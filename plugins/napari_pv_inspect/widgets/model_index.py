"""The type of an index into a Qt item model."""

from __future__ import annotations

from qtpy.QtCore import QModelIndex, QPersistentModelIndex

__all__ = ["ModelIndex"]

ModelIndex = QModelIndex | QPersistentModelIndex
"""What Qt gives to the methods of an item model or a delegate."""
