"""Presets: in the user's folder, or in files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from qtpy.QtWidgets import QInputDialog, QMenu, QMessageBox

from napari_pv_inspect.docks.preset_menu import PresetMenu
from napari_pv_inspect.models.history import History
from napari_pv_inspect.models.presets import PRESET_FIELDS, PresetStore, read_preset, write_preset
from napari_pv_inspect.models.trials import Tuning
from napari_pv_inspect.models.workbench import WorkbenchModel
from pv_inspect.errors import InspectionError
from pv_inspect.settings import Settings

SHARP = Settings(rows=6, cols=10, kappa=-0.1, prior="btv", prior_weight=0.3, second_pass=False)


def same(a: Settings, b: Settings) -> bool:
    return all(getattr(a, field) == getattr(b, field) for field in PRESET_FIELDS)


def test_a_preset_comes_back_without_what_belongs_to_the_module(tmp_path: Path) -> None:
    write_preset(SHARP, tmp_path / "sharp.toml")
    text = (tmp_path / "sharp.toml").read_text()
    assert not any(word in text for word in ("rows", "kappa", "frame"))
    assert same(read_preset(tmp_path / "sharp.toml"), SHARP)
    assert [p.name for p in tmp_path.iterdir()] == ["sharp.toml"]


def test_a_preset_that_can_not_be_written_leaves_the_old_one(tmp_path: Path) -> None:
    (tmp_path / "taken").mkdir()
    with pytest.raises(InspectionError, match="can't be written"):
        write_preset(Settings(), tmp_path / "taken")
    assert [p.name for p in tmp_path.iterdir()] == ["taken"]


def test_presets_are_kept_by_name(tmp_path: Path) -> None:
    store = PresetStore(tmp_path / "not" / "yet")
    assert store.names() == []
    assert store.save("  Für Modul 4, scharf & fein ", SHARP) == "Für Modul 4, scharf & fein"
    store.save("coarse", Settings(magnification=2.0))
    assert store.names() == ["coarse", "Für Modul 4, scharf & fein"]
    assert same(store.read("Für Modul 4, scharf & fein"), SHARP)
    store.delete("coarse")
    store.delete("coarse")
    assert store.names() == ["Für Modul 4, scharf & fein"]


def test_the_same_name_in_capitals_replaces_a_preset(tmp_path: Path) -> None:
    store = PresetStore(tmp_path)
    store.save("sharp", Settings())
    assert store.known(" SHARP ") == "sharp"
    store.save("Sharp", SHARP)
    assert store.names() == ["Sharp"]
    assert same(store.read("Sharp"), SHARP)


@pytest.mark.parametrize(
    "name", ["", "  ", "a/b", "..", ".x", "a:b", "con", "LPT1.x", "x" * 61, "\ud800"]
)
def test_a_name_that_no_file_can_have_is_one_sentence(name: str, tmp_path: Path) -> None:
    with pytest.raises(InspectionError, match="A preset can't be called"):
        PresetStore(tmp_path).save(name, SHARP)
    assert not list(tmp_path.iterdir())


@pytest.fixture
def menu(qtbot: Any, tmp_path: Path) -> PresetMenu:
    """The button without presets."""
    model = WorkbenchModel()
    button = PresetMenu(model, Tuning(model, History()))
    button.store = PresetStore(tmp_path)
    qtbot.addWidget(button)
    return button


def notices(menu: PresetMenu) -> list[str]:
    said: list[str] = []
    menu.model.noticed.connect(lambda text, _: said.append(text))
    return said


def entries(menu: PresetMenu) -> dict[str, bool]:
    menu.refill()
    return {
        action.text(): action.isChecked()
        for action in menu.menu().actions()
        if action.text() and action.isCheckable()
    }


def test_to_apply_is_one_edit_and_leaves_the_module_alone(menu: PresetMenu) -> None:
    model, history = menu.model, menu.tuning.history
    menu.store.save("smooth", Settings(prior="tikhonov", magnification=3.0))
    model.change_settings(rows=6, cols=10, prior_weight=2.0)
    menu.tuning.commit()
    menu.apply("smooth")
    assert (model.settings.prior, model.settings.prior_weight) == ("tikhonov", None)
    assert model.settings.rows == 6
    history.undo()
    assert (model.settings.prior, model.settings.prior_weight) == ("learned", 2.0)
    menu.apply("Automatic")
    assert same(model.settings, Settings())
    assert model.settings.rows == 6
    history.undo()
    assert model.settings.prior_weight == 2.0


def test_the_menu_lists_the_presets_and_marks_what_is_shown(menu: PresetMenu) -> None:
    assert entries(menu) == {"Automatic": True}
    menu.model.change_settings(prior_weight=2.0)
    menu.keep("strong & fine")
    assert entries(menu) == {"Automatic": False, "strong && fine": True}
    menu.apply("Automatic")
    assert entries(menu) == {"Automatic": True, "strong && fine": False}
    menu.remove("strong & fine")
    assert entries(menu) == {"Automatic": True}
    assert len(menu.menu().findChildren(QMenu)) == 1, "what was listed before is gone"


def test_a_damaged_preset_is_listed_and_one_sentence(menu: PresetMenu) -> None:
    (menu.store.folder / "broken.toml").write_text("= 3")
    said = notices(menu)
    assert entries(menu) == {"Automatic": True, "broken": False}
    menu.apply("broken")
    assert "not valid TOML" in said[-1]
    menu.keep("automatic")
    assert "choose another name" in said[-1]


@pytest.mark.parametrize("yes", [True, False])
def test_to_replace_or_to_delete_is_asked_first(
    yes: bool, menu: PresetMenu, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = QMessageBox.StandardButton.Yes if yes else QMessageBox.StandardButton.No
    monkeypatch.setattr(QMessageBox, "question", lambda *_: answer)
    monkeypatch.setattr(QInputDialog, "getText", lambda *_: ("mine", True))
    menu.ask_to_keep()
    assert menu.store.names() == ["mine"]
    menu.model.change_settings(prior="btv")
    menu.ask_to_keep()
    assert (menu.store.read("mine").prior == "btv") is yes
    menu.ask_to_remove("mine")
    assert menu.store.names() == ([] if yes else ["mine"])


def test_files_are_loaded_and_written(menu: PresetMenu, tmp_path: Path) -> None:
    model = menu.model
    model.change_settings(prior="btv", psf_sigma_lr_px=0.5)
    menu.export(tmp_path / "mine")
    model.change_settings(prior="learned", psf_sigma_lr_px=None)
    menu.load(tmp_path / "mine.toml")
    assert (model.settings.prior, model.settings.psf_sigma_lr_px) == ("btv", 0.5)
    said = notices(menu)
    menu.load(tmp_path / "none.toml")
    assert "can't be read" in said[-1]
