from __future__ import annotations

from pathlib import Path

import pytest

from pv_inspect.session import Session, read_session, write_session

LOOKED = Session((2, 3), 7, "Frames", (10.5, 20.0), 1.5)


@pytest.mark.parametrize("session", [LOOKED, Session()])
def test_what_was_looked_at_comes_back(tmp_path: Path, session: Session) -> None:
    assert write_session(session, tmp_path)
    assert read_session(tmp_path) == session
    assert [path.name for path in tmp_path.iterdir()] == ["session.json"]


@pytest.mark.parametrize("text", [None, "{", "[]", '{"cell": [1]}', "{}"])
def test_a_missing_or_damaged_record_is_the_default(tmp_path: Path, text: str | None) -> None:
    if text is not None:
        (tmp_path / "session.json").write_text(text)
    assert read_session(tmp_path) == Session()


def test_a_folder_that_went_away_is_no_error(tmp_path: Path) -> None:
    assert not write_session(LOOKED, tmp_path / "gone")
