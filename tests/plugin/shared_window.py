"""One napari window that many tests use, each of which finds it as it was made.

Making and closing a window costs as much as ten tests. A test that leaves something behind in the
shared window fails itself: the window is looked at after each test, and another one is made then.
"""

from __future__ import annotations

import gc
from collections import Counter
from collections.abc import Generator
from contextlib import contextmanager
from operator import attrgetter
from typing import Any
from unittest.mock import patch
from weakref import ref

from app_model import Application
from napari import Viewer
from napari._app_model._app import NapariApplication, _napari_names
from napari._qt._qapp_model.qactions import init_qactions
from napari._qt.dialogs.qt_notification import NapariQtNotification
from napari._qt.qt_viewer import QtViewer
from napari.plugins import _initialize_plugins
from napari.settings import get_settings
from qtpy.QtCore import QCoreApplication, QEvent, QObject
from qtpy.QtWidgets import QApplication, QWidget

from napari_pv_inspect.docks.inspect import InspectDock
from napari_pv_inspect.docks.large_cell import LargeCell
from napari_pv_inspect.napari_internals import canvas_area, central_layout, main_window

MODELS = ("dims", "scene.camera", "cursor", "canvas.grid", "tooltip")
OVERLAYS = ("scene.overlays", "canvas.overlays")
VALUES = ("title", "theme", "help", "status", "mouse_over_canvas")
APP = "shared_window"


class SharedWindow:
    """A viewer with its window, and what it was like when it was made."""

    def __init__(self) -> None:
        self._app = NapariApplication(APP)
        self._app.injection_store.namespace = _napari_names
        try:
            with self.in_use():
                _initialize_plugins.cache_clear()
                init_qactions.cache_clear()
                get_settings().reset()
                self.viewer: Any = Viewer(show=False, show_welcome_screen=False)
        except BaseException:
            Application.destroy(APP)
            raise
        self._window: Any = main_window(self.viewer)
        self._canvas = ref(canvas_area(self._window))
        # napari's own fixture takes every one that is alive for a leak of the test before.
        QtViewer._instances.discard(self._canvas())
        self._layout = self._window.saveState()
        self._size = self._window.size()
        self._models = {name: model.model_dump() for name, model in self._all_models().items()}
        self._values = {name: getattr(self.viewer, name) for name in VALUES}
        # napari makes what draws the caption when it is first shown, and keeps it.
        self.viewer.canvas.overlays["text"].visible = True
        self.empty()
        self._before = self.census()

    @contextmanager
    def in_use(self) -> Generator[None]:
        """Make napari use the actions of this window, without its status thread and console."""
        with (
            patch.object(NapariApplication, "get_app_model", return_value=self._app),
            patch("napari._qt.threads.status_checker.StatusChecker.start", lambda *_: None),
            patch("napari._qt.qt_viewer.QtViewer._get_console", _no_console),
        ):
            yield

    @property
    def is_open(self) -> bool:
        """Whether no test has closed it."""
        return hasattr(self.viewer.window, "_qt_window")

    def census(self) -> Counter[str]:
        """Count what is in the window, and who listens to it."""
        found: Counter[str] = Counter()
        for child in self._window.findChildren(QObject):
            found[f"{child.metaObject().className()} in the window"] += 1
        for name, value in self._values_now().items():
            found[f"{name}: {value!r}"] += 1
        viewer = self.viewer
        groups = {"viewer": viewer, "layers": viewer.layers}
        # Not to overlays: only napari does, from when it first shows one.
        groups |= {name: attrgetter(name)(viewer) for name in MODELS}
        for name, group in groups.items():
            for event, emitter in group.events.emitters.items():
                found[f"listener of {name}.{event}"] += sum(
                    not isinstance(one, tuple) or one[0]() is not None for one in emitter.callbacks
                )
        for name in ("move", "drag", "double_click", "wheel"):
            found[f"mouse callbacks: {name}"] += len(getattr(viewer, f"mouse_{name}_callbacks"))
        found["keys"] += len(viewer.keymap)
        found["layers"] += len(viewer.layers)
        found["docks"] += len(viewer.window.dock_widgets)
        found["places in the middle"] += central_layout(self._window).count()
        return found

    def _all_models(self) -> dict[str, Any]:
        models = {name: attrgetter(name)(self.viewer) for name in MODELS}
        for name in OVERLAYS:
            models |= {f"{name}.{k}": one for k, one in attrgetter(name)(self.viewer).items()}
        return models

    def _values_now(self) -> dict[str, Any]:
        models = {name: model.model_dump() for name, model in self._all_models().items()}
        return models | {name: getattr(self.viewer, name) for name in VALUES}

    def empty(self) -> list[ref[Any]]:
        """Take out what a test has put into it; return what has to be free to go now."""
        viewer, window = self.viewer, self._window
        window.hide()
        docks = window.findChildren(InspectDock)
        gone: list[ref[Any]] = [ref(dock) for dock in docks]
        for dock in docks:
            gone.append(ref(dock.workbench))
            dock.workbench.close()
        del docks
        for large in window.findChildren(LargeCell):
            central_layout(window).removeWidget(large)
            large.setParent(None)
            large.deleteLater()
            gone.append(ref(large))
        for widget in list(viewer.window.dock_widgets.values()):
            viewer.window.remove_dock_widget(widget, menu=viewer.window.window_menu)
            widget.deleteLater()
            gone.append(ref(widget))
        for message in window.findChildren(NapariQtNotification):
            message.close()
            message.deleteLater()
        # Once after the last layer, not after each of them: half of the time that emptying takes.
        with viewer.dims.events.blocker_all():
            viewer.layers.selection.clear()
            viewer.layers.clear()
        viewer.dims.events.ndim(value=viewer.dims.ndim)
        window.resize(self._size)
        window.restoreState(self._layout)
        QCoreApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
        for name, model in self._all_models().items():
            model.update(self._models[name])
        for name, value in self._values.items():
            setattr(viewer, name, value)
        get_settings().reset()
        return gone

    def left_over(self, gone: list[ref[Any]]) -> list[str]:
        """Say what a test has left behind, once the window is empty."""
        gc.collect()
        QApplication.processEvents()
        QCoreApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
        found = [f"{one()!r} is alive" for one in gone if one() is not None]
        now = self.census()
        found += [f"{n} more {what}" for what, n in (now - self._before).items()]
        found += [f"{n} fewer {what}" for what, n in (self._before - now).items()]
        return found

    def close(self) -> None:
        """Close it for good; what is left of it then is a leak."""
        gc.unfreeze()
        try:
            with self.in_use():
                if self.is_open:
                    with patch.object(self._window, "_save_current_window_settings"):
                        self.viewer.close()
        finally:
            del self._window, self.viewer
            # Menus that are still there would be made anew at each action that goes.
            QCoreApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
            gc.collect()
            Application.destroy(APP)
            _initialize_plugins.cache_clear()
            init_qactions.cache_clear()

    def assert_gone(self) -> None:
        """Look for the canvas of a closed window as napari's own fixture does."""
        gc.collect()
        assert self._canvas() is None, "the closed window is still there"


def _no_console(*_: Any) -> QWidget:
    widget: Any = QWidget()
    widget._update_theme = lambda *_: None
    return widget


def is_ours(thing: Any) -> bool:
    """Whether a class of the workbench made it; napari keeps hidden pop-ups of its own."""
    return type(thing).__module__.startswith("napari_pv_inspect")
