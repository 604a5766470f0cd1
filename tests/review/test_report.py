from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from pv_inspect.cli import app as cli
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.reports.module_report import with_review_state
from pv_inspect.results.read import read_result
from pv_inspect.results.write import write_result
from pv_inspect.review import Measure, ModuleData, ReviewStore, Verdict, VerdictKind, fingerprint
from pv_inspect.review.report import export_review, render_review
from pv_inspect.storage import folders
from tests.handmade import made_inspection
from tests.reports.test_module_report import Reader


@pytest.fixture
def result(tmp_path: Path) -> Inspection:
    write_result(made_inspection(), tmp_path / "out")
    return read_result(tmp_path / "out")


def given(result: Inspection) -> list[Verdict]:
    made_by = fingerprint(result.settings)
    return [
        Verdict(0, 0, VerdictKind.OK, "Ann", settings=made_by),
        Verdict(0, 1, VerdictKind.CRACK_B, "Ann", 'see "<b>here</b>"', made_by),
        Verdict(0, 1, VerdictKind.CRACK_C, "Bob", settings=made_by),
        Verdict(1, 2, VerdictKind.INACTIVE, "Bob", settings=made_by),
    ]


def said(html: str) -> str:
    return " ".join(Reader(html.replace("</t", " </t")).text.split())


def test_the_page_needs_nothing_from_outside_and_notes_are_text(result: Inspection) -> None:
    html = render_review(result, given(result))
    assert all(a.startswith(("data:image/", "report.html")) for a in Reader(html).addresses)
    assert "<b>here</b>" not in html
    assert 'see "<b>here</b>"' in said(html)


def test_the_page_says_how_far_the_review_is_and_where_the_raters_differ(
    result: Inspection,
) -> None:
    text = said(render_review(result, given(result)))
    assert "3 of 6 cells judged by Ann, Bob." in text
    assert "The raters disagree on 1: row 1, column 2." in text
    assert "judged 2 2" in text
    assert "other settings" not in text


def test_every_judged_cell_is_marked_once_per_verdict_and_no_other(result: Inspection) -> None:
    html = render_review(result, given(result))
    assert html.count('<rect class="box') == 3
    assert html.count('<rect class="box two"') == 1
    assert html.count('class="letter"') == 4


def test_a_module_without_verdicts_has_an_empty_form(result: Inspection) -> None:
    html = render_review(result, [])
    assert "0 of 6 cells judged" in said(html)
    assert html.count('class="blank"') == 6
    assert "Cells with a finding" not in html


def test_module_data_fill_the_form(result: Inspection) -> None:
    html = render_review(result, [], ModuleData("SN <7>", 8.5, 0.4, 21))
    text = said(html)
    assert "Serial number SN <7>" in text
    assert "Current 8.5 A" in text
    assert "Exposure 0.4 s" in text
    assert "Temperature 21 °C" in text
    assert html.count('class="blank"') == 2


def test_verdicts_on_another_image_are_told(result: Inspection) -> None:
    old = replace(given(result)[0], settings="older")
    assert "1 cell was judged on an image that was made with other settings" in said(
        render_review(result, [old])
    )


def test_the_page_has_rules_for_printing(result: Inspection) -> None:
    html = render_review(result, given(result))
    assert "@media print" in html
    assert "break-before: page" in html


def test_a_corrected_mask_is_shown_instead_of_the_detectors(result: Inspection) -> None:
    y, x = result.need(Reconstruction).grid.cell_slices(0, 1)
    nothing = np.zeros((y.stop - y.start, x.stop - x.start), bool)
    plain = render_review(result, given(result))
    corrected = render_review(result, given(result), corrected={(0, 1): nothing})
    assert plain != corrected
    assert "corrected" in said(corrected)


def test_the_export_has_a_row_per_cell_and_columns_per_rater(result: Inspection) -> None:
    with ReviewStore(result.source) as store:
        for verdict in given(result):
            store.give(verdict)
        store.correct((0, 1), "Ann", np.ones((80, 80), bool), 0.75, 0.1)
        table, page = export_review(result, store)
    assert page.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    with table.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["row"], row["col"]) for row in rows] == [
        (str(r), str(c)) for r in (1, 2) for c in (1, 2, 3)
    ]
    assert [row["verdict"] for row in rows] == ["ok", "disagreed", "", "", "", "inactive_area"]
    assert rows[1]["verdict (Ann)"] == "crack_b"
    assert rows[1]["verdict (Bob)"] == "crack_c"
    assert rows[1]["note (Ann)"] == 'see "<b>here</b>"'
    assert rows[1]["corrected_crack_length_cells (Ann)"] == "0.75"
    assert rows[1]["corrected_crack_length_cells (Bob)"] == ""
    assert float(rows[1]["crack_length_cells"]) > 0


