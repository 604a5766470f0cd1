"""The live cell in a real window: it follows the sliders and is compared."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest
from qtpy.QtCore import QPoint, QPointF, QSize, Qt
from qtpy.QtGui import QImage
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QApplication, QDockWidget

from napari_pv_inspect.docks.gallery import CellsDock
from napari_pv_inspect.docks.inspect import InspectDock
from napari_pv_inspect.docks.live_cell import LiveDock
from napari_pv_inspect.docks.placing import show_live_cell
from napari_pv_inspect.live.cell import Source
from napari_pv_inspect.live.cell_renderer import (
    CellRenderer,
    bicubic_cell,
    default_cell,
    registration_for,
    run_cell,
)
from napari_pv_inspect.models.workbench import RunState
from napari_pv_inspect.widgets.lambda_plot import LambdaPlot
from napari_pv_inspect.widgets.swipe_view import SwipeView, grey_image
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.reconstruction.prior_weight import typical_prior_weight
from pv_inspect.results.read import read_result
from pv_inspect.results.write import write_result
from pv_inspect.settings import Settings
from tests.waiting import LONG_S

Bench = tuple[Any, InspectDock, CellsDock]


@pytest.fixture
def live(workbench: Bench, tiny_inspection: Inspection, qtbot: Any) -> tuple[InspectDock, LiveDock]:
    """The workbench with a whole inspection and the live cell open."""
    _, dock, _ = workbench
    model = dock.workbench.model
    model.revise(tiny_inspection)
    shown = show_live_cell(dock.workbench, dock)
    dock.workbench.live_cell.set_active(True)
    qtbot.waitUntil(lambda: has_ended(shown))
    return dock, shown


def has_ended(live: LiveDock) -> bool:
    picture = live.picture
    return (
        picture is not None
        and picture.finished
        and picture.settings == live.workbench.model.settings
    )


def settled(qtbot: Any, live: LiveDock) -> None:
    qtbot.waitUntil(lambda: has_ended(live))
    live.workbench.live_cell.commit()


def test_the_first_cell_is_the_most_suspicious_one(tiny_inspection: Inspection) -> None:
    cell = default_cell(tiny_inspection)
    assert tiny_inspection.cracks is not None
    scores = {(c.row, c.col): c.crack_score for c in tiny_inspection.cracks.cells}
    assert scores[cell] == max(scores.values())
    assert default_cell(replace(tiny_inspection, cracks=None)) == (1, 2)


def test_all_pictures_of_a_cell_show_the_same_place(
    tiny_inspection: Inspection, tiny_settings: Settings
) -> None:
    cell = (1, 1)
    run = run_cell(tiny_inspection, cell)
    assert run is not None
    *_, live = (p for p in CellRenderer().pictures(tiny_inspection, cell, tiny_settings) if p)
    plain = bicubic_cell(tiny_inspection, cell, tiny_settings.magnification)
    assert live.finished
    assert live.image.shape == run.image.shape == plain.image.shape
    for other in (live, plain):
        assert np.corrcoef(run.image.ravel(), other.image.ravel())[0, 1] > 0.8


def test_frames_left_out_and_kappa_change_the_geometry_of_the_live_cell(
    tiny_inspection: Inspection, tiny_settings: Settings
) -> None:
    names = tiny_inspection.sequence.names
    there = registration_for(tiny_inspection, tiny_settings.changed(skip_frames=names[:2]))
    assert not there.used[:2].any()
    assert there.used[2:].any()
    bent = registration_for(tiny_inspection, tiny_settings.changed(kappa=0.01))
    assert bent.camera.kappa == 0.01
    with pytest.raises(InspectionError, match="All frames are left out"):
        registration_for(tiny_inspection, tiny_settings.changed(skip_frames=names))


def test_the_live_cell_follows_a_slider(live: tuple[InspectDock, LiveDock], qtbot: Any) -> None:
    dock, shown = live
    roughness = []
    for position in (300, 700):
        dock.image.form["prior_weight"].slider.setValue(position)
        qtbot.waitUntil(lambda: has_ended(shown))
        shown_weight = dock.image.form["prior_weight"].number.value()
        assert f"lambda {shown_weight:.3g}" in shown.caption.text()
        roughness.append(float(np.abs(np.diff(shown.picture.image, 2, axis=1)).mean()))
    # A prior a hundred times as strong leaves less curvature.
    assert roughness[1] < 0.9 * roughness[0]


def test_the_grid_is_redrawn_for_the_lens_only(
    live: tuple[InspectDock, LiveDock], qtbot: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    dock, _ = live
    drawn: list[int] = []
    monkeypatch.setattr(
        dock.workbench.geometry, "replace_frame", lambda frame, _: drawn.append(frame)
    )
    dock.lens.form["kappa"].slider.setValue(dock.lens.form["kappa"].slider.value() + 20)
    qtbot.waitUntil(lambda: bool(drawn))
    qtbot.wait(200)
    drawn.clear()
    for position in (300, 310, 320):
        dock.image.form["prior_weight"].slider.setValue(position)
        qtbot.wait(100)
    assert not drawn


def test_a_settled_slider_is_a_trial_and_undo_takes_it_back(
    live: tuple[InspectDock, LiveDock], qtbot: Any
) -> None:
    dock, shown = live
    settled(qtbot, shown)
    for position in (300, 320, 340):
        dock.image.form["prior_weight"].slider.setValue(position)
    settled(qtbot, shown)
    assert len(dock.workbench.tuning.trials) == 2
    assert shown.trials.trials.rowCount() == 2
    assert shown.trials.view.model().index(1).data().startswith("lambda")
    dock.workbench.history.undo()
    assert dock.workbench.model.settings.prior_weight is None
    assert dock.image.form["prior_weight"].automatic.isChecked()


@pytest.mark.parametrize("source", [Source.BICUBIC, Source.PREVIOUS, Source.RUN, 1])
def test_it_is_compared_with(
    source: Source | int, live: tuple[InspectDock, LiveDock], qtbot: Any
) -> None:
    dock, shown = live
    settled(qtbot, shown)
    dock.workbench.model.change_settings(prior_weight=5.0)
    settled(qtbot, shown)
    shown.compare(source)
    qtbot.waitUntil(lambda: shown.view.pictures[0][0] is not None)
    shown.compare(Source.NOTHING)
    assert shown.view.pictures[0][0] is None


def test_a_trial_of_another_cell_is_rendered_for_this_one(
    live: tuple[InspectDock, LiveDock], qtbot: Any
) -> None:
    dock, shown = live
    settled(qtbot, shown)
    trial = dock.workbench.tuning.trials[0]
    other = (2, 3) if trial.picture.cell != (2, 3) else (0, 0)
    dock.workbench.model.select_cell(other)
    qtbot.waitUntil(lambda: shown.picture.cell == other)
    cell = dock.workbench.live_cell
    qtbot.waitUntil(lambda: cell.reference(trial) is not None)
    assert cell.reference(trial).cell == other


def test_a_trial_is_named_in_place(live: tuple[InspectDock, LiveDock], qtbot: Any) -> None:
    dock, shown = live
    settled(qtbot, shown)
    index = shown.trials.trials.index(0)
    assert shown.trials.trials.setData(index, "good")
    assert index.data() == "good"
    dock.workbench.history.undo()
    assert index.data() == "first setting"


def test_two_selected_trials_are_compared_with_each_other(
    live: tuple[InspectDock, LiveDock], qtbot: Any
) -> None:
    dock, shown = live
    settled(qtbot, shown)
    dock.workbench.model.change_settings(prior_weight=5.0)
    settled(qtbot, shown)
    shown.trials.view.selectAll()
    assert (shown.against.choice, shown.shown.choice) == (1, 2)
    assert texts(shown) == ["first setting", "lambda 5"]
    shown.trials.view.setCurrentIndex(shown.trials.trials.index(1))
    assert texts(shown) == ["lambda 5", "live"]


def texts(live: LiveDock) -> list[str]:
    return [text for _, text in live.view.pictures]


def test_any_trial_is_compared_with_bicubic_and_with_any_other(
    live: tuple[InspectDock, LiveDock], qtbot: Any
) -> None:
    dock, shown = live
    settled(qtbot, shown)
    for weight in (5.0, 7.0):
        dock.workbench.model.change_settings(prior_weight=weight)
        settled(qtbot, shown)
    in_list = [shown.against.itemText(k) for k in range(shown.against.count())]
    assert in_list[-3:] == ["first setting", "lambda 5", "lambda 7"]
    shown.compare(Source.BICUBIC, 2)
    qtbot.waitUntil(lambda: texts(shown)[0].startswith("bicubic, "))
    assert texts(shown)[1] == "lambda 5"
    shown.compare(3, 1)
    assert texts(shown) == ["lambda 7", "first setting"]
    other = (2, 3) if shown.picture.cell != (2, 3) else (0, 0)
    dock.workbench.model.select_cell(other)
    cell = dock.workbench.live_cell
    first, _, third = dock.workbench.tuning.trials
    qtbot.waitUntil(lambda: cell.reference(first) is not None and cell.reference(third) is not None)
    assert texts(shown) == ["lambda 7", "first setting"]
    # Who moves a control wants to see what it does.
    dock.workbench.model.change_settings(prior_weight=6.0)
    assert texts(shown) == ["lambda 7", "live"]


def test_a_named_trial_has_its_name_on_both_sides(
    live: tuple[InspectDock, LiveDock], qtbot: Any
) -> None:
    dock, shown = live
    settled(qtbot, shown)
    shown.compare(1)
    dock.workbench.tuning.rename(dock.workbench.tuning.trials[0], "sharp")
    assert texts(shown) == ["sharp", "live"]
    assert shown.against.currentText() == "sharp"
    dock.workbench.model.open(dock.workbench.model.sequence)
    assert shown.against.choice is Source.BICUBIC


def test_the_comparison_is_driven_by_keys(live: tuple[InspectDock, LiveDock]) -> None:
    dock, shown = live
    group = {key.sequence for key in dock.workbench.shortcuts.keys if key.group == "Live cell"}
    assert group == {"F", "Left", "Right", "Home", "End"}
    shown.view.step(2)
    assert shown.view.divider == pytest.approx(0.6)
    QTest.keyClick(shown.view, Qt.Key.Key_Left)
    assert shown.view.divider == pytest.approx(0.55)


def test_it_computes_only_while_it_is_seen(live: tuple[InspectDock, LiveDock], qtbot: Any) -> None:
    dock, shown = live
    dock.workbench.live_cell.set_active(False)
    before = shown.picture
    dock.workbench.model.change_settings(prior_weight=7.0)
    qtbot.wait(300)
    assert shown.picture is before
    dock.workbench.live_cell.set_active(True)
    qtbot.waitUntil(lambda: has_ended(shown))


def test_a_geometry_out_of_reach_is_one_sentence(
    live: tuple[InspectDock, LiveDock], qtbot: Any
) -> None:
    dock, shown = live
    names = dock.workbench.model.sequence.names
    dock.workbench.model.change_settings(skip_frames=names)
    qtbot.waitUntil(lambda: "All frames are left out" in shown.caption.text())


def test_dragging_while_a_run_goes_on_drops_what_is_stale_and_ends_at_the_last_setting(
    live: tuple[InspectDock, LiveDock],
    qtbot: Any,
    replayed: Any,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    dock, shown = live
    model = dock.workbench.model
    replayed.go_on = False
    assert dock.workbench.runs.start()
    asked: list[Settings] = []
    render, go_on = CellRenderer.pictures, Event()

    def slow(self: CellRenderer, *given: Any) -> Iterator[Any]:
        asked.append(given[2])
        go_on.wait(LONG_S)
        yield from render(self, *given)

    monkeypatch.setattr(CellRenderer, "pictures", slow)
    for position in range(200, 350):
        dock.image.form["prior_weight"].slider.setValue(position)
        QApplication.processEvents()
    go_on.set()
    qtbot.waitUntil(lambda: has_ended(shown))
    assert model.run_state is RunState.RUNNING
    assert asked[-1] == model.settings
    assert len(asked) <= 2
    dock.workbench.runs.cancel()
    qtbot.waitUntil(lambda: model.run_state is RunState.IDLE)
    assert has_ended(shown)


def test_a_picture_of_a_geometry_that_is_gone_is_not_shown(
    live: tuple[InspectDock, LiveDock], qtbot: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    dock, shown = live
    settled(qtbot, shown)
    model, render, begun, go_on = dock.workbench.model, CellRenderer.pictures, Event(), Event()
    before = model.inspection
    late: list[Any] = []

    def slow(self: CellRenderer, *given: Any) -> Iterator[Any]:
        if given[0] is not before:
            yield from render(self, *given)
            return
        for picture in render(self, *given):
            if picture is not None:
                begun.set()
                assert go_on.wait(LONG_S)
                late.append(picture)
            yield picture

    monkeypatch.setattr(CellRenderer, "pictures", slow)
    arrived: list[Any] = []
    dock.workbench.live_cell.pictured.connect(arrived.append)
    model.change_settings(prior_weight=4.0)
    assert begun.wait(LONG_S)
    model.revise(replace(before, registration=replace(before.registration)))
    go_on.set()
    qtbot.waitUntil(lambda: bool(arrived) and arrived[-1].finished)
    assert any(picture is not None for picture in late)
    assert not any(one is other for one in arrived for other in late)


def test_without_a_run_it_says_what_is_needed(workbench: Bench) -> None:
    _, dock, _ = workbench
    shown = show_live_cell(dock.workbench, dock)
    assert "Run once first" in shown.view.message
    assert show_live_cell(dock.workbench, dock) is shown


def test_a_result_without_its_frames_says_where_they_were_looked_for(
    workbench: Bench, tiny_inspection: Inspection, tmp_path: Path
) -> None:
    _, dock, _ = workbench
    shown = show_live_cell(dock.workbench, dock)
    write_result(tiny_inspection, tmp_path / "out")
    why = "The frames are no longer at /somewhere."
    dock.workbench.model.open_result(read_result(tmp_path / "out"), why)
    assert shown.view.message == why
    assert dock.image.plot.why == why
    dock.workbench.model.open(tiny_inspection.sequence)
    assert "Run once first" in shown.view.message
    assert "Run once" in dock.image.plot.why


def test_the_view_is_fitted_once_the_canvas_has_its_size(
    workbench: Bench, monkeypatch: pytest.MonkeyPatch, qtbot: Any
) -> None:
    _, dock, _ = workbench
    own, fitted = dock.workbench, []
    qtbot.waitUntil(lambda: not own.is_fitting)
    canvas = own.viewer.canvas
    monkeypatch.setattr(own.navigator, "fit", lambda: fitted.append(tuple(canvas.size)))
    for _ in range(2):  # when it is made, and when it comes back
        show_live_cell(own, dock)
        canvas.size = (300, 400)
        own.fit_if_laid_out()
        canvas.size = (300, 280)
        own.fit_if_laid_out()
        assert fitted == []
        qtbot.waitUntil(lambda: bool(fitted))
        fitted.clear()


def test_a_workbench_that_closes_while_the_live_cell_is_at_work_shows_nothing_more(
    live: tuple[InspectDock, LiveDock], qtbot: Any
) -> None:
    dock, _ = live
    arrived: list[Any] = []
    dock.workbench.live_cell.pictured.connect(arrived.append)
    dock.workbench.live_cell.failed.connect(arrived.append)
    dock.workbench.model.change_settings(prior_weight=3.0)
    dock.workbench.close()
    arrived.clear()
    dock.workbench.model.change_settings(prior_weight=4.0)
    qtbot.wait(300)
    assert arrived == []


def test_the_automatic_lambda_of_another_prior_is_the_one_the_live_cell_uses(
    live: tuple[InspectDock, LiveDock], qtbot: Any
) -> None:
    dock, shown = live
    dock.workbench.model.change_settings(prior="tikhonov")
    qtbot.waitUntil(lambda: has_ended(shown))
    expected = typical_prior_weight("tikhonov")
    assert f"lambda {expected:.3g}" in shown.caption.text()
    assert dock.image.form["prior_weight"].number.value() == pytest.approx(expected, abs=1e-4)


def test_a_click_on_the_curve_sets_lambda(live: tuple[InspectDock, LiveDock]) -> None:
    dock, _ = live
    plot = dock.image.plot
    at = QPointF(plot.x_of(0.5), plot.height() / 2)
    QTest.mouseClick(plot, Qt.MouseButton.LeftButton, pos=at.toPoint())
    assert dock.workbench.model.settings.prior_weight == pytest.approx(0.5, rel=0.1)
    assert dock.workbench.history.undo_text == "Change lambda"


@pytest.mark.usefixtures("viewer")
def test_the_axis_of_lambda_is_logarithmic_and_inverts() -> None:
    plot = LambdaPlot()
    plot.resize(300, 112)
    plot.show_curve(((0.1, 1.2), (1.0, 1.0), (10.0, 1.5)), 1.0)
    assert plot.x_of(1.0) - plot.x_of(0.1) == pytest.approx(plot.x_of(10.0) - plot.x_of(1.0))
    assert plot.weight_at(plot.x_of(0.5)) == pytest.approx(0.5, rel=0.01)
    assert plot.x_of(1e9) == plot.x_of(15.0)
    plot.grab()


@pytest.mark.usefixtures("viewer")
def test_the_divider_parts_the_two_pictures() -> None:
    view = SwipeView()
    view.resize(200, 200)
    view.show_before(grey_image(np.zeros((50, 50), np.float32), (0.0, 1.0)), "")
    view.show_after(grey_image(np.ones((50, 50), np.float32), (0.0, 1.0)), "")
    QTest.mouseClick(view, Qt.MouseButton.LeftButton, pos=QPoint(60, 150))
    assert view.divider == pytest.approx(0.3, abs=0.02)
    assert (grey_at(view, 20), grey_at(view, 150)) == (0, 255)
    QTest.keyPress(view, Qt.Key.Key_Space)
    assert grey_at(view, 150) == 0
    QTest.keyRelease(view, Qt.Key.Key_Space)
    assert grey_at(view, 150) == 255
    view.set_flicker(True)
    view.alternate()
    assert grey_at(view, 150) == 0
    view.set_flicker(False)
    assert grey_at(view, 150) == 255


def grey_at(view: SwipeView, x: int) -> int:
    image = QImage(QSize(200, 200), QImage.Format.Format_RGB32)
    view.render(image)
    return int(image.pixelColor(x, 150).green())


def test_grey_images_share_one_contrast() -> None:
    image = grey_image(np.array([[0.0, 0.5], [1.0, 2.0]], np.float32), (0.0, 1.0))
    assert [image.pixelColor(*at).red() for at in ((0, 0), (1, 0), (0, 1), (1, 1))] == [
        0,
        127,
        255,
        255,
    ]


def test_a_dock_that_was_closed_comes_back(live: tuple[InspectDock, LiveDock], qtbot: Any) -> None:
    dock, shown = live
    place = shown.parentWidget()
    while not isinstance(place, QDockWidget):
        place = place.parentWidget()
    place.destroyOnClose()
    qtbot.wait(50)
    dock.image.form["prior_weight"].slider.setValue(200)
    again = show_live_cell(dock.workbench, dock)
    assert again is not shown
    dock.workbench.live_cell.set_active(True)
    qtbot.waitUntil(lambda: has_ended(again))
