from __future__ import annotations

from itertools import product
from typing import Any

import pytest

from pv_inspect.cracks import CellCounts, CellFeatures, CellState, look_at_first, state_of


def cell(col: int = 0, **values: Any) -> CellFeatures:
    given = {"crack_length_cells": 0.0, "crack_instances": 0, "dark_area_share": 0.0, **values}
    return CellFeatures(0, col, mean_intensity=0.4, crack_score=0.1, **given)


CLEAN = cell()
SUSPECTED = cell(crack_instances=2, crack_length_cells=0.7)
BLIND = cell(unsure=True)
BLIND_WITH_MARKS = cell(unsure=True, crack_instances=1, crack_length_cells=2.0)
DARK = cell(dark_area_share=0.9)


def test_every_cell_has_exactly_one_state() -> None:
    for marks, unsure, dark in product((0, 3), (False, True), (0.1, 0.8)):
        one = cell(crack_instances=marks, unsure=unsure, dark_area_share=dark)
        counts = CellCounts.of([one])
        assert counts.total == 1
        assert [state for state in CellState if counts[state]] == [state_of(one)]
        assert one.crack_suspected == (state_of(one) is CellState.SUSPECTED)


def test_a_cell_that_cant_be_judged_is_never_counted_as_suspected_or_clean() -> None:
    counts = CellCounts.of([BLIND, BLIND_WITH_MARKS, SUSPECTED, CLEAN, CLEAN, DARK])
    assert counts == CellCounts(suspected=1, clean=2, undecidable=2, dark=1)
    assert (counts.total, counts.judged) == (6, 3)
    assert not BLIND_WITH_MARKS.crack_suspected


@pytest.mark.parametrize(
    ("counts", "text"),
    [
        (CellCounts(12, 48, 0, 0), "cracks suspected in 12 of 60 cells, 48 clean"),
        (
            CellCounts(0, 60, 0, 0),
            "no cracks are suspected: all 60 cells are clean (hair cracks can be missed)",
        ),
        (
            CellCounts(0, 1, 0, 0),
            "no cracks are suspected: the cell is clean (hair cracks can be missed)",
        ),
        (
            CellCounts(0, 0, 60, 0),
            "60 of 60 cells can't be judged from these frames: none suspected, none clean",
        ),
        (
            CellCounts(12, 39, 7, 2),
            "7 of 60 cells can't be judged from these frames, 2 are dark and not judged; "
            "cracks suspected in 12, 39 clean",
        ),
        (
            CellCounts(0, 59, 0, 1),
            "1 of 60 cells is dark and not judged; cracks suspected in 0, 59 clean",
        ),
        (CellCounts(0, 0, 0, 0), "no cells"),
    ],
)
def test_what_was_not_judged_is_told_first(counts: CellCounts, text: str) -> None:
    assert counts.text == text


def test_an_all_clear_needs_every_cell_judged_and_every_number_is_told() -> None:
    for numbers in product((0, 1, 23), repeat=4):
        counts = CellCounts(*numbers)
        all_clear = "no cracks" in counts.text
        assert all_clear == (counts.clean == counts.total > 0)
        if counts.undecidable:
            assert counts.text.startswith(f"{counts.undecidable} of {counts.total} ")
        elif counts.dark:
            assert counts.text.startswith(f"{counts.dark} of {counts.total} ")
        if not all_clear:
            assert all(n == 0 or str(n) in counts.text for n in numbers)


def test_suspected_cells_are_looked_at_before_longer_marks_that_cant_be_judged() -> None:
    one, two, three = SUSPECTED, BLIND_WITH_MARKS, BLIND
    assert two.crack_length_cells > one.crack_length_cells
    assert look_at_first([CLEAN, DARK, three, two, one]) == [one, two, three, DARK, CLEAN]


def test_why_cells_cant_be_judged_is_told() -> None:
    weak = cell(crack_instances=1, crack_length_cells=0.01, weak_marks=True)
    strange = cell(crack_instances=40, crack_length_cells=9.0, novelty=1.7)
    counts = CellCounts.of([weak, strange, strange, BLIND, CLEAN])
    assert (counts.suspected, counts.unfamiliar, counts.weak) == (0, 2, 1)
    assert counts.text == (
        "4 of 5 cells can't be judged (2 unlike all that the detector has learnt, "
        "1 with marks too short or too faint for a crack, 1 in which cracks would not show); "
        "cracks suspected in 0, 1 clean"
    )


def test_the_short_text_leaves_out_why_cells_are_open() -> None:
    weak = CellCounts(1, 2, 2, 0, weak=1)
    assert "too faint" in weak.text
    assert weak.short_text == "2 of 5 cells can't be judged; cracks suspected in 1, 2 clean"
    for told in (CellCounts(0, 3, 0, 0), CellCounts(1, 0, 2, 0)):
        assert told.short_text == told.text