def test_a_full_disk_leaves_the_earlier_export(
    result: Inspection, monkeypatch: pytest.MonkeyPatch
) -> None:
    with ReviewStore(result.source) as store:
        table, _ = export_review(result, store)
        before = table.read_bytes()
        store.give(given(result)[0])

        def full(path: Path, content: bytes) -> None:
            path.write_bytes(content[:10])
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(folders, "_write_file", full)
        with pytest.raises(InspectionError, match=r"verdicts.csv can't be written: the disk is fu"):
            export_review(result, store)
    assert table.read_bytes() == before
    assert not list(result.source.glob(".*partial*"))


def test_a_new_run_keeps_the_verdicts_and_the_export(result: Inspection) -> None:
    with ReviewStore(result.source) as store:
        store.give(given(result)[0])
        export_review(result, store)
        write_result(made_inspection(), result.source)
        assert len(store.current()) == 1
    assert (result.source / "verdicts.csv").exists()


def test_a_measure_is_made_from_a_result(result: Inspection) -> None:
    measure = Measure.of(result)
    assert measure.cell_width_px == 80
    assert measure.usual_intensity == pytest.approx(0.4)
    assert set(measure.busbars.values()) == {None}


def called(*arguments: object) -> str:
    found = CliRunner().invoke(cli.app, ["review", *map(str, arguments)])
    assert found.exit_code == 0, found.output
    return found.stdout


def test_the_command_tells_the_progress_stores_module_data_and_exports(result: Inspection) -> None:
    cells = "cells     cracks suspected in 1 of 6 cells, 5 clean\n"
    assert called(result.source) == f"{cells}review    0 of 6 cells judged\n"
    assert not (result.source / "review.sqlite").exists()
    with ReviewStore(result.source) as store:
        for verdict in given(result):
            store.give(verdict)
    stdout = called(result.source, "--export", "--serial", "SN 7", "--current", 8.5)
    assert "3 of 6 cells judged" in stdout
    assert "Ann: 2 of 6 cells judged; 1 ok, 1 crack B" in stdout
    assert "the raters disagree on 1 cell" in stdout
    assert called(result.source, "--temperature", 20, "--quiet") == ""
    with ReviewStore(result.source) as store:
        assert store.module_data() == ModuleData("SN 7", 8.5, None, 20)
    assert "SN 7" in (result.source / "review.html").read_text(encoding="utf-8")


def test_the_command_refuses_what_is_no_result_in_one_sentence(tmp_path: Path) -> None:
    found = CliRunner().invoke(cli.app, ["review", str(tmp_path)])
    assert found.exit_code == 1
    assert "is no result folder" in found.stderr
    assert len(found.stderr.splitlines()) == 1


def test_the_technical_report_points_to_the_one_with_verdicts(result: Inspection) -> None:
    technical = result.source / "report.html"
    before = technical.read_text()
    assert '<a href="review.html">' in before
    assert "by Ada" not in before
    with ReviewStore(result.source) as store:
        store.give(Verdict(0, 0, VerdictKind.OK, "Ada <b>"))
        export_review(result, store)
        store.give(Verdict(0, 1, VerdictKind.OK, "Ada <b>"))
        export_review(result, store)
    after = technical.read_text()
    assert after.count("cells judged by Ada &lt;b&gt;.") == 1
    assert "2 of " in after
    assert len(after) == pytest.approx(len(before), abs=150), "nothing else has changed"
    assert '<a href="report.html">' in (result.source / "review.html").read_text()


def test_a_report_without_a_place_for_the_review_stays_as_it_is() -> None:
    assert with_review_state(b"<p>old</p>", "1 of 2 cells judged") == b"<p>old</p>"


def test_a_technical_report_that_can_not_be_read_keeps_no_review_from_being_written(
    result: Inspection, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: Path) -> bytes:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "read_bytes", refuse)
    with ReviewStore(result.source) as store:
        assert all(path.is_file() for path in export_review(result, store))
