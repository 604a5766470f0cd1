"""Style of the controls: visible focus, one primary button, a wheel that needs the focus."""

from __future__ import annotations

from napari.components import ViewerModel
from napari.utils.theme import get_theme
from qtpy.QtCore import QEvent, QObject, Qt
from qtpy.QtWidgets import (
    QAbstractSpinBox,
    QApplication,
    QComboBox,
    QPushButton,
    QSlider,
    QWidget,
)

from napari_pv_inspect.appearance import (
    FOCUS_ON_DARK,
    FOCUS_ON_LIGHT,
    PRIMARY_COLOUR,
    PRIMARY_HOVER_COLOUR,
)

__all__ = ["ThemedStyle", "WheelNeedsFocus", "finish_typing", "set_primary", "style"]

# A border takes its pixel from the padding: nothing moves when the focus comes.
_STYLE = """
QPushButton:focus, QToolButton:focus { border: 1px solid FOCUS; padding: 3px; }
QComboBox:focus { border: 1px solid FOCUS; padding: 2px 9px 2px 7px; }
QAbstractSpinBox { min-width: 30px; padding: 1px 4px; }
QAbstractSpinBox:focus { border: 1px solid FOCUS; padding: 0px 3px; }
QLineEdit:focus { border: 1px solid FOCUS; padding: 1px; }
QTableView:focus { border: 1px solid FOCUS; }
QCheckBox::indicator:focus { border: 1px solid FOCUS; padding: 0px; }
QSlider::handle:horizontal:focus { border: 2px solid FOCUS; }
QTabBar::tab:selected:focus { border: 1px solid FOCUS; }
QPushButton[primary="true"]:enabled {
  background-color: PRIMARY; color: white; font-weight: bold; min-height: 20px;
}
QPushButton[primary="true"]:enabled:hover { background-color: HOVER; }
QPushButton[primary="true"]:enabled:focus { border: 2px solid FOCUS; padding: 2px; }
"""


def style(theme: str) -> str:
    """Return the style sheet of our docks under a theme of napari."""
    red, green, blue = get_theme(theme).background.as_rgb_tuple(alpha=False)
    focus = FOCUS_ON_DARK if red + green + blue < 384 else FOCUS_ON_LIGHT
    text = _STYLE.replace("FOCUS", focus).replace("PRIMARY", PRIMARY_COLOUR)
    return text.replace("HOVER", PRIMARY_HOVER_COLOUR)


class ThemedStyle(QObject):
    """Keeps the style sheet of a dock in step with the theme of napari."""

    def __init__(self, dock: QWidget, viewer: ViewerModel) -> None:
        super().__init__(dock)
        self._dock, self._viewer = dock, viewer
        self._on_theme()
        viewer.events.theme.connect(self._on_theme)

    def _on_theme(self, _: object = None) -> None:
        self._dock.setStyleSheet(style(self._viewer.theme))


def set_primary(button: QPushButton, primary: bool) -> None:
    """Style a button as the primary one, or as a plain one again."""
    if bool(button.property("primary")) is not primary:
        button.setProperty("primary", primary)
        button.style().unpolish(button)
        button.style().polish(button)


def finish_typing() -> None:
    """Enter a number that is being typed: not every platform moves the focus on a click."""
    field = QApplication.focusWidget()
    if isinstance(field, QAbstractSpinBox):
        field.interpretText()


class WheelNeedsFocus(QObject):
    """Keeps the wheel from changing values that do not have the focus; the page scrolls instead.

    Parameters
    ----------
    within : QWidget
        All numbers, sliders and lists in it, as they are now.
    """

    def __init__(self, within: QWidget) -> None:
        super().__init__(within)
        for kind in (QAbstractSpinBox, QSlider, QComboBox):
            for field in within.findChildren(kind):
                field.installEventFilter(self)
                field.setFocusPolicy(Qt.FocusPolicy.StrongFocus)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: N802 (Qt's name)
        """Pass the wheel on to the widget below."""
        if (
            event.type() == QEvent.Type.Wheel
            and isinstance(watched, QWidget)
            and not watched.hasFocus()
        ):
            event.ignore()
            return True
        return False
