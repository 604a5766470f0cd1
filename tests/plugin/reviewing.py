"""What the tests of the review share."""

from __future__ import annotations

from typing import Any

from pytestqt.qtbot import QtBot

from pv_inspect.inspection.inspection import Inspection


def show(dock: Any, inspection: Inspection | None) -> None:
    """Put an inspection open as if a run had brought it."""
    model = dock.workbench.model
    model.revise(inspection)


def stored(dock: Any, qtbot: QtBot) -> None:
    """Wait until all that was said is on disk."""
    state = dock.workbench.review.state
    qtbot.waitUntil(lambda: state.storage.pending == 0)
    state.storage.collect()
