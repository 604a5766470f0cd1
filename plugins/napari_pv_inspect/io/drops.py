"""Takes folders and stacks that are dropped on the window, before napari asks which reader to use.

napari's own readers take folders and TIFF files as well, so that it would open a dialog. With Alt,
which is napari's key for that choice, the drop is left to napari.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from qtpy.QtCore import QEvent, QObject, Qt
from qtpy.QtGui import QDropEvent, QGuiApplication
from qtpy.QtWidgets import QWidget

from napari_pv_inspect.reader import get_reader

__all__ = ["DropHandler"]

# What makes a folder one array, which napari's own readers know.
ZARR = (".zarray", ".zgroup", ".zattrs", "zarr.json")


class DropHandler(QObject):
    """Hands drops on a widget, and on all that lie on it, to the workbench.

    Parameters
    ----------
    target : QWidget
        The canvas area of a napari window.
    take : callable
        Opens one path or a list of frames.
    """

    def __init__(self, target: QWidget, take: Callable[[Any], None]) -> None:
        super().__init__(target)
        self._take: Callable[[Any], None] | None = take
        for widget in (target, *target.findChildren(QWidget)):
            if widget.acceptDrops():
                widget.installEventFilter(self)

    def close(self) -> None:
        """Leave all drops to napari again."""
        self._take = None
        self.deleteLater()

    def eventFilter(self, _: QObject, event: QEvent) -> bool:  # noqa: N802 (Qt's name)
        """Take a drop that our reader knows how to read."""
        if self._take is None or not isinstance(event, QDropEvent):
            return False
        if event.type() != QEvent.Type.Drop:
            return False
        alt = Qt.KeyboardModifier.AltModifier
        if QGuiApplication.keyboardModifiers() & alt or event.modifiers() & alt:
            return False
        urls = event.mimeData().urls()
        paths = [url.toLocalFile() for url in urls if url.isLocalFile()]
        if not paths or len(paths) != len(urls):
            return False
        given = paths[0] if len(paths) == 1 else paths
        if get_reader(given) is None and not _is_plain_folder(given):
            return False
        event.acceptProposedAction()
        self._take(given)
        return True


def _is_plain_folder(given: str | list[str]) -> bool:
    """Whether it is a folder that was meant for us: what is missing in it becomes a sentence."""
    if not isinstance(given, str) or not (place := Path(given)).is_dir():
        return False
    return not any((place / name).exists() for name in ZARR)
