"""A camera profile is made of results that the user picks, and used."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pytestqt.qtbot import QtBot
from qtpy.QtCore import QModelIndex, Qt

from pv_inspect.calibration.camera_profile import read_profile
from tests.camera_results import written_result


@pytest.fixture
def lens(workbench: Any) -> Any:
    """Lens box; a window that a test leaves open is closed."""
    box = workbench[1].lens
    yield box
    box.close_maker()


def pooled(box: Any, qtbot: QtBot) -> Any:
    """The window, when it has pooled."""
    qtbot.waitUntil(lambda: box.maker.profile is not None)
    return box.maker


def test_the_result_that_is_open_is_pooled_with_others_and_used(
    saved: Any, tmp_path: Path, qtbot: QtBot
) -> None:
    _, dock, _ = saved
    box, model = dock.lens, dock.workbench.model
    box.make_profile.click()
    window = pooled(box, qtbot)
    assert window.folders == [(tmp_path / "out").resolve()]
    height, width = model.sequence.shape
    window.add(written_result(tmp_path / "other", frame_px=[width, height]))
    assert pooled(box, qtbot).profile.results == 2
    path = tmp_path / "camera.toml"
    window.write(path)
    assert box.maker is None
    assert read_profile(path).results == 2
    assert model.settings.camera_profile == path
    assert box.form["camera_profile"].name.text() == "camera.toml"


def test_outliers_are_told_and_left_out_by_hand(lens: Any, tmp_path: Path, qtbot: QtBot) -> None:
    for name in "abcd":
        written_result(tmp_path / name)
    written_result(tmp_path / "odd", psf_sigma_lr_px=0.9)
    lens.show_maker()
    assert not lens.maker.save.isEnabled()
    assert "Add results" in lens.maker.says.text()
    lens.maker.add(tmp_path)
    window = pooled(lens, qtbot)
    assert "Pooled from 5 results:" in window.says.text()
    assert "blur 0.500 \u00b1" in window.says.text()
    assert "odd is 0.9, of the others 0.5: left out." in window.notes.label.text()
    window.results.item(4).setCheckState(Qt.CheckState.Unchecked)
    assert window.profile is None
    window = pooled(lens, qtbot)
    assert window.profile.results == 4
    assert window.notes.isHidden()
    window.add(tmp_path)
    assert window.results.count() == 5
    window.results.item(4).setSelected(True)
    window.remove.click()
    assert window.results.count() == 4


def test_a_drift_follows_the_order_of_the_list(lens: Any, tmp_path: Path, qtbot: QtBot) -> None:
    for k in range(8):
        written_result(
            tmp_path / f"run_{k}",
            psf_sigma_lr_px=0.5 + 0.01 * k,
            psf={"error_lr_px": 0.01, "evidence": "borders", "shape": "gaussian"},
        )
    lens.show_maker()
    lens.maker.add(tmp_path)
    assert "drifts by +0.07" in pooled(lens, qtbot).notes.label.text()
    rows = lens.maker.results.model()
    for k in range(1, 8):
        rows.moveRow(QModelIndex(), k, QModelIndex(), 0)
    assert lens.maker.folders[0].name == "run_7"
    assert "drifts by -0.07" in pooled(lens, qtbot).notes.label.text()


def test_what_is_no_evidence_is_told_and_nothing_can_be_saved(
    lens: Any, tmp_path: Path, qtbot: QtBot
) -> None:
    lens.show_maker()
    window = lens.maker
    window.add(written_result(tmp_path / "a", settings={"camera_profile": "camera.toml"}))
    qtbot.waitUntil(lambda: "no evidence of its own" in window.notes.label.text())
    assert not window.save.isEnabled()
    told: list[tuple[str, bool]] = []
    lens.maker._model.noticed.connect(lambda text, bad: told.append((text, bad)))
    (tmp_path / "empty").mkdir()
    window.add(tmp_path / "empty")
    assert told[0][1]
    assert "holds none" in told[0][0]


def test_a_profile_of_another_camera_is_refused(lens: Any, workbench: Any, tmp_path: Path) -> None:
    model = workbench[1].workbench.model
    told: list[str] = []
    model.noticed.connect(lambda text, _: told.append(text))
    path = tmp_path / "camera.toml"
    path.write_text("width = 99\nheight = 98\nresults = 1\n")
    lens.load_profile(path)
    assert "the profile of a camera of 99 x 98 px" in told[0]
    assert model.settings.camera_profile is None


def test_the_window_goes_with_the_viewer(workbench: Any) -> None:
    _, dock, _ = workbench
    dock.lens.show_maker()
    dock.workbench.closing.emit()
    assert dock.lens.maker is None
