from __future__ import annotations

import random

from pv_inspect.cracks import CellFeatures
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.review import (
    Order,
    Verdict,
    VerdictKind,
    filtered,
    next_unjudged,
    of_rater,
    ordered,
    progress,
)

SCORES = {(0, 0): 0.2, (0, 1): 0.9, (0, 2): 0.2, (1, 0): 0.5, (1, 1): 0.9, (1, 2): 0.0}
CELLS = [CellFeatures(r, c, 0, 0, 0, 0.5, score) for (r, c), score in SCORES.items()]
VERDICTS = [
    Verdict(0, 1, VerdictKind.OK, "Ann"),
    Verdict(1, 0, VerdictKind.CRACK_C, "Ann"),
    Verdict(1, 2, VerdictKind.CRACK_A, "Ann"),
    Verdict(0, 0, VerdictKind.OK, "Bob"),
]
ANN = of_rater(VERDICTS, "Ann")


def places(cells: tuple[CellFeatures, ...]) -> list[tuple[int, int]]:
    return [(cell.row, cell.col) for cell in cells]


def test_progress_counts_cells_once_and_verdicts_each() -> None:
    both = [*VERDICTS, Verdict(1, 0, VerdictKind.OK, "Bob"), Verdict(9, 9, VerdictKind.OK, "Bob")]
    found = progress(both, ModuleLayout(2, 3))
    assert (found.judged, found.total) == (4, 6)
    assert found.counts[VerdictKind.OK] == 3
    assert sum(found.counts.values()) == 5
    assert found.text == "4 of 6 cells judged"
    assert set(found.counts) == set(VerdictKind)


def test_each_order_is_the_same_whatever_the_cells_came_in() -> None:
    mixed = random.Random(3).sample(CELLS, len(CELLS))
    assert places(ordered(mixed, ANN, Order.POSITION)) == list(SCORES)
    by_score = [(0, 1), (1, 1), (1, 0), (0, 0), (0, 2), (1, 2)]
    assert places(ordered(mixed, ANN, Order.CRACK_SCORE)) == by_score
    by_verdict = [(1, 0), (1, 2), (0, 1), (0, 0), (0, 2), (1, 1)]
    assert places(ordered(mixed, ANN, Order.VERDICT)) == by_verdict


def test_cells_are_filtered_by_verdict_and_by_having_none() -> None:
    assert places(filtered(CELLS, ANN, {VerdictKind.OK})) == [(0, 1)]
    assert places(filtered(CELLS, ANN, {None})) == [(0, 0), (0, 2), (1, 1)]
    everything = {None, *VerdictKind}
    assert filtered(CELLS, ANN, everything) == tuple(CELLS)


def test_the_next_cell_to_judge_comes_after_this_one_and_then_from_the_start() -> None:
    assert next_unjudged(CELLS, ANN, None) == (0, 0)
    assert next_unjudged(CELLS, ANN, (0, 0)) == (0, 2)
    assert next_unjudged(CELLS, ANN, (1, 1)) == (0, 0)
    assert next_unjudged(CELLS, ANN, (7, 7)) == (0, 0)
    assert next_unjudged([CELLS[1]], ANN, None) is None
