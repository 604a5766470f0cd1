"""The forms: a control for every setting, built from its declaration, in step with the model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pytestqt.qtbot import QtBot
from qtpy.QtCore import Qt

from napari_pv_inspect.forms import controls
from napari_pv_inspect.forms.controls import control_of
from napari_pv_inspect.forms.form import SettingsForm
from napari_pv_inspect.models.workbench import WorkbenchModel
from pv_inspect.settings import Declaration, Group, Settings, Stage
from pv_inspect.settings.declaration import DeclaredModel, tunable

WITH_CONTROL = [name for name in Settings.model_fields if not Settings.declared(name).set_by]
OTHER_VALUES: dict[str, Any] = {
    "rows": 6,
    "cols": 10,
    "cell_aspect": 1.5,
    "row_gaps": "3:0.1",
    "col_gaps": "5:0.2, 8:0.1",
    "cell_gap": 0.05,
    "row_heights": "6:0.5",
    "col_widths": "1:0.5, 10:0.5",
    "module_at": (120.0, 80.5),
    "dark_frame": Path("dark.tif"),
    "flat_frame": Path("flat.tif"),
    "series": "EL",
    "lock_in": True,
    "max_frame_mpx": 20.0,
    "max_frames": 50,
    "kappa": -0.25,
    "focal_length_px": 900.0,
    "calibration_file": Path("lens.yaml"),
    "camera_profile": Path("camera.toml"),
    "module_of": "frame_003.tif",
    "registration_model": "homography",
    "magnification": 3.0,
    "prior_weight": 0.5,
    "psf_sigma_lr_px": 0.7,
    "prior": "btv",
    "motion_blur": "none",
    "second_pass": False,
    "max_iterations": 40,
    "crack_threshold": 0.6,
    "detector": "ridge",
    "cell_width_mm": 156.0,
}


@pytest.fixture
def forms(qtbot: QtBot) -> tuple[WorkbenchModel, dict[Group, SettingsForm]]:
    """One form for each group, on one model."""
    model = WorkbenchModel()
    made = {group: SettingsForm(model, group) for group in Group}
    for form in made.values():
        qtbot.addWidget(form)
    return model, made


@pytest.mark.parametrize("name", WITH_CONTROL)
def test_every_control_shows_and_gives_the_value_of_its_setting(qtbot: QtBot, name: str) -> None:
    control = control_of(name)
    qtbot.addWidget(control.native)
    default = Settings.model_fields[name].default
    assert control.value == default
    for value in (OTHER_VALUES[name], default):
        control.value = value
        assert control.value == value
        assert type(control.value) is type(value)
    assert Settings.model_fields[name].description in control.tooltip


def test_the_forms_have_a_control_for_every_setting_that_nothing_else_sets(forms: Any) -> None:
    model, made = forms
    for name in WITH_CONTROL:
        assert made[Settings.declared(name).group][name].objectName() == name
    model.change_settings(**OTHER_VALUES)
    for name, value in OTHER_VALUES.items():
        assert made[Settings.declared(name).group].value_of(name) == value


def test_a_change_of_a_control_is_a_change_of_the_settings(forms: Any, qtbot: QtBot) -> None:
    model, made = forms
    made[Group.MODULE]["rows"].setValue(6)
    made[Group.LENS]["kappa"].slider.setValue(100)
    made[Group.IMAGE]["prior"].setCurrentIndex(2)
    made[Group.IMAGE]["second_pass"].click()
    point = made[Group.MODULE]["module_at"]
    qtbot.keyClicks(point, "120, 80.5")
    qtbot.keyClick(point, Qt.Key.Key_Return)
    assert model.settings == Settings(
        rows=6, kappa=-0.3, prior="wbtv", second_pass=False, module_at=(120, 80.5)
    )
    made[Group.MODULE]["rows"].setValue(0)
    made[Group.LENS]["kappa"].automatic.click()
    assert model.settings.rows is None
    assert model.settings.kappa is None


def test_a_refused_value_is_told_and_the_control_goes_back(forms: Any, qtbot: QtBot) -> None:
    model, made = forms
    said: list[str] = []
    model.noticed.connect(lambda text, _: said.append(text))
    point = made[Group.MODULE]["module_at"]
    qtbot.keyClicks(point, "in the middle")
    qtbot.keyClick(point, Qt.Key.Key_Return)
    assert "module_at" in said[0]
    assert point.text() == ""
    made[Group.LENS]["focal_length_px"].setValue(10.0)  # must be larger
    assert "focal_length_px" in said[1]
    assert made[Group.LENS]["focal_length_px"].given() is None


def test_what_is_rarely_changed_is_folded_away_and_counted(forms: Any) -> None:
    model, made = forms
    form = made[Group.IMAGE]
    assert not form["max_iterations"].isVisibleTo(form)
    assert form["prior"].isVisibleTo(form)
    assert form.more.text() == "More"
    model.change_settings(max_iterations=50)
    assert form.more.text() == "More (1)"
    form.more.click()
    assert form["max_iterations"].isVisibleTo(form)


def test_a_new_setting_gets_its_control_from_its_declaration_alone(
    qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Extended(DeclaredModel):
        sharpness: float | None = tunable(
            None,
            Declaration(Stage.RECONSTRUCT, Group.IMAGE, "sharpness", slider=(0.0, 2.0)),
            "How sharp.",
            ge=0,
            le=4,
        )

    monkeypatch.setattr(controls, "Settings", Extended)
    control = control_of("sharpness")
    qtbot.addWidget(control.native)
    given: list[float | None] = []
    control.changed.connect(given.append)
    control.native.slider.setValue(200)
    control.native.automatic.click()
    assert given == [1.0, None]
    assert control.native.number.maximum() == 4.0
    assert "How sharp." in control.tooltip
