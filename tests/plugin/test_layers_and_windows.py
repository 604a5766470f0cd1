"""What people do to layers, docks and windows that are ours, while something is going on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pytestqt.qtbot import QtBot

from napari_pv_inspect.application import build
from napari_pv_inspect.models.workbench import RunState
from napari_pv_inspect.napari_internals import main_window
from pv_inspect.review import ReviewStore, VerdictKind

LAYERS = ("Frames", "Crossing points", "Fitted grid", "Module image", "Support", "Cracks")


def idle(dock: Any, qtbot: QtBot) -> None:
    qtbot.waitUntil(lambda: dock.workbench.model.run_state is RunState.IDLE)


@pytest.mark.parametrize("name", LAYERS)
def test_any_layer_may_be_renamed_and_another_run_goes_into_it(
    workbench: Any, replayed: Any, qtbot: QtBot, name: str
) -> None:
    viewer, dock, _ = workbench
    dock.run.run.click()
    idle(dock, qtbot)
    layers = list(viewer.layers)
    layer = viewer.layers[name]
    layer.name = "mine"
    dock.lens.form["kappa"].slider.setValue(100)
    dock.image.form["prior_weight"].number.setValue(2.0)
    dock.run.run.click()
    idle(dock, qtbot)
    assert layer.name == "mine"
    assert list(viewer.layers) == layers


def test_two_modules_in_two_windows_run_and_are_judged_at_once(
    make_napari_viewer: Callable[..., Any], tiny_folder: Path, tmp_path: Path, qtbot: QtBot
) -> None:
    viewers = [make_napari_viewer(), make_napari_viewer()]
    docks = [build(viewer)[0] for viewer in viewers]
    for dock in docks:
        dock.workbench.open(tiny_folder)
        qtbot.waitUntil(lambda d=dock: not d.workbench.opener.busy)
        dock.workbench.model.change_settings(
            magnification=2.0, max_iterations=3, psf_sigma_lr_px=0.5
        )
    for dock in docks:
        dock.run.run.click()
    assert all(dock.workbench.model.run_state is RunState.RUNNING for dock in docks)
    for dock in docks:
        idle(dock, qtbot)
        assert dock.workbench.model.inspection.complete
    for k, dock in enumerate(docks):
        dock.save(tmp_path / f"out{k}")
        state = dock.workbench.review.state
        qtbot.waitUntil(lambda s=state: s.storage.folder is not None)
        dock.workbench.model.select_cell((k, 0))
        dock.workbench.review.judge(VerdictKind.OK)
    viewers[0].close()
    docks[1].workbench.review.judge(VerdictKind.CRACK_A)
    viewers[1].close()
    found = [ReviewStore(tmp_path / f"out{k}").current() for k in range(2)]
    assert [[v.cell for v in one] for one in found] == [[(0, 0)], [(1, 0), (1, 1)]]


def test_two_windows_judge_the_same_result_at_once(
    make_napari_viewer: Callable[..., Any], tiny_inspection: Any, tmp_path: Path, qtbot: QtBot
) -> None:
    from pv_inspect.results.write import write_result

    write_result(tiny_inspection, tmp_path / "out")
    viewers = [make_napari_viewer(), make_napari_viewer()]
    docks = [build(viewer)[0] for viewer in viewers]
    for name, dock in zip(("Ada", "Ben"), docks, strict=True):
        dock.workbench.review.state.set_rater(name)
        dock.workbench.open(tmp_path / "out")
        state = dock.workbench.review.state
        qtbot.waitUntil(lambda s=state: s.storage.folder is not None and not s.storage.pending)
    for kind in (VerdictKind.OK, VerdictKind.CRACK_B):
        for dock in docks:
            dock.workbench.review.state.commands.give((0, 0), kind)
            dock.workbench.review.state.commands.give((1, 1), kind)
    for viewer in viewers:
        viewer.close()
    found = ReviewStore(tmp_path / "out").current()
    assert sorted((v.rater, v.cell) for v in found) == [
        ("Ada", (0, 0)),
        ("Ada", (1, 1)),
        ("Ben", (0, 0)),
        ("Ben", (1, 1)),
    ]
    assert {v.kind for v in found} == {VerdictKind.CRACK_B}


@pytest.mark.parametrize("dock_name", ["Inspect module", "Cells"])
def test_a_dock_may_be_closed_while_a_run_goes_on(
    workbench: Any, replayed: Any, qtbot: QtBot, dock_name: str
) -> None:
    viewer, dock, _ = workbench
    model = dock.workbench.model
    replayed.go_on = False
    dock.run.run.click()
    qtbot.waitUntil(lambda: "Module image" in viewer.layers)
    viewer.window.dock_widgets[dock_name].parentWidget().close()
    replayed.go_on = True
    qtbot.waitUntil(lambda: model.run_state is RunState.IDLE)
    assert model.inspection.complete


def test_closing_by_code_asks_once_before_anything_is_closed(
    make_napari_viewer: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, qtbot: QtBot
) -> None:
    viewer = make_napari_viewer()
    dock, _ = build(viewer)
    workbench, window = dock.workbench, main_window(viewer)
    canvas_class = type(window._qt_viewer)
    close_canvas, answers, closed = canvas_class.closeEvent, [True, False], []

    def closing(canvas: Any, event: Any) -> None:
        closed.append("canvas")
        close_canvas(canvas, event)

    monkeypatch.setattr(canvas_class, "closeEvent", closing)
    monkeypatch.setattr(workbench.review, "may_close", lambda _: answers.pop())
    viewer.close()
    assert (answers, closed) == ([True], [])
    window._qt_viewer.close()
    assert (answers, closed) == ([], ["canvas"])
    window.close()
