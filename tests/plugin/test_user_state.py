"""What the workbench remembers for its user from one session to the next."""

from __future__ import annotations

from pathlib import Path

import pytest

from napari_pv_inspect.models.history import History
from napari_pv_inspect.models.presets import PresetStore
from napari_pv_inspect.models.workbench import WorkbenchModel
from napari_pv_inspect.review.controller import Reviewer
from napari_pv_inspect.user_state import (
    UserState,
    presets_folder,
    read_user_state,
    write_user_state,
)
from pv_inspect.errors import InspectionError
from pv_inspect.settings import Settings


def file() -> Path:
    return presets_folder().with_name("user.json")


def test_who_judges_is_remembered(qapp: object) -> None:
    Reviewer(WorkbenchModel(), History()).set_rater("Grace")
    assert Reviewer(WorkbenchModel(), History()).state.data.rater == "Grace"
    assert file().is_file()


@pytest.mark.parametrize("content", ["", "[]", '{"rater": 5}', '{"format": 99, "rater": "Ada"}'])
def test_what_can_not_be_read_is_forgotten(content: str) -> None:
    file().parent.mkdir(parents=True)
    file().write_text(content, encoding="utf-8")
    assert read_user_state() == UserState()
    write_user_state(UserState(rater="Ada"))
    assert read_user_state().rater == "Ada"


def test_a_folder_that_can_not_be_made_is_one_notice(qapp: object, tmp_path: Path) -> None:
    (tmp_path / "config").write_text("in the way", encoding="utf-8")
    with pytest.raises(InspectionError, match="can't be made"):
        write_user_state(UserState(rater="Ada"))
    model = WorkbenchModel()
    said: list[str] = []
    model.noticed.connect(lambda text, _: said.append(text))
    reviewer = Reviewer(model, History())
    reviewer.set_rater("Ada")
    assert reviewer.state.data.rater == "Ada"
    assert "can't be made" in said[0]


def test_presets_lie_beside_it() -> None:
    PresetStore().save("Sharp", Settings(prior="btv"))
    assert [path.name for path in presets_folder().iterdir()] == ["Sharp.toml"]
