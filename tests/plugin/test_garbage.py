"""While a workbench is open, garbage is collected in the main thread and in no other."""

from __future__ import annotations

import gc
from collections.abc import Callable, Generator
from threading import Thread, current_thread, main_thread
from typing import Any
from weakref import ref

import pytest
from pytestqt.qtbot import QtBot
from qtpy.QtCore import QObject

from napari_pv_inspect.application import build
from napari_pv_inspect.tasks.garbage import collect_anywhere, collect_in_main_thread


class Ring:
    """Refers to itself, so that only the collector can free it, and says where it was freed."""

    def __init__(self, freed_in: list[Thread]) -> None:
        self.itself = self
        self.freed_in = freed_in

    def __del__(self) -> None:
        self.freed_in.append(current_thread())


def make_garbage(freed_in: list[Thread]) -> None:
    """Allocate far more than what makes Python collect."""
    for _ in range(20 * gc.get_threshold()[0]):
        Ring(freed_in)


def in_a_thread(work: Callable[[], Any]) -> None:
    thread = Thread(target=work)
    thread.start()
    thread.join()


@pytest.fixture
def user(qapp: Any, qtbot: QtBot) -> Generator[QObject]:
    """Something that keeps collection in the main thread."""
    user = QObject()
    collect_in_main_thread(user)
    yield user
    collect_anywhere(user)
    qtbot.waitUntil(gc.isenabled)


def test_a_thread_that_allocates_collects_nothing_and_the_main_thread_does(
    user: QObject, qtbot: QtBot
) -> None:
    freed_in: list[Thread] = []
    in_a_thread(lambda: make_garbage(freed_in))
    assert not freed_in
    qtbot.waitUntil(lambda: len(freed_in) == 20 * gc.get_threshold()[0])
    assert set(freed_in) == {main_thread()}


def test_without_a_user_python_collects_again_as_before(user: QObject, qtbot: QtBot) -> None:
    other = QObject()
    collect_in_main_thread(other)
    collect_anywhere(user)
    qtbot.wait(1500)
    assert not gc.isenabled()
    gone = ref(other)
    del other
    assert gone() is None
    qtbot.waitUntil(gc.isenabled)


def test_an_open_window_keeps_collection_in_the_main_thread(
    make_napari_viewer: Callable[..., Any], qtbot: QtBot
) -> None:
    viewer = make_napari_viewer()
    build(viewer)
    assert not gc.isenabled()
    viewer.close()
    qtbot.waitUntil(gc.isenabled)
