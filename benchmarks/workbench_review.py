"""From the key to the painted verdict, and from the key to the verdict on the disk.

Cells of the sample are judged by keys in the gallery. *painted*: until the gallery is painted with
the verdict and the next cell selected. *cell view*: until the large view shows the next cell after
an arrow key. *stored*: until the verdict is in the database. *opened*: from Enter to the large cell
on the screen; *stroke*: from the end of a stroke of the brush to the corrected marks. *blocked*:
the longest time in which the window could not answer.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

from qtpy.QtCore import QEvent, QObject, QPointF, Qt
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QWidget
from workbench_window import Heartbeat, Times, opened, process_events

from napari_pv_inspect.docks.large_cell import large_cell
from napari_pv_inspect.models.workbench import RunState
from pv_inspect.review import VerdictKind

LEFT, NONE = Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier


class Paints(QObject):
    """Notes when a widget was painted."""

    def __init__(self, widget: QWidget) -> None:
        super().__init__(widget)
        self.count = 0
        widget.installEventFilter(self)

    def eventFilter(self, _: QObject, event: QEvent) -> bool:  # noqa: N802 (Qt's name)
        """Count."""
        self.count += event.type() == QEvent.Type.Paint
        return False


def review(options: argparse.Namespace) -> dict[str, dict[str, float]]:
    """Judge cells by keys, then walk through them in the large view."""
    viewer, dock = opened(options.sequence)
    workbench = dock.workbench
    workbench.model.confirm_layout()
    dock.run.run.click()
    process_events(300.0, lambda: workbench.model.run_state is RunState.IDLE)
    cells = viewer.window.dock_widgets["Cells"]
    times = Times()
    with tempfile.TemporaryDirectory() as place:
        dock.save(Path(place) / "result")
        process_events(60.0, lambda: workbench.review.state.storage.folder is not None)
        process_events(2.0)
        heart = Heartbeat()
        workbench.model.select_cell((0, 0))
        process_events(0.5)
        _judge(workbench, cells, heart, times, options.keys)
        view = large_cell(workbench).view
        painted = Paints(view.cell_panel)
        for _ in range(max(options.keys // 5, 1)):
            _focus(cells.view)
            heart.restart()
            painted.count, begun = 0, time.perf_counter()
            QTest.keyClick(cells.view, Qt.Key.Key_Return)
            process_events(2.0, lambda: painted.count > 0)
            times.add("opened", 1e3 * (time.perf_counter() - begun))
            process_events(0.5)
            times.add("opened blocked", heart.longest_ms)
            QTest.keyClick(view, Qt.Key.Key_Escape)
            process_events(0.5)
        cells.open_cell()
        process_events(1.0)
        for _ in range(options.keys):
            _focus(view)
            heart.restart()
            painted.count, begun = 0, time.perf_counter()
            QTest.keyClick(view, Qt.Key.Key_Right)
            process_events(2.0, lambda: painted.count > 0)
            times.add("cell view", 1e3 * (time.perf_counter() - begun))
            process_events(0.4)
            times.add("cell view blocked", heart.longest_ms)
        _paint(view, workbench.review.state, heart, times, painted, options.keys)
        process_events(5.0, lambda: workbench.review.state.storage.pending == 0)
        viewer.close()
    return times.summary()


def _judge(workbench: object, cells: object, heart: Heartbeat, times: Times, keys: int) -> None:
    state, kinds = workbench.review.state, list(VerdictKind)
    painted = Paints(cells.view.viewport())
    for number in range(keys):
        cell = workbench.model.selected_cell
        _focus(cells.view)
        heart.restart()
        painted.count, begun = 0, time.perf_counter()
        QTest.keyClick(cells.view, kinds[number % len(kinds)].key)
        if not state.cells.is_pending(cell) and state.cells.verdict(cell) is None:
            sys.exit("The key gave no verdict.")
        process_events(2.0, lambda: painted.count > 0)
        times.add("painted", 1e3 * (time.perf_counter() - begun))
        process_events(5.0, lambda at=cell: not state.cells.is_pending(at))
        times.add("stored", 1e3 * (time.perf_counter() - begun))
        process_events(0.2)
        times.add("blocked", heart.longest_ms)


def _paint(view: object, heart: Heartbeat, times: Times, painted: Paints, strokes: int) -> None:
    """Paint short lines; the first one makes the layer of corrected marks."""
    view.bar.drawing.setChecked(True)
    panel = view.cell_panel
    height, width = panel.image.height(), panel.image.width()
    for number in range(strokes):
        y = (0.1 + 0.8 * number / strokes) * height
        to = panel.transform()
        ends = [to.map(QPointF(x * width, y)).toPoint() for x in (0.2, 0.8)]
        QTest.mousePress(panel, LEFT, NONE, ends[0])
        QTest.mouseMove(panel, ends[1])
        process_events(0.1)
        heart.restart()
        painted.count, begun = 0, time.perf_counter()
        QTest.mouseRelease(panel, LEFT, NONE, ends[1])
        process_events(2.0, lambda: painted.count > 0)
        times.add("stroke", 1e3 * (time.perf_counter() - begun))
        process_events(0.4)
        times.add("stroke blocked", heart.longest_ms)


def _focus(widget: QWidget) -> None:
    # Without a window manager nothing makes the window the active one, which keys go to.
    widget.window().activateWindow()
    widget.setFocus()
    process_events(5.0, widget.hasFocus)


def main(arguments: list[str]) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sequence", type=Path, help="folder of frames; the sample if not given")
    parser.add_argument("--keys", type=int, default=30)
    print(json.dumps(review(parser.parse_args(arguments)), indent=1))
