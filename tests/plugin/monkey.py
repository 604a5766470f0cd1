"""A user who does anything at any time, and remembers every verdict given."""

from __future__ import annotations

import faulthandler
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from qtpy.QtCore import Qt
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QApplication

from napari_pv_inspect.application import build
from napari_pv_inspect.docks.inspect import InspectDock
from napari_pv_inspect.docks.large_cell import large_cell
from napari_pv_inspect.layers.points import PointsLayer
from napari_pv_inspect.models.history import Action
from napari_pv_inspect.models.workbench import RunState
from napari_pv_inspect.napari_internals import main_window
from pv_inspect.review import Cell, ReviewStore, VerdictKind
from tests.plugin.napari_mouse import press, release_at
from tests.waiting import LONG_S

__all__ = ["Monkey"]

HANG_S = 2 * LONG_S
WEIGHTS = {
    "verdict": 12,
    "drag_point": 6,
    "slide": 10,
    "run": 5,
    "cancel": 3,
    "detect": 2,
    "undo": 6,
    "redo": 4,
    "note": 3,
    "brush": 3,
    "withdraw": 2,
    "delete_layer": 4,
    "rename_layer": 4,
    "hide_layer": 2,
    "tick": 4,
    "look_at": 4,
    "select_cell": 5,
    "list_otherwise": 3,
    "live_cell": 4,
    "large_cell": 3,
    "dock": 3,
    "new_controls": 1,
    "page": 3,
    "points_tool": 3,
    "save": 3,
    "reopen": 2,
    "close_and_reopen": 1,
    "other_frames": 2,
    "nonsense": 1,
    "help": 1,
    "wait": 6,
}


