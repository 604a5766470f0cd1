"""One word, one number: every view of one result tells the same counts, residual and lens."""

from __future__ import annotations

import re
from dataclasses import replace
from html import unescape
from pathlib import Path

import pytest
from typer.testing import CliRunner

from pv_inspect.cli import app as cli
from pv_inspect.inspection.doubts import doubts_of
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.inspection.summary import summary
from pv_inspect.notebook import plots
from pv_inspect.notebook.display import inspection_html
from pv_inspect.reports.module_report import render_report
from pv_inspect.results.read import read_result
from pv_inspect.results.write import write_result
from pv_inspect.review.report import render_review
from tests.handmade import made_inspection
from tests.reports.test_module_report import Reader

BLIND = "6 of 6 cells can't be judged from these frames: none suspected, none clean"
# What a person gave is a verdict; the detector's class has another name.
DETECTOR_SAYS_UNSURE = re.compile(r"\bunsure\b(?!\" in)")


def text_of(page: str) -> str:
    return " ".join(Reader(page).text.split())


@pytest.fixture
def blind() -> Inspection:
    """No cell of it could be judged; one has a mark that the frames did not earn."""
    made = made_inspection()
    assert made.cracks is not None
    cells = tuple(replace(c, unsure=True, unsupported_share=0.9) for c in made.cracks.cells)
    assert sum(cell.has_marks for cell in cells) == 1
    made = replace(made, cracks=replace(made.cracks, cells=cells))
    return replace(made, doubts=doubts_of(made))


def saved(inspection: Inspection, folder: Path) -> Inspection:
    write_result(inspection, folder)
    return read_result(folder)


def test_where_no_cell_could_be_judged_every_view_says_that_and_no_all_clear(
    blind: Inspection, tmp_path: Path
) -> None:
    result = saved(blind, tmp_path / "out")
    assert result.doubts == blind.doubts
    review = CliRunner().invoke(cli.app, ["review", str(tmp_path / "out")]).stdout
    lines = summary(blind, tmp_path, 1.0).splitlines()
    assert lines[0].startswith("IN DOUBT  6 of 6 cells can't be judged from these frames")
    assert lines[1].startswith("warning   The 2 frames show the module in the same place")
    assert lines[2] == f"cells     {BLIND}"
    pages = {
        "summary": "\n".join(lines),
        "report": text_of(render_report(blind)),
        "notebook": text_of(inspection_html(blind)),
        "notebook of a result": text_of(inspection_html(result)),
        "review page": text_of(render_review(result, ())),
        "review command": review,
        "plot": plots.cells(blind).get_title(),
    }
    for name, page in pages.items():
        assert BLIND in page, name
        assert "no cracks" not in page.lower(), name
        assert "suspected in 1" not in page.lower(), name


def test_the_report_opens_with_the_doubt_and_the_cells_that_cant_be_judged(
    blind: Inspection,
) -> None:
    text = text_of(render_report(blind))
    doubt, verdict = text.index("This result is in doubt"), text.index(BLIND)
    assert doubt < verdict < text.index("The image was made from")
    assert "The longest suspected crack" not in text


def test_marks_that_cant_be_judged_are_looked_at_after_suspected_cells() -> None:
    made = made_inspection()
    assert made.cracks is not None
    cells = list(made.cracks.cells)
    marked = cells[1]
    cells[2] = replace(marked, col=2, unsure=True, crack_length_cells=9.0)
    page = render_report(replace(made, cracks=replace(made.cracks, cells=tuple(cells))))
    first = page[page.index('class="close-ups"') :]
    assert first.index("Row 1, column 2") < first.index("Row 1, column 3")
    assert "class can&#39;t be judged (unknown)" in first
    assert page.count('class="box undecidable"') == 1
    assert page.count('class="box suspected"') == 1


def test_unsure_is_a_verdict_of_experts_only(blind: Inspection, tmp_path: Path) -> None:
    result = saved(blind, tmp_path / "out")
    assert not DETECTOR_SAYS_UNSURE.search(unescape(render_report(blind)))
    table = render_review(result, ())
    table = table[table.index('<table id="cells">') :]
    assert "unsure" not in table
    assert "can&#39;t be judged" in table
    # The tables keep the id of the class.
    assert ",unsure," in (tmp_path / "out" / "cells.csv").read_text()


def test_the_residual_is_one_number_in_every_view(tmp_path: Path) -> None:
    inspection = made_inspection()
    assert inspection.registration is not None
    result = saved(inspection, tmp_path / "out")
    # 1.0 and 1.2 against the module image; 1.25 is the registration residual.
    assert "residual  1.10 " in summary(inspection, tmp_path, 1.0)
    assert "(median 1.10)" in text_of(render_report(inspection))
    assert re.search(r"Residual \([^)]*\)\s*1\.10", text_of(render_review(result, ())))
    for page in (inspection_html(inspection), inspection_html(result)):
        assert '<th style="text-align: left">residual</th>' in page
        assert "1.10 x noise" in page
    for page in (render_report(inspection), render_review(result, ()), inspection_html(inspection)):
        assert "1.25" not in text_of(page)
    assert plots.residuals(inspection).get_ylabel() == "residual [noise]"
    registered = replace(inspection, reconstruction=None, tiles=None, cracks=None)
    assert plots.residuals(registered).get_ylabel() == "registration residual [noise]"


def test_kappa_before_the_registration_is_named_as_preliminary() -> None:
    inspection = made_inspection()
    early = {"registration": None, "reconstruction": None, "tiles": None, "cracks": None}
    assert "kappa, preliminary" in inspection_html(replace(inspection, **early))
    assert "preliminary" not in inspection_html(inspection)


def test_rows_that_were_guessed_are_not_said_to_come_from_a_file() -> None:
    made = made_inspection(layout_guessed=True)
    guessed = replace(made, sequence=replace(made.sequence, layout_hint={}))
    assert "2, guessed from the frames" in text_of(render_report(guessed))
    assert ", from module.json" not in text_of(render_report(guessed))
