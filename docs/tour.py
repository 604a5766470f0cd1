"""An expert's session: drives the real application by mouse and keyboard through all its steps.

xvfb-run -a -s "-screen 0 1600x1000x24" env QT_QPA_PLATFORM=xcb LIBGL_ALWAYS_SOFTWARE=1 \
        python docs/tour.py [--sequence PATH [--rows N --cols N]] [--out FOLDER]

Leaves a picture after each step in docs/tour. The test of the tour walks the same way. Any other
sequence can be walked through as well; its rows and columns are guessed unless they are given.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import napari
import numpy as np
from expert import Expert
from qtpy.QtCore import QPoint, QPointF, Qt
from qtpy.QtWidgets import QPushButton, QWidget

from napari_pv_inspect.docks.large_cell import large_cell
from napari_pv_inspect.models.frame_table import ticked
from napari_pv_inspect.models.workbench import RunState
from napari_pv_inspect.sample import sample_folder
from pv_inspect.review import Cell, ReviewStore, Verdict, VerdictKind

__all__ = ["walk"]

OUT = Path(__file__).parent / "tour"
VERDICTS = (VerdictKind.OK, VerdictKind.CRACK_A, VerdictKind.CRACK_B, VerdictKind.FINGER)


def walk(
    open_viewer: Callable[[], Any],
    sequence: Path,
    out: Path,
    layout: tuple[int, int] | None = None,
) -> None:
    """Walk through all six steps; AssertionError where the workbench does not do what it should.

    Parameters
    ----------
    open_viewer : callable
        Returns a napari viewer in a new window.
    sequence : Path
        Folder of frames, or with a folder ``frames``, or a TIFF of several pages; what else the
        folder says about the module is not used.
    out : Path
        Folder of the pictures.
    layout : (rows, cols), optional
        Given by hand where the guess is none, or another one.
    """
    expert = Expert(open_viewer, out)
    with tempfile.TemporaryDirectory() as place:
        result = Path(place) / "result"
        expert.sit_down()
        open_frames(expert, sequence, Path(place), layout)
        find_the_grid(expert)
        edit_a_point(expert)
        bend_the_grid(expert)
        leave_a_frame_out(expert)
        run_and_cancel(expert)
        tune(expert)
        run(expert)
        save(expert, result)
        judge(expert)
        correct_marks(expert)
        export(expert, result)
        left_at = expert.model.selected_cell
        given = {cell: v.kind for cell, v in _verdicts(result).items()}
        expert.leave()
        expert.sit_down()
        come_back(expert, result, given, left_at)
        expert.leave()


def open_frames(
    expert: Expert, sequence: Path, place: Path, layout: tuple[int, int] | None
) -> None:
    """Open frames that come alone: rows and columns are guessed and confirmed, or given."""
    steps, model, fields = expert.dock.steps, expert.model, expert.dock.module
    frames = alone(sequence, place)
    if frames.is_dir():
        expert.choose(lambda: expert.click(expert.dock.open_folder), frames)
    else:
        expert.drop(frames)
    expert.until(lambda: model.sequence is not None, "the frames")
    expert.until(lambda: not model.guessing, "a guess of rows and columns")
    expert.photograph("1a-open")
    guess = model.settings.rows, model.settings.cols
    if layout is not None and layout != guess:
        expert.turn_to("Grid")
        expert.fill_in(fields.rows, layout[0])
        expert.fill_in(fields.cols, layout[1])
    else:
        assert model.layout_is_guessed, "the frames do not tell: give --rows and --cols"
        assert steps.next.text().startswith("Confirm"), steps.next.text()
        expert.click(steps.next)
    assert not model.layout_is_guessed
    assert layout in (None, (model.settings.rows, model.settings.cols))


def alone(sequence: Path, place: Path) -> Path:
    """Copy the frames of a sequence, and nothing that tells about them."""
    copy = place / sequence.name
    if sequence.is_file():
        shutil.copy(sequence, copy)
        return copy
    inner = sequence / "frames"
    copy.mkdir()
    for image in (inner if inner.is_dir() else sequence).iterdir():
        if image.suffix.lower() in {".tif", ".tiff", ".png"}:
            shutil.copy(image, copy)
    return copy


def a_used_frame(expert: Expert) -> int:
    """Return the fourth frame that is used, or the last one."""
    used = [k for k, row in enumerate(expert.dock.frames.table.rows) if row.used]
    return used[:4][-1]


def find_the_grid(expert: Expert) -> None:
    """Find the grid with the button of the strip, and read the list of frames."""
    assert expert.dock.steps.next.text() == "Detect grid"
    expert.click(expert.dock.steps.next)
    expert.until_idle()
    assert expert.model.inspection.calibration is not None
    expert.turn_to("Frames")
    view = expert.dock.frames.view
    frame = a_used_frame(expert)
    sorted_rows, table = expert.dock.frames.sorted, expert.dock.frames.table
    expert.click_row(view, sorted_rows.mapFromSource(table.index(frame, 1)))
    assert expert.workbench.frames.frame == frame
    expert.photograph("1b-frames")


def edit_a_point(expert: Expert) -> None:
    """Drag a crossing point; the fit follows; take it back."""
    expert.turn_to("Grid")
    expert.click(_button(expert.dock.result, "Frames"))
    expert.click(expert.dock.points.select)
    points, frame = expert.viewer.layers["Crossing points"], expert.workbench.frames.frame
    here = np.flatnonzero(points.data[:, 0] == frame)
    height, width = expert.model.sequence.shape
    middle = np.hypot(points.data[here, 1] - height / 2, points.data[here, 2] - width / 2)
    row = here[middle.argmin()]
    before = points.data[row].copy()
    start = expert.on_canvas(*points.data_to_world(before)[-2:])
    expert.drag(expert.canvas, start, start + QPoint(5, -4))
    assert expert.workbench.editor.edits.count(frame) == 1, "the point was not dragged"
    expert.until(lambda: not expert.workbench.recalibration.busy, "the fit of all frames")
    expert.photograph("2a-point")
    expert.undo()
    assert not expert.workbench.editor.edits.count(frame), "the edit was not undone"
    np.testing.assert_allclose(points.data[row], before)
    expert.click(expert.dock.points.select)


def bend_the_grid(expert: Expert) -> None:
    """Bend the grid with kappa; the mark "fitted" brings it back."""
    lens = expert.dock.lens
    expert.until(lambda: lens.curve.curve is not None, "the curve over kappa")
    expert.slide(lens.form["kappa"].slider, 0.2)
    assert expert.model.settings.kappa is not None
    expert.photograph("2b-kappa")
    expert.click(lens.form["kappa"].automatic)
    assert expert.model.settings.kappa is None
    expert.photograph("2c-fit")


def leave_a_frame_out(expert: Expert) -> None:
    """Take the tick of a frame away, and give it back."""
    expert.turn_to("Frames")
    frames = expert.dock.frames
    frame = a_used_frame(expert)
    row = frames.table.rows[frame]
    index = frames.sorted.mapFromSource(frames.table.index(frame, 0))
    expert.click_row(frames.view, index, from_left=9)
    assert (
        expert.model.settings.skip_frames == ticked(expert.model.settings, row, False).skip_frames
    )
    assert not frames.table.rows[frame].wanted
    expert.photograph("2d-frame-left-out")
    expert.click_row(frames.view, index, from_left=9)
    assert frames.table.rows[frame].wanted


def run_and_cancel(expert: Expert) -> None:
    """Run, and cancel when the module image grows: what was found so far is kept."""
    box = expert.dock.run
    expert.click(box.run)
    expert.until(lambda: "Module image" in expert.viewer.layers, "a first module image")
    assert expert.model.run_state is RunState.RUNNING
    expert.photograph("3a-run")
    expert.click(box.cancel)
    expert.until_idle()
    assert expert.model.inspection.registration is not None
    expert.photograph("3b-cancelled")


def tune(expert: Expert) -> None:
    """Watch one cell while lambda moves; compare with the bicubic picture."""
    expert.turn_to("Image")
    expert.click(expert.dock.image.show_live)
    live = expert.viewer.window.dock_widgets["Live cell"]
    shown = expert.workbench.live_cell
    expert.until(lambda: live.picture is not None and live.picture.finished, "the live cell")
    weight = expert.dock.image.form["prior_weight"]
    before = live.picture
    expert.slide(weight.slider, 0.15)
    assert expert.model.settings.prior_weight is not None
    expert.until(lambda: live.picture is not before and live.picture.finished, "another lambda")
    view, place = live.view, live.view.target()
    y = round(place.center().y())
    expert.drag(
        view,
        QPointF(place.left() + 0.5 * place.width(), y).toPoint(),
        QPointF(place.left() + 0.65 * place.width(), y).toPoint(),
    )
    assert abs(view.divider - 0.65) < 0.05, view.divider
    assert shown.cell is not None
    expert.photograph("3c-tuning")
    expert.click(expert.dock.image.form["prior_weight"].automatic)
    assert expert.model.settings.prior_weight is None
    live.parentWidget().close()
    expert.wait(0.3)


def run(expert: Expert) -> None:
    """Run to the end."""
    expert.click(expert.dock.run.run)
    expert.until_idle()
    assert expert.model.inspection.complete
    expert.click(_button(expert.dock.result, "Both"))
    expert.photograph("4-done")


def save(expert: Expert, folder: Path) -> None:
    """Save the result."""
    expert.choose(lambda: expert.click(expert.dock.result.save), folder)
    expert.until(lambda: not expert.workbench.saver.busy, "the saved result")
    expert.wait(0.3)
    assert (folder / "result.json").is_file()


def judge(expert: Expert) -> None:
    """Judge cells with the keyboard, and note something about one."""
    assert expert.dock.steps.next.text() == "Review cells"
    expert.click(expert.dock.steps.next)
    state, box, gallery = expert.workbench.review.state, expert.dock.verdict, expert.cells
    expert.write(box.rater, "Ada")
    expert.click_row(gallery.view, gallery.cells.index(0))
    for kind in VERDICTS:
        expert.press(gallery.view, getattr(Qt.Key, f"Key_{kind.key.upper()}"))
    assert state.cells.progress.judged == len(VERDICTS)
    expert.click_row(gallery.view, gallery.cells.index(1))
    expert.write(box.note, "from the busbar outwards")
    expert.photograph("5a-gallery")


def correct_marks(expert: Expert) -> None:
    """Show a cell large, paint a mark, judge it, go back."""
    gallery, state = expert.cells, expert.workbench.review.state
    expert.press(gallery.view, Qt.Key.Key_Return)
    view = large_cell(expert.workbench).view
    expert.until(lambda: view.frame is not None, "the best frame")
    cell = expert.model.selected_cell
    before = state.cells.features(cell).crack_length_cells
    expert.press(view, Qt.Key.Key_D)
    panel = view.cell_panel
    height, width = state.data.subject.tiles.shape(*cell)
    to = panel.transform()
    way = [to.map(QPointF(x * width, y * height)).toPoint() for x, y in ((0.2, 0.3), (0.7, 0.45))]
    expert.drag(panel, *way)
    expert.until(lambda: state.storage.pending == 0, "the stored marks")
    expert.wait(0.3)
    assert state.cells.features(cell).crack_length_cells > before + 0.2
    expert.photograph("5b-cell")
    expert.press(view, Qt.Key.Key_D, Qt.Key.Key_C)
    assert state.cells.verdict(cell).kind is VerdictKind.CRACK_C
    expert.undo()
    expert.until(lambda: state.storage.pending == 0, "the undone verdict")
    expert.wait(0.3)
    assert state.cells.verdict(cell).kind is VERDICTS[1]
    expert.press(view, Qt.Key.Key_Escape)


def export(expert: Expert, folder: Path) -> None:
    """Say which module it was, write table and report."""
    box = expert.dock.export
    scroll = expert.dock.pages.currentWidget()
    scroll.ensureWidgetVisible(box.export)
    expert.write(box.fields["serial_number"], "PV-0815")
    expert.write(box.fields["current_a"], "8.5")
    expert.click(box.export)
    expert.until((folder / "review.html").is_file, "the report", 60.0)
    expert.until(lambda: "review.html" in expert.dock.run.message.text(), "the sentence", 10.0)
    assert "PV-0815" in (folder / "review.html").read_text()
    expert.photograph("5c-report")


def come_back(
    expert: Expert, folder: Path, given: dict[Cell, VerdictKind], left_at: Cell | None
) -> None:
    """Open the result folder: all is as it was."""
    expert.choose(lambda: expert.click(expert.dock.open_folder), folder)
    expert.until(lambda: expert.model.inspection is not None, "the inspection")
    state = expert.workbench.review.state
    expert.until(
        lambda: state.storage.folder is not None and state.storage.pending == 0,
        "the verdicts",
        20.0,
    )
    expert.wait(1.0)
    assert expert.model.inspection.complete
    assert expert.model.selected_cell == left_at
    assert state.data.rater == "Ada"
    assert {cell: state.cells.verdict(cell).kind for cell in given} == given
    assert state.cells.note((0, 1)) == "from the busbar outwards"
    assert state.cells.correction((0, 1)) is not None
    assert state.storage.module_data.serial_number == "PV-0815"
    for name in ("Frames", "Fitted grid", "Crossing points", "Module image", "Cracks"):
        assert name in expert.viewer.layers, name
    expert.photograph("6-reopened")


def _button(within: QWidget, text: str) -> QPushButton:
    return next(b for b in within.findChildren(QPushButton) if b.text() == text)


def _verdicts(folder: Path) -> dict[Cell, Verdict]:
    with ReviewStore(folder) as store:
        return {verdict.cell: verdict for verdict in store.current()}


def main(arguments: list[str]) -> None:
    """Walk and leave the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sequence", type=Path, help="frames; the sample if not given")
    parser.add_argument("--rows", type=int, help="guessed if not given")
    parser.add_argument("--cols", type=int, help="guessed if not given")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args(arguments)
    if (options.rows is None) != (options.cols is None):
        parser.error("give both --rows and --cols, or none")
    walk(
        lambda: napari.Viewer(title="pv-inspect"),
        options.sequence or sample_folder(),
        options.out,
        None if options.rows is None else (options.rows, options.cols),
    )


if __name__ == "__main__":
    main(sys.argv[1:])
