from __future__ import annotations

import pickle

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from pv_inspect.cli import app as cli
from pv_inspect.errors import LONGEST_SENTENCE, InspectionError, one_sentence, printable


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("clear\x1b[2J.tif", r"clear\x1b[2J.tif"),
        ("two\nlines\r.tif", r"two\nlines\r.tif"),
        ("gnp.\u202efit", r"gnp.\u202efit"),
        ("zero\u200bwidth", r"zero\u200bwidth"),
        ("not utf-8 \udcff", r"not utf-8 \udcff"),
        ("Modul_Süd 東.tif", "Modul_Süd 東.tif"),
    ],
)
def test_what_a_terminal_would_obey_is_shown(name: str, shown: str) -> None:
    assert printable(name) == shown
    assert str(InspectionError(f"{name} is wrong.")) == f"{shown} is wrong."


def test_a_long_sentence_keeps_what_is_wrong_and_what_to_do() -> None:
    text = str(InspectionError(f"frame.tif has {'9' * 5000} pixels: remove it."))
    assert len(text) == LONGEST_SENTENCE
    assert text.startswith("frame.tif has 999")
    assert text.endswith("999 pixels: remove it.")


@settings(max_examples=200, deadline=None)
@given(st.text(max_size=1000))
def test_any_text_becomes_one_short_line_that_can_be_written(text: str) -> None:
    said = str(InspectionError(text))
    assert said.isprintable()
    assert len(said) <= LONGEST_SENTENCE
    said.encode()
    assert one_sentence(said) == said
    assert str(pickle.loads(pickle.dumps(InspectionError(text)))) == said


def test_an_unexpected_failure_is_short_and_printable_too(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError(f"\x1b[31m{'long ' * 500}")

    monkeypatch.setattr(cli.cli_gui, "open_workbench", fail)
    result = CliRunner().invoke(cli.app, ["gui"])
    assert result.exit_code == 1
    line = result.stderr.removesuffix("\n")
    assert line.isprintable()
    assert len(line) < 400
    assert line.endswith("(--debug shows where).")
