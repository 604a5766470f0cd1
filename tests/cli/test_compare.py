"""The command ``pv-inspect compare`` from end to end, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from pv_inspect.cli import app as cli
from pv_inspect.common.work import Progress
from pv_inspect.errors import InspectionError
from pv_inspect.evaluation.case import Case, Cell
from pv_inspect.evaluation.methods import Bicubic, CellImages


def called(*arguments: object) -> Result:
    return CliRunner().invoke(cli.app, [str(a) for a in arguments])


def test_it_goes_through_and_says_where_the_page_is(quick_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "compared"
    done = called("compare", quick_folder, "--out", out, "--methods", "bicubic", "-m", 2)
    assert done.exit_code == 0, done.output
    assert "1 of 1 rows have figures" in done.stdout
    assert (out / "compare.html").is_file()
    assert len((out / "table.csv").read_text().splitlines()) == 2


def test_an_unknown_method_is_one_sentence(quick_folder: Path, tmp_path: Path) -> None:
    done = called("compare", quick_folder, "--out", tmp_path / "x", "--methods", "esrgan")
    assert done.exit_code == 1
    assert done.stderr.startswith("pv-inspect: There is no method 'esrgan'")
    assert len(done.stderr.splitlines()) == 1


def test_a_missing_sequence_is_one_sentence(tmp_path: Path) -> None:
    done = called("compare", tmp_path / "nowhere", "--out", tmp_path / "x", "--methods", "mean")
    assert done.exit_code == 1
    said = [line for line in done.stderr.splitlines() if line.startswith("pv-inspect: ")]
    assert len(said) == 1
    assert "nowhere" in said[0]


def test_a_method_without_figures_is_told_even_when_quiet(
    quick_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_self: Bicubic, case: Case, cells: list[Cell]) -> CellImages:
        yield Progress(0.0, f"{len(cells)} cells of {case.grid.shape}")
        raise InspectionError("BICUBIC has no frame to show.")

    monkeypatch.setattr(Bicubic, "images", refuse)
    out = tmp_path / "compared"
    done = called("compare", quick_folder, "--out", out, "--methods", "bicubic", "-m", 2, "--quiet")
    assert done.exit_code == 1
    assert done.stdout == ""
    assert "BICUBIC on quick at 2x has no figures: BICUBIC has no frame" in done.stderr