class Monkey:
    """Sits before the workbench.

    Parameters
    ----------
    seed : int
    make_viewer : callable
    frames : Path
        Folder of a small module.
    place : Path
        Where results are saved.
    """

    def __init__(
        self, seed: int, make_viewer: Callable[[], Any], frames: Path, place: Path
    ) -> None:
        self._rng = np.random.default_rng(seed)
        self._make_viewer = make_viewer
        self._frames = frames
        self._place = place
        self._saves = 0
        self.done: list[str] = []
        self.given: dict[Path, dict[Cell, VerdictKind]] = {}
        self._meaning: dict[int, tuple[Path, Cell, VerdictKind | None, VerdictKind | None]] = {}
        self._kept: list[Any] = []
        self.sit_down()
        self.open(frames)

    @property
    def folder(self) -> Path:
        """Where the dialog *Save result* leads."""
        return self._place / f"result{self._saves}"

    def sit_down(self) -> None:
        """Open a window."""
        self.viewer = self._make_viewer()
        self.dock, self.cells = build(self.viewer)
        self.workbench = self.dock.workbench
        # Estimating the blur would be two thirds of every run; a slider may ask for it.
        self.workbench.model.change_settings(
            magnification=2.0, max_iterations=3, psf_sigma_lr_px=0.5
        )
        main_window(self.viewer).show()

    def act(self, count: int) -> None:
        """Do ``count`` things, one after the other."""
        names = list(WEIGHTS)
        odds = np.array([WEIGHTS[name] for name in names], float)
        for name in self._rng.choice(names, count, p=odds / odds.sum()):
            self.do(str(name))

    def do(self, name: str) -> None:
        """Do one thing and let the window answer."""
        faulthandler.dump_traceback_later(HANG_S, exit=True)
        self.done.append(name)
        getattr(self, f"_do_{name}")()
        self.wait(0.02)
        faulthandler.cancel_dump_traceback_later()

    def wait(self, seconds: float) -> None:
        """Let the window work."""
        end = time.monotonic() + seconds
        QApplication.processEvents()
        while time.monotonic() < end:
            QApplication.processEvents()
            time.sleep(0.002)

    def until(self, happened: Callable[[], bool], what: str) -> None:
        """Wait for something."""
        end = time.monotonic() + LONG_S
        while not happened():
            assert time.monotonic() < end, f"In vain: {what}; {self.done}"
            self.wait(0.01)

    def open(self, path: Any) -> None:
        """Open something and wait for it."""
        self.workbench.open(path)
        self.until(lambda: not self.workbench.opener.busy, f"opening {path}")

    def whole(self) -> None:
        """Run to the end and save."""
        self.until(self._idle, "the end of the run")
        model = self.workbench.model
        if model.inspection is None or not model.inspection.complete:
            self.workbench.runs.start()
            self.until(self._idle, "the end of the run")
        self._do_save()

    def stored(self) -> None:
        """Wait until the verdicts are stored."""
        state = self.workbench.review.state
        if state.storage.folder is not None:
            self.until(lambda: state.storage.pending == 0, "stored verdicts")
        state.storage.collect()

    def lost(self) -> list[str]:
        """Compare what was given with what is stored."""
        self.stored()
        found = []
        for folder, given in self.given.items():
            with ReviewStore(folder) as store:
                mine = self.workbench.review.state.data.rater
                current = {v.cell: v.kind for v in store.current() if v.rater == mine}
            if current != given:
                found.append(f"{folder.name}: given {given}, stored {current}")
        return found

    def leave(self) -> None:
        """Close the window."""
        self.stored()
        self.viewer.close()
        self.wait(0.05)

    # What a monkey does

    def _do_verdict(self) -> None:
        cell, state = self.workbench.model.selected_cell, self.workbench.review.state
        if cell is None or state.storage.folder is None or state.data.subject is None:
            return
        if cell not in state.data.subject.places:
            return
        kind = self._any(list(VerdictKind))
        view = self.cells.view
        if view.isVisible() and self._rng.random() < 0.7:
            main_window(self.viewer).activateWindow()
            view.setFocus()
            self.wait(0.01)
            if view.hasFocus():
                self._told(cell, kind, lambda: QTest.keyClick(view, kind.key))
                return
        self._told(cell, kind, lambda: self.workbench.review.judge(kind))

    def _do_withdraw(self) -> None:
        cell, state = self.workbench.model.selected_cell, self.workbench.review.state
        if cell is not None and state.storage.folder is not None:
            self._told(cell, None, self.workbench.review.withdraw)

    def _told(self, cell: Cell, kind: VerdictKind | None, say: Callable[[], Any]) -> None:
        history, folder = self.workbench.history, self.workbench.review.state.storage.folder
        given = self.given.setdefault(folder, {})
        top = history.done[-1] if history.done else None
        before = given.get(cell)
        say()
        new = history.done[-1] if history.done else None
        if new is not None and new is not top:
            self._kept.append(new)  # its id stays its own
            self._meaning[id(new)] = (folder, cell, before, kind)
            self._put(folder, cell, kind)

    def _put(self, folder: Path, cell: Cell, kind: VerdictKind | None) -> None:
        if kind is None:
            self.given[folder].pop(cell, None)
        else:
            self.given[folder][cell] = kind

    def _do_undo(self) -> None:
        history = self.workbench.history
        top = history.undone[-1:]
        self._press("Ctrl+Z")
        # A slider that had not settled yet goes first.
        if (meaning := self._meant(top, history.undone)) is not None:
            self._put(meaning[0], meaning[1], meaning[2])

    def _do_redo(self) -> None:
        history = self.workbench.history
        top = history.done[-1:]
        self._press("Ctrl+Shift+Z")
        if (meaning := self._meant(top, history.done)) is not None:
            self._put(meaning[0], meaning[1], meaning[3])

    def _meant(
        self, before: list[Action], after: list[Action]
    ) -> tuple[Path, Cell, VerdictKind | None, VerdictKind | None] | None:
        """Return what the action on top means for a verdict, if it has come just now."""
        if not after or after[-1:] == before:
            return None
        return self._meaning.get(id(after[-1]))

    def _press(self, sequence: str) -> None:
        bound = self.workbench.shortcuts.bound
        next(s for key, s in bound.items() if key.sequence == sequence).activated.emit()

    def _do_note(self) -> None:
        # Only to cells with a verdict: a note is an edit like a verdict.
        cell, state = self.workbench.model.selected_cell, self.workbench.review.state
        if (
            cell is not None
            and state.storage.folder is not None
            and state.cells.verdict(cell) is not None
        ):
            kind, text = state.cells.verdict(cell).kind, f"note {self._rng.integers(1000)}"
            self._told(cell, kind, lambda: state.commands.write_note(cell, text))

    def _do_brush(self) -> None:
        cell, state = self.workbench.model.selected_cell, self.workbench.review.state
        mask = None if cell is None or state.storage.folder is None else state.cells.marks(cell)
        if mask is not None:
            row = int(self._rng.integers(mask.shape[0]))
            mask = mask.copy()
            mask[row] = ~mask[row]
            state.commands.correct(cell, mask if self._rng.random() < 0.8 else None)

    def _do_drag_point(self) -> None:
        points: PointsLayer = self.workbench.points
        layer, marks = points.layer, points.marks
        if layer is None or marks is None or not layer.editable:
            return
        here = np.flatnonzero(marks.frame == self.workbench.frames.frame)
        if here.size == 0:
            return
        row = int(self._any(here))
        layer.selected_data = {row}
        start = layer.data[row].copy()
        press(layer, start)
        release_at(layer, start + np.append(0.0, self._rng.normal(0.0, 2.0, 2)))

    def _do_points_tool(self) -> None:
        button = self._any([self.dock.points.select, self.dock.points.add, self.dock.points.delete])
        button.click()

    def _do_slide(self) -> None:
        image, cells = self.dock.image, self.cells
        slider, top = self._any(
            [
                (self.dock.lens.form["kappa"].slider, 400),
                (image.form["prior_weight"].slider, 400),
                (image.form["psf_sigma_lr_px"].slider, 400),
                (image.form["magnification"].slider, 100),  # 2.25x: larger ones take long
                (cells.opacity, 100),
                (cells.threshold, 100),
            ]
        )
        for _ in range(int(self._rng.integers(1, 5))):
            slider.setValue(int(self._rng.integers(top + 1)))
            self.wait(0.01)
        if self._rng.random() < 0.4:
            forms = (
                self.dock.lens.form["kappa"],
                image.form["prior_weight"],
                image.form["psf_sigma_lr_px"],
            )
            self._any([one.automatic for one in forms]).click()

    def _do_run(self) -> None:
        self.dock.run.run.click()

    def _do_cancel(self) -> None:
        self.dock.run.cancel.click()

    def _do_detect(self) -> None:
        self.dock.module.detect.click()

    def _do_delete_layer(self) -> None:
        if len(self.viewer.layers):
            self.viewer.layers.remove(self._any(list(self.viewer.layers)))

    def _do_rename_layer(self) -> None:
        if len(self.viewer.layers):
            self._any(list(self.viewer.layers)).name = f"mine {self._rng.integers(100)}"

    def _do_hide_layer(self) -> None:
        if len(self.viewer.layers):
            layer = self._any(list(self.viewer.layers))
            layer.visible = not layer.visible

    def _do_tick(self) -> None:
        table = self.dock.frames.table
        if table.rows:
            index = table.index(int(self._rng.integers(len(table.rows))), 0)
            state = self._any([Qt.CheckState.Checked, Qt.CheckState.Unchecked])
            table.setData(index, state, Qt.ItemDataRole.CheckStateRole)

    def _do_look_at(self) -> None:
        navigator = self.workbench.navigator
        self._any([navigator.to_all, navigator.to_frames, navigator.to_module])()
        self.viewer.dims.set_current_step(0, int(self._rng.integers(6)))

    def _do_select_cell(self) -> None:
        rows = self.cells.cells.rowCount()
        if rows:
            self.cells.view.setCurrentIndex(self.cells.cells.index(int(self._rng.integers(rows))))

    def _do_list_otherwise(self) -> None:
        combo = self._any([self.cells.order, self.cells.filter])
        combo.setCurrentIndex(int(self._rng.integers(combo.count())))

    def _do_live_cell(self) -> None:
        live = self.viewer.window.dock_widgets.get("Live cell")
        if live is None or not live.isVisible():
            self.dock.image.show_live.click()
            return
        side = self._any([live.shown, live.against])
        rows = [k for k in range(side.count()) if side.itemData(k) is not None]  # no separator
        side.setCurrentIndex(self._any(rows))
        side.activated.emit(side.currentIndex())
        live.view.move_divider(float(self._rng.random()))
        if self._rng.random() < 0.3:
            live.flicker.toggle()
        if self._rng.random() < 0.3:
            live.parentWidget().close()

    def _do_large_cell(self) -> None:
        place = large_cell(self.workbench)
        if not place.is_open:
            self.cells.open_cell()
        elif self._rng.random() < 0.5:
            self.workbench.review.step(int(self._any([-1, 1])))
        elif self._rng.random() < 0.5:
            place.toggle_gallery()
        else:
            place.leave()

    def _do_dock(self) -> None:
        for name in ("Cells", "Inspect module"):
            place = self.viewer.window.dock_widgets.get(name)
            if place is not None and place.parentWidget() is not None:
                place.parentWidget().setVisible(bool(self._rng.random() < 0.6))

    def _do_new_controls(self) -> None:
        self.viewer.window.remove_dock_widget(self.dock)
        self.dock.deleteLater()
        self.wait(0.05)
        self.dock = InspectDock(self.viewer)
        self.viewer.window.add_dock_widget(self.dock, name="Inspect module", area="right")

    def _do_page(self) -> None:
        self.dock.pages.setCurrentIndex(int(self._rng.integers(self.dock.pages.count())))

    def _do_save(self) -> None:
        inspection = self.workbench.model.inspection
        if inspection is not None and inspection.complete:
            before = self.workbench.review.state.storage.folder
            self.dock.result.save.click()
            self.until(lambda: not self.workbench.saver.busy, "the saved result")
            # What was judged goes to another folder as well.
            after = self.workbench.review.state.storage.folder
            # None: other frames that were still being opened came meanwhile.
            if after not in (None, before) and before in self.given:
                self.given.setdefault(after, {}).update(self.given[before])

    def _do_reopen(self) -> None:
        self.stored()
        if (self.folder / "result.json").is_file():
            self.open(self.folder)

    def _do_close_and_reopen(self) -> None:
        self.leave()
        self.sit_down()
        self.open(self.folder if (self.folder / "result.json").is_file() else self._frames)
        self.workbench.model.change_settings(magnification=2.0, max_iterations=3)

    def _do_other_frames(self) -> None:
        self.stored()
        files = sorted((self._frames / "frames").iterdir())
        path = self._any([self._frames, files[:4]]) if self._rng.random() < 0.8 else files[0]
        self._saves += 1
        self.workbench.open(path)
        if self._rng.random() < 0.7:
            self.until(lambda: not self.workbench.opener.busy, "opening")
            self.whole()

    def _do_nonsense(self) -> None:
        self.workbench.open(self._place / "nowhere")

    def _do_help(self) -> None:
        self.workbench.shortcuts.show_help()

    def _do_wait(self) -> None:
        self.wait(float(self._rng.random()))

    def _idle(self) -> bool:
        return self.workbench.model.run_state is RunState.IDLE

    def _any(self, things: Any) -> Any:
        return things[int(self._rng.integers(len(things)))]
