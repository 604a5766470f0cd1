"""The lens box: curve over kappa, camera files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pytestqt.qtbot import QtBot
from qtpy.QtGui import QImage

from napari_pv_inspect.live.kappa_curve import Curve
from napari_pv_inspect.widgets.kappa_plot import CurveView


@pytest.fixture
def lens(workbench: Any, replayed: Any) -> tuple[Any, Any]:
    """Dock and lens box with a fit open."""
    _, dock, _ = workbench
    dock.workbench.model.revise(replayed.inspection)
    return dock, dock.lens


def test_the_curve_has_its_lowest_point_at_the_fit(lens: Any, qtbot: QtBot) -> None:
    dock, box = lens
    qtbot.waitUntil(lambda: box.curve.curve is not None)
    curve = box.curve.curve
    fitted = dock.workbench.model.inspection.calibration.camera.kappa
    assert curve.best == pytest.approx(fitted)
    lowest = curve.kappas[np.nanargmin(curve.rms_px)]
    # A tiny module tells kappa to a step of the curve.
    assert abs(lowest - fitted) <= 0.1
    assert curve.at(fitted) <= np.nanmax(curve.rms_px)


def test_the_mark_follows_the_slider_and_fit_brings_it_back(lens: Any) -> None:
    dock, box = lens
    fitted = dock.workbench.model.inspection.registration.camera.kappa
    assert box.curve.kappa == pytest.approx(fitted)
    box.form["kappa"].number.setValue(0.123)
    assert box.curve.kappa == pytest.approx(0.123)
    box.form["kappa"].automatic.click()
    assert box.curve.kappa == pytest.approx(fitted)


def refined(inspection: Any) -> Any:
    """The same, as if the registration had found another kappa than the crossing points."""
    poses = inspection.registration
    camera = replace(poses.camera, kappa=poses.camera.kappa + 0.0031)
    return replace(inspection, registration=replace(poses, camera=camera))


def test_kappa_is_the_same_on_the_page_and_in_the_footer(lens: Any, qtbot: QtBot) -> None:
    dock, box = lens
    whole = refined(dock.workbench.model.inspection)
    dock.workbench.model.revise(whole)
    assert box.form["kappa"].number.value() == pytest.approx(
        whole.registration.camera.kappa, abs=1e-4
    )
    kappa = f"kappa {whole.registration.camera.kappa:+.4f}"
    assert kappa in dock.result.summary.text()
    qtbot.waitUntil(lambda: kappa in box.residual.text())
    assert "preliminary" not in box.residual.text() + dock.result.summary.text()
    early = whole.with_part(whole.calibration)
    dock.workbench.model.revise(early)
    kappa = f"preliminary kappa {whole.calibration.camera.kappa:+.4f}"
    assert kappa in dock.result.summary.text()
    qtbot.waitUntil(lambda: kappa in box.residual.text())


def test_the_drawing_shows_curve_and_marks(qtbot: QtBot) -> None:
    view = CurveView()
    qtbot.addWidget(view)
    view.resize(240, 90)
    empty = view.grab().toImage()
    kappas = np.linspace(-0.6, 0.6, 25)
    view.show_curve(Curve(kappas, np.where(kappas < -0.5, np.nan, kappas**2), 0.0))
    drawn = view.grab().toImage()
    view.mark(0.3)
    marked = view.grab().toImage()
    assert colours(drawn) > colours(empty)
    assert marked != drawn


def colours(image: QImage) -> int:
    return len({image.pixel(x, y) for x in range(image.width()) for y in range(image.height())})


def test_a_saved_camera_is_loaded_named_and_cleared(lens: Any, tmp_path: Path) -> None:
    dock, box = lens
    model = dock.workbench.model
    path = tmp_path / "lens.yaml"
    box.save_camera(path)
    box.form["kappa"].number.setValue(0.2)
    box.load_camera(path)
    assert model.settings.calibration_file == path
    assert model.settings.kappa is None
    file = box.form["calibration_file"]
    assert file.name.text() == "lens.yaml"
    assert file.clear.isEnabled()
    file.clear.click()
    assert model.settings.calibration_file is None
    assert file.name.text() == "none"
    assert not file.clear.isEnabled()


def test_a_useless_camera_file_is_one_sentence(lens: Any, tmp_path: Path) -> None:
    dock, box = lens
    told: list[tuple[str, bool]] = []
    dock.workbench.model.noticed.connect(lambda text, bad: told.append((text, bad)))
    path = tmp_path / "wrong.yaml"
    path.write_text("nothing: 1\n")
    box.load_camera(path)
    box.save_camera(tmp_path / "missing" / "camera.yaml")
    assert [bad for _, bad in told] == [True, True]
    assert "camera matrix" in told[0][0]
    assert dock.workbench.model.settings.calibration_file is None
