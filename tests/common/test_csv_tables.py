from __future__ import annotations

import csv
import io
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from pv_inspect.cli.app import app
from pv_inspect.common.csv_tables import csv_lines, csv_text, guarded, unguarded
from pv_inspect.cracks import CellFeatures
from pv_inspect.review import Verdict, VerdictKind, verdicts_csv
from pv_inspect.sequence.frame_files import natural_key
from tests.cracks.test_network import cell

FORMULAS = ["=1+1", "+1+1", "-1+cmd|' /C calc'!A0", "@SUM(A1)", "\t=1", "\r=1", " =1", "\uff1d1"]


def cells_of(text: str) -> list[str]:
    return [cell for row in csv.reader(io.StringIO(text)) for cell in row]


@pytest.mark.parametrize("text", FORMULAS)
def test_what_a_spreadsheet_would_run_gets_an_apostrophe(text: str) -> None:
    assert guarded(text) == f"'{text}"


@pytest.mark.parametrize("text", ["", "-1.5", "+2", "-1e-05", "nan", "-inf", "a=b", "'t was", "0"])
def test_numbers_and_plain_texts_stay(text: str) -> None:
    assert guarded(text) == text


@given(st.text(st.sampled_from("'=+-@\t\r\n a1.e;,\""), max_size=8))
def test_what_is_written_is_read_back_and_nothing_in_it_runs(text: str) -> None:
    assert unguarded(guarded(text)) == text
    (line,) = csv_lines(csv_text([["name", "more"], [text, 1]]))
    assert line == {"name": text, "more": "1"}
    written = cells_of(csv_text([[text]]))
    for value in written:
        try:
            float(value)
        except ValueError:
            assert not value.lstrip().startswith(("=", "+", "-", "@"))


@pytest.mark.parametrize("formula", FORMULAS)
def test_notes_and_names_stand_in_the_table_of_verdicts_as_texts(formula: str) -> None:
    features = CellFeatures(0, 0, 0.5, 1, 0.0, 0.25, 0.75)
    verdict = Verdict(0, 0, VerdictKind.OTHER, f"{formula}!", formula, formula, formula, formula)
    found = cells_of(verdicts_csv([features], [verdict]))
    assert found.count(f"'{formula}") == 4
    assert not [text for text in found if text.strip()[:1] in "=+@" and text.strip()]


def test_names_of_images_stand_in_the_table_of_cells_as_texts(tmp_path: Path) -> None:
    names = ["=1+1", "-cmd", "@a", "+x"]
    for name in names:
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.round(cell(90, 90) * 255).astype(np.uint8))
    run = CliRunner().invoke(
        app, ["cracks", str(tmp_path), "--out", str(tmp_path / "out"), "--detector", "ridge"]
    )
    assert run.exit_code == 0, run.output
    table = (tmp_path / "out" / "cells.csv").read_text()
    files = [line.split(",")[0] for line in table.splitlines()[1:]]
    assert files == [f"'{name}.tif" for name in sorted(names, key=natural_key)]
    lines = list(csv_lines(table))
    assert [line["file"] for line in lines] == [file[1:] for file in files]
    assert np.isfinite([float(line["mean_intensity"]) for line in lines]).all()
