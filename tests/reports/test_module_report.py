from __future__ import annotations

import os
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from pv_inspect.cracks import CellFeatures
from pv_inspect.errors import InspectionError
from pv_inspect.reconstruction.psf_estimate import PsfEstimate
from pv_inspect.reports.module_report import render_report
from pv_inspect.settings import Settings
from tests.handmade import FakeSequence, made_inspection, made_reconstruction

VOID = {"meta", "img", "input", "br"}


class Reader(HTMLParser):
    """Text, tags and addresses of a page; fails on tags that are not closed in order."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.addresses: list[str] = []
        self.ids: list[str] = []
        self.text = ""
        self.feed(page)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        found = dict(attrs)
        self.addresses += [v for k, v in attrs if k in ("src", "href") and v]
        self.ids += [found["id"]] if found.get("id") else []  # type: ignore[list-item]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, _: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("style", "script"):
            self.text += data


def test_the_page_needs_nothing_from_outside() -> None:
    page = Reader(render_report(made_inspection()))
    assert all(a.startswith(("data:image/", "#r", "review.html")) for a in page.addresses)
    assert {a[1:] for a in page.addresses if a.startswith("#")} <= set(page.ids)


def test_names_out_of_the_input_are_text_and_never_markup() -> None:
    html = render_report(made_inspection())
    assert "<b>found</b>" not in html
    assert "<i>.tif" not in html
    text = Reader(html).text
    assert "no module of 2 x 3 cells <b>found</b>" in text
    assert "module <7>" in text


def test_the_page_says_what_an_expert_asks_first() -> None:
    text = " ".join(Reader(render_report(made_inspection())).text.split())
    assert (
        "Cracks suspected in 1 of 6 cells, 5 clean. "
        "The longest suspected crack is in row 1, column 2." in text
    )
    assert "made from 2 of 3 frames at 4.00× their resolution in 3.1 s" in text
    assert "at a focal length of 100 px (found from the frames)" in text
    for name in Settings.model_fields:
        assert name in text


def test_the_page_says_how_well_the_blur_is_known() -> None:
    inspection = made_inspection()
    assert inspection.reconstruction is not None
    known = replace(inspection.reconstruction, psf=PsfEstimate(0.5, 0.013, "borders"))
    text = " ".join(Reader(render_report(replace(inspection, reconstruction=known))).text.split())
    assert "standard deviation, ± 0.01, from the borders of the cells." in text
    assert text.count("± 0.01, from the borders of the cells") == 2


def test_the_table_of_cells_starts_with_the_longest_cracks() -> None:
    html = render_report(made_inspection())
    table = html[html.index('<table id="cells">') :]
    assert table.index('id="r1c2"') < table.index('id="r1c1"')


def test_a_dark_cell_is_named_and_not_judged() -> None:
    inspection = made_inspection()
    assert inspection.cracks is not None
    first, *others = inspection.cracks.cells
    cells = (replace(first, dark_area_share=0.9, crack_instances=0), *others)
    html = render_report(replace(inspection, cracks=replace(inspection.cracks, cells=cells)))
    text = " ".join(Reader(html).text.split())
    assert "1 of 6 cells is dark and not judged; cracks suspected in 1, 4 clean." in text
    assert "The dark cell is row 1, column 1." in text
    assert "dark, not judged" in text


def titles(html: str) -> list[str]:
    """Tooltips of the tiles: titles of the boxes on the picture."""
    return [part.partition("</title>")[0] for part in html.split("<title>")[2:]]


def test_every_tile_tells_its_features_and_its_class() -> None:
    found = titles(render_report(made_inspection()))
    assert len(found) == 6
    assert "Row 1, column 2" in found[1]
    assert "crack length: 0.9" in found[1]
    assert "cell widths" in found[1]
    assert "class: unknown" in found[1]
    assert "class: none" in found[0]
    assert not any("nan" in title for title in found)


def test_lengths_are_in_millimetres_if_the_size_of_the_cell_is_given() -> None:
    inspection = made_inspection(settings=Settings(cell_width_mm=156.0))
    assert inspection.cracks is not None
    cells = tuple(
        replace(c, crack_length_mm=156 * c.crack_length_cells) for c in inspection.cracks.cells
    )
    html = render_report(replace(inspection, cracks=replace(inspection.cracks, cells=cells)))
    assert "Length, mm" in html
    assert f"crack length: {cells[1].crack_length_mm:.0f} mm" in titles(html)[1]


def test_every_column_of_the_table_can_be_sorted_by_a_number() -> None:
    html = render_report(made_inspection())
    table = html[html.index('<table id="cells">') : html.index("</table>")]
    values = [part.partition('"')[0].split() for part in table.split('data-values="')[1:]]
    assert len(values) == 6
    assert {len(row) for row in values} == {table.count("<th") - table.count("<thead")}
    assert np.isfinite(np.array(values, float)).all()


def test_cells_in_which_cracks_would_not_show_are_marked_and_counted() -> None:
    inspection = made_inspection()
    assert inspection.cracks is not None
    first, *others = (replace(c, crack_detail=0.9, edge_blur=0.01) for c in inspection.cracks.cells)

    def html_of(cell: CellFeatures) -> str:
        cracks = replace(inspection.cracks, cells=(cell, *others))  # type: ignore[type-var]
        return render_report(replace(inspection, cracks=cracks))

    assert "✱" not in Reader(html_of(first)).text.split('id="cells"')[0].split("Classes")[0]
    html = html_of(replace(first, edge_blur=0.02, unsure=True))
    text = " ".join(Reader(html).text.split())
    assert "1 of 6 cells can't be judged from these frames; cracks suspected in 1, 4 clean." in text
    assert "can't be judged ✱" in text
    assert "blur 2.00% of a cell&#39;s width: too blurred for cracks to show" in titles(html)[0]
    assert "Cracks would not show: less than 60%" in text
    of_old = html_of(replace(first, crack_detail=np.nan, unsupported_share=0.8, unsure=True))
    assert "80% of the cell is unsupported" in titles(of_old)[0]


def test_settings_are_shown_with_the_values_that_were_used() -> None:
    text = Reader(render_report(made_inspection())).text
    assert "2, from module.json" in text
    assert "1, by default" in text
    assert ", fitted" in text
    assert ", the usual value" in text  # two frames in the same place


def test_a_module_without_cracks_has_no_close_ups() -> None:
    inspection = made_inspection()
    assert inspection.cracks is not None
    cells = tuple(replace(c, crack_instances=0) for c in inspection.cracks.cells)
    text = Reader(
        render_report(replace(inspection, cracks=replace(inspection.cracks, cells=cells)))
    )
    assert "all 6 cells are clean (hair cracks can be missed)." in " ".join(text.text.split())
    assert "Cells to look at first" not in text.text


def test_the_page_of_a_large_noisy_module_stays_below_5_megabytes() -> None:
    inspection = made_inspection()
    assert inspection.cracks is not None
    small = made_reconstruction()
    rng = np.random.default_rng(0)
    noise = rng.random((1800, 3000), dtype=np.float32)
    grid = replace(small.grid, shape=noise.shape)
    large = replace(small, image=noise, support=noise, grid=grid)
    cracks = replace(inspection.cracks, probability=noise)
    html = render_report(replace(inspection, reconstruction=large, cracks=cracks))
    assert len(html) < 5e6


def test_an_incomplete_inspection_has_no_report() -> None:
    with pytest.raises(InspectionError, match="not complete"):
        render_report(made_inspection(registration=None))


def test_the_curve_of_lambda_is_drawn_where_lambda_was_chosen() -> None:
    inspection = made_inspection()
    assert inspection.reconstruction is not None
    assert "chosen automatically" not in render_report(inspection)
    curve = ((0.1, 1.2), (0.5, 1.0), (2.0, 1.3))
    chosen = replace(inspection.reconstruction, lambda_curve=curve, prior_weight=0.5)
    page = render_report(replace(inspection, reconstruction=chosen))
    assert "chosen automatically" in page
    assert page.count("<polyline") == 1


def test_a_folder_whose_name_is_no_text_has_a_report() -> None:
    sequence = FakeSequence(source=Path(os.fsdecode(b"module\xff\x1b[2J")))
    html = render_report(made_inspection(sequence=sequence))
    assert html.encode().count(rb"module\udcff\x1b[2J") >= 1


def test_what_was_guessed_is_called_guessed_though_module_json_says_a_part_of_it() -> None:
    guessed = render_report(made_inspection(layout_guessed=True))
    assert guessed.count(", guessed from the frames") == 3
    assert ", from module.json" not in guessed
    assert render_report(made_inspection()).count(", from module.json") == 2
