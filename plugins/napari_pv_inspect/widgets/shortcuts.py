"""Keys of the workbench, in one list: what they do and how the help shows them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from html import escape
from weakref import ref

from qtpy.QtCore import Qt
from qtpy.QtGui import QKeySequence, QShortcut
from qtpy.QtWidgets import QDialog, QLabel, QScrollArea, QVBoxLayout, QWidget

__all__ = ["Key", "Shortcuts"]

HELP_KEY = "F1"


@dataclass(frozen=True)
class Key:
    """One key.

    Attributes
    ----------
    sequence : str
        As Qt writes it: "Ctrl+Z".
    text : str
        What it does.
    group : str
        Headline in the help.
    """

    sequence: str
    text: str
    group: str


class Shortcuts:
    """Binds keys to a window or to a part of it, and explains them on F1.

    Parameters
    ----------
    window : QWidget
    """

    def __init__(self, window: QWidget) -> None:
        # A window that is closed has to be free to go.
        self._window = ref(window)
        self._bound: dict[Key, QShortcut] = {}
        self._help: QDialog | None = None
        self.add(Key(HELP_KEY, "Show this list", "Everywhere"), self.show_help)

    @property
    def bound(self) -> Mapping[Key, QShortcut]:
        """What each key is bound to."""
        return self._bound

    @property
    def keys(self) -> tuple[Key, ...]:
        """All keys, in the order in which they were added."""
        return tuple(self._bound)

    def add(self, key: Key, slot: Callable[[], None], within: QWidget | None = None) -> None:
        """Bind a key; ``within`` a widget it acts only while the focus is inside of it."""
        owner = self._window() if within is None else within
        context = Qt.ShortcutContext
        shortcut = QShortcut(QKeySequence(key.sequence), owner)
        shortcut.setContext(
            context.WindowShortcut if within is None else context.WidgetWithChildrenShortcut
        )
        shortcut.activated.connect(slot)
        self._bound[key] = shortcut
        # A dock that is closed for good takes its keys with it.
        shortcut.destroyed.connect(partial(_forget, self._bound, key))

    def close(self) -> None:
        """Disconnect from the window."""
        if self._help is not None:
            self._help.close()
        for shortcut in tuple(self._bound.values()):
            shortcut.setParent(None)
            shortcut.deleteLater()
        self._bound.clear()

    def show_help(self) -> None:
        """Show all keys in a window of their own, which Escape closes."""
        dialog = QDialog(self._window())
        dialog.setWindowTitle("Keys of pv-inspect")
        dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        text = QLabel(self.as_html())
        text.setMargin(12)
        text.setWordWrap(True)
        area = QScrollArea()
        area.setWidget(text)
        area.setWidgetResizable(True)
        QVBoxLayout(dialog).addWidget(area)
        dialog.resize(520, 560)
        dialog.destroyed.connect(self._on_help_closed)
        if self._help is not None:
            self._help.close()
        self._help = dialog
        dialog.show()

    def as_html(self) -> str:
        """All keys as a table, group by group."""
        parts = []
        for group in dict.fromkeys(key.group for key in self.keys):
            rows = "".join(
                f"<tr><td><b>{escape(key.sequence)}</b>&nbsp;&nbsp;</td><td>{escape(key.text)}</td>"
                for key in self.keys
                if key.group == group
            )
            parts.append(f"<h3>{escape(group)}</h3><table>{rows}</table>")
        return "".join(parts)

    def _on_help_closed(self, _: object = None) -> None:
        self._help = None


def _forget(bound: dict[Key, QShortcut], key: Key, _: object = None) -> None:
    bound.pop(key, None)
