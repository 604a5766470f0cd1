"""Scores from pairwise comparisons: closed forms, an independent fit, coverage of intervals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.evaluation.ranking import (
    Comparisons,
    fitted_scores,
    kendall_u,
    kendall_w,
    preference,
    rater_ranks,
    scores_with_intervals,
    self_consistency,
)

NAMES = ("A", "B", "C", "D", "E", "F")


def drawn(
    scores: NDArray[np.float64], count: int, seed: int, raters: int = 7, tie: float = 0.0
) -> Comparisons:
    """Answers of raters who follow the model."""
    rng = np.random.default_rng(seed)
    first = rng.integers(len(scores), size=count)
    second = (first + rng.integers(1, len(scores), size=count)) % len(scores)
    a, b = np.exp(scores[first]), np.exp(scores[second])
    middle = tie * np.sqrt(a * b)
    at = rng.random(count) * (a + b + middle)
    outcome = np.where(at < a, 1, np.where(at < a + b, -1, 0))
    return Comparisons(
        NAMES[: len(scores)], first, second, outcome, rng.integers(raters, size=count), first * 10
    )


def test_two_methods_have_the_log_of_their_odds() -> None:
    outcome = np.array([1] * 57 + [-1] * 43)
    n = outcome.size
    made = Comparisons(
        ("A", "B"), np.zeros(n, int), np.ones(n, int), outcome, np.zeros(n, int), np.arange(n)
    )
    score, tie = fitted_scores(made)
    assert score[0] - score[1] == pytest.approx(np.log(57 / 43), abs=1e-7)
    assert tie == 0.0
    assert preference(score[0], score[1]) == pytest.approx(0.57)


@pytest.mark.parametrize(("share", "difference"), [(0.57, 0.2819), (0.61, 0.4473)])
def test_what_the_paper_states_are_these_differences(share: float, difference: float) -> None:
    """P = 0.57 at 3x and 0.61 at 4x (Sec. IV-C)."""
    assert preference(difference, 0.0) == pytest.approx(share, abs=5e-5)


def test_the_fit_agrees_with_choix() -> None:
    choix = pytest.importorskip("choix", reason="choix is not installed")
    made = drawn(np.array([0.9, 0.3, 0.0, -0.1, -0.4, -0.7]), 800, 3)
    pairs = [
        (a, b) if o > 0 else (b, a)
        for a, b, o in zip(made.first, made.second, made.outcome, strict=True)
    ]
    other = choix.opt_pairwise(6, pairs, tol=1e-12)
    assert fitted_scores(made)[0] == pytest.approx(other - np.mean(other), abs=1e-6)


def test_davidson_of_two_methods_is_its_closed_form() -> None:
    """60 wins, 25 losses, 15 ties: p = log(60/25) / 2 each way, nu = 15 / sqrt(60 x 25)."""
    outcome = np.array([1] * 60 + [-1] * 25 + [0] * 15)
    n = outcome.size
    made = Comparisons(
        ("A", "B"), np.zeros(n, int), np.ones(n, int), outcome, np.zeros(n, int), np.arange(n)
    )
    score, tie = fitted_scores(made)
    assert score == pytest.approx([np.log(60 / 25) / 2, -np.log(60 / 25) / 2], abs=1e-6)
    assert tie == pytest.approx(15 / np.sqrt(60 * 25), abs=1e-6)


def test_known_scores_and_ties_come_back() -> None:
    true = np.array([0.8, 0.2, -0.3, -0.7])
    score, tie = fitted_scores(drawn(true, 60_000, 5, tie=0.4))
    assert score == pytest.approx(true - true.mean(), abs=0.04)
    assert tie == pytest.approx(0.4, abs=0.02)


def test_intervals_hold_the_true_scores_as_often_as_stated() -> None:
    """30 studies of 7 raters and 400 answers; benchmarks/ranking_coverage.py does 200 of 3000."""
    true = np.array([0.5, 0.2, 0.0, -0.2, -0.5])
    inside = []
    for seed in range(30):
        found = scores_with_intervals(drawn(true, 400, seed), draws=50, seed=seed)
        inside.append((found.low <= true) & (true <= found.high))
    assert 0.90 <= np.mean(inside) <= 0.99


def test_the_side_on_which_a_method_was_shown_changes_nothing() -> None:
    made = drawn(np.array([0.5, 0.0, -0.5]), 300, 8)
    turned = Comparisons(
        made.methods, made.second, made.first, -made.outcome, made.rater, made.item
    )
    assert fitted_scores(turned)[0] == pytest.approx(fitted_scores(made)[0], abs=1e-7)
    assert kendall_u(turned) == pytest.approx(kendall_u(made))


def test_a_method_that_won_all_has_no_score_and_is_named() -> None:
    first, second = np.array([0, 0, 1, 2]), np.array([1, 2, 2, 1])
    made = Comparisons(
        ("A", "B", "C"), first, second, np.ones(4, int), np.zeros(4, int), np.arange(4)
    )
    with pytest.raises(InspectionError, match="A were never preferred"):
        fitted_scores(made)


def test_concordance_of_equal_rankings_is_1_and_of_opposite_ones_0() -> None:
    ranks = np.array([[1.0, 2, 3, 4]] * 5)
    assert kendall_w(ranks) == pytest.approx(1.0)
    assert kendall_w(np.array([[1.0, 2, 3, 4], [4, 3, 2, 1]])) == pytest.approx(0.0)


def test_concordance_of_a_worked_example() -> None:
    """Three raters, four items, rank sums 5, 6, 7, 12 about 7.5: S = 29."""
    ranks = np.array([[1.0, 2, 3, 4], [2, 1, 3, 4], [2, 3, 1, 4]])
    assert kendall_w(ranks) == pytest.approx(12 * 29 / (9 * 60))


@settings(max_examples=50)
@given(st.integers(2, 8), st.integers(3, 7), st.integers(0, 10_000))
def test_concordance_lies_between_0_and_1(raters: int, count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    ranks = np.array([rng.permutation(count) + 1.0 for _ in range(raters)])
    assert 0.0 <= kendall_w(ranks) <= 1.0 + 1e-12


def test_agreement_is_1_when_all_agree_and_least_when_they_are_split() -> None:
    n = 12
    rater, item = np.tile(np.arange(4), 3), np.repeat(np.arange(3), 4)
    first, second = np.zeros(n, int), np.ones(n, int)
    alike = Comparisons(("A", "B"), first, second, np.ones(n, int), rater, item)
    assert kendall_u(alike) == 1.0
    split = Comparisons(("A", "B"), first, second, np.where(rater < 2, 1, -1), rater, item)
    assert kendall_u(split) == pytest.approx(-1 / 3)  # -1 / (R - 1) with four raters
    alone = Comparisons(("A", "B"), first, second, np.ones(n, int), 0 * rater, np.arange(n))
    assert np.isnan(kendall_u(alone))


def test_repeats_are_compared_whichever_side_they_were_on() -> None:
    made = Comparisons(
        ("A", "B"),
        np.array([0, 1, 0, 0]),
        np.array([1, 0, 1, 1]),
        np.array([1, -1, 1, -1]),
        np.array([0, 0, 1, 1]),
        np.array([5, 5, 5, 5]),
    )
    assert self_consistency(made) == 0.5  # the first rater has answered alike, the second has not


def test_raters_are_ranked_one_by_one() -> None:
    made = drawn(np.array([2.0, 0.0, -2.0]), 900, 1, raters=3)
    ranks = rater_ranks(made)
    assert ranks.shape == (3, 3)
    assert (ranks.argmin(1) == 0).all()
    assert kendall_w(ranks) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("first", "second", "outcome"), [(0, 0, 1), (0, 5, 1), (0, 1, 2), (-1, 1, 1)]
)
def test_impossible_comparisons_are_refused(first: int, second: int, outcome: int) -> None:
    one = np.array([0])
    with pytest.raises(ValueError, match=r"compared with itself|there is not|neither"):
        Comparisons(("A", "B"), one + first, one + second, one + outcome, one, one)
