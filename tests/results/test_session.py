from __future__ import annotations

from pathlib import Path

import pytest

from pv_inspect.errors import InspectionError
from pv_inspect.results.session import Session, read_session, write_session

LOOKED = Session((2, 3), 7, "Frames", (10.5, 20.0), 1.5)


@pytest.mark.parametrize("session", [LOOKED, Session()])
def test_what_was_looked_at_comes_back(tmp_path: Path, session: Session) -> None:
    assert write_session(session, tmp_path)
    assert read_session(tmp_path) == session
    assert [path.name for path in tmp_path.iterdir()] == ["session.json"]


def test_a_missing_record_is_the_default(tmp_path: Path) -> None:
    assert read_session(tmp_path) == Session()


WHOLE = '{"cell": [0, 1], "frame": 2, "page": "", "centre": [1.0, 2.0], "zoom": 1.0}'


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("{", "no JSON"),
        ("[]", "the whole is"),
        ("{}", "cell is missing"),
        (60_000 * "[", "too deep"),
        (WHOLE.replace("[0, 1]", "[1]"), r"cell\[1\] is missing"),
        (WHOLE.replace("[0, 1]", "[0, -1]"), r"cell\[1\] is -1"),
        (WHOLE.replace("[0, 1]", f"[0, {10**30}]"), r"cell\[1\] is 10000"),
        (WHOLE.replace("2,", f"{'9' * 5000},"), "a number of 5000 digits"),
        (WHOLE.replace("2,", "[2],"), r"frame is \[2\]"),
        (WHOLE.replace("2.0", "NaN"), "NaN, which is no number"),
        (WHOLE.replace("2.0", "1e999"), "1e999, which is beyond"),
        (WHOLE.replace("2.0", '"x"'), r"centre\[1\] is 'x'"),
        (WHOLE.replace('"frame"', '"cell"'), "'cell' twice"),
        (" " * 100_000 + WHOLE, "at most"),
    ],
)
def test_a_damaged_record_is_one_sentence_that_names_the_field(
    tmp_path: Path, text: str, named: str
) -> None:
    (tmp_path / "session.json").write_text(text)
    with pytest.raises(InspectionError, match=rf"session\.json can't be read .*{named}"):
        read_session(tmp_path)


def test_a_folder_that_went_away_is_no_error(tmp_path: Path) -> None:
    assert not write_session(LOOKED, tmp_path / "gone")
