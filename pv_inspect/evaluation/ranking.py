"""Ranking methods by pairwise comparisons of observers (paper, Sec. IV-C).

References
----------
.. [1] R. A. Bradley, M. E. Terry, Biometrika 39, 1952. doi:10.1093/biomet/39.3-4.324
.. [2] R. R. Davidson, "On Extending the Bradley-Terry Model to Accommodate Ties in Paired
       Comparison Experiments", JASA 65, 1970. doi:10.1080/01621459.1970.10481082
.. [3] M. G. Kendall, B. Babington Smith, "On the Method of Paired Comparisons", Biometrika 31,
       1940. doi:10.1093/biomet/31.3-4.324
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.sparse.csgraph import connected_components
from scipy.special import log_expit
from scipy.stats import rankdata, t

from pv_inspect.errors import InspectionError

__all__ = [
    "Comparisons",
    "Scores",
    "fitted_scores",
    "kendall_u",
    "kendall_w",
    "preference",
    "rater_ranks",
    "scores_with_intervals",
    "self_consistency",
]

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

_LEVEL = 0.95


@dataclass(frozen=True, eq=False)
class Comparisons:
    """Answers of observers who have seen two pictures each time.

    Parameters
    ----------
    methods : tuple of str
        Names, in the order of the numbers below.
    first, second : (n,) int64
        Numbers of the methods that were shown.
    outcome : (n,) int64
        1 if the first was chosen, -1 if the second was, 0 for no difference.
    rater : (n,) int64
        Number of the observer.
    item : (n,) int64
        Number of what was shown, the same for the same two pictures on either side.

    Raises
    ------
    ValueError
        If the arrays differ in length, a method is compared with itself, or there is no such
        method.
    """

    methods: tuple[str, ...]
    first: Ints
    second: Ints
    outcome: Ints
    rater: Ints
    item: Ints

    def __post_init__(self) -> None:
        if (
            len({len(a) for a in (self.first, self.second, self.outcome, self.rater, self.item)})
            > 1
        ):
            raise ValueError("the columns of comparisons differ in length")
        shown = np.concatenate([self.first, self.second])
        if shown.size and not (shown.min() >= 0 and shown.max() < len(self.methods)):
            raise ValueError("a comparison names a method that there is not")
        if (self.first == self.second).any():
            raise ValueError("a method is compared with itself")
        if not np.isin(self.outcome, (-1, 0, 1)).all():
            raise ValueError("an outcome is neither -1, 0 nor 1")

    def only(self, chosen: NDArray[np.int64] | NDArray[np.bool_]) -> Comparisons:
        """Return some of the comparisons, by number or by a mask."""
        columns = (self.first, self.second, self.outcome, self.rater, self.item)
        return Comparisons(self.methods, *(column[chosen] for column in columns))


@dataclass(frozen=True, eq=False)
class Scores:
    """Bradley-Terry scores of the methods; their mean is 0.

    Parameters
    ----------
    methods : tuple of str
    score : (m,) float64
        p of P(k > l) = exp(p_k) / (exp(p_k) + exp(p_l)).
    tie : float
        nu of Davidson's model; 0 where no difference was never answered.
    low, high : (m,) float64
        Ends of the interval of 95 %; NaN where there is none.
    over : str
        What the interval is over: raters, or single comparisons of one rater.
    """

    methods: tuple[str, ...]
    score: Floats
    tie: float
    low: Floats
    high: Floats
    over: str


def preference(score_k: float, score_l: float) -> float:
    """Return the probability that k is preferred over l: exp(p_k) / (exp(p_k) + exp(p_l)).

    >>> round(preference(0.2819, 0.0), 2)
    0.57
    """
    return float(np.exp(log_expit(score_k - score_l)))


def fitted_scores(made: Comparisons, start: Floats | None = None) -> tuple[Floats, float]:
    """Fit the scores of the Bradley-Terry model by maximum likelihood, of Davidson's with ties.

    Parameters
    ----------
    made : Comparisons
    start : (m,) float64, optional
        Scores to start from.

    Returns
    -------
    score : (m,) float64
        Mean 0.
    tie : float
        nu; 0 without ties.

    Raises
    ------
    InspectionError
        If the answers give no finite score: some methods were never preferred to the others, or
        never compared with them.

    Notes
    -----
    With s = (p_k + p_l) / 2 and a tie weight nu = exp(q): P(k > l) = e^{p_k} / D,
    P(tie) = e^{s + q} / D, D = e^{p_k} + e^{p_l} + e^{s + q} [2]_; without ties nu = 0 and it is
    the model of Bradley and Terry [1]_. The negative log likelihood is convex in (p, q).
    """
    wins, ties = _counts(made)
    count = len(made.methods)
    # A tie is half a win for both (Davidson's condition for a finite maximum).
    n_parts, part = connected_components((wins + ties) > 0, directed=True, connection="strong")
    if n_parts > 1:
        raise InspectionError(
            f"The answers give no scores: {_apart(made.methods, part)} were never preferred to the "
            "others or the others never to them, so that the difference has no end: collect more "
            "answers."
        )
    with_ties = bool(ties.any())

    def loss(x: Floats) -> tuple[float, Floats]:
        p, q = x[:count], x[count] if with_ties else -np.inf
        a, b = p[:, None], p[None]
        middle = (a + b) / 2 + q
        top = np.maximum(np.maximum(a, b), middle)
        log_d = top + np.log(np.exp(a - top) + np.exp(b - top) + np.exp(middle - top))
        total = wins + wins.T + ties
        value = -(wins * (a - log_d)).sum()
        if with_ties:
            value -= 0.5 * (ties * (middle - log_d)).sum()
        chance_a, chance_tie = np.exp(a - log_d), np.exp(middle - log_d)
        gradient = np.zeros_like(x)
        gradient[:count] = (
            (total * (chance_a + chance_tie / 2)).sum(1) - wins.sum(1) - ties.sum(1) / 2
        )
        if with_ties:
            gradient[count] = 0.5 * ((total * chance_tie).sum() - ties.sum())
        return float(value), gradient

    begin = np.zeros(count + with_ties)
    begin[:count] = 0.0 if start is None else start
    found = minimize(loss, begin, jac=True, method="BFGS", options={"gtol": 1e-9}).x
    score = found[:count] - found[:count].mean()
    return np.asarray(score), float(np.exp(found[count])) if with_ties else 0.0


def scores_with_intervals(made: Comparisons, draws: int = 400, seed: int = 0) -> Scores:
    """Fit the scores, and the interval in which they lie for other raters of the same kind.

    Parameters
    ----------
    made : Comparisons
    draws : int
        Resamplings.
    seed : int

    Returns
    -------
    Scores

    Raises
    ------
    InspectionError
        As `fitted_scores`.

    Notes
    -----
    The bootstrap draws raters with replacement, each with all of its answers: answers of one rater
    are not independent. The standard deviation of the scores over the draws is too small by
    sqrt((R - 1) / R) with R raters and uncertain by itself: it is enlarged by that factor, and the
    interval is that of Student's t with R - 1 degrees of freedom. With one rater its answers are
    drawn.
    """
    score, tie = fitted_scores(made)
    rng = np.random.default_rng(seed)
    raters = np.unique(made.rater)
    over_raters = raters.size > 1
    groups = (
        [np.flatnonzero(made.rater == r) for r in raters]
        if over_raters
        else [np.array([k]) for k in range(made.first.size)]
    )
    size = len(groups)
    drawn = []
    for _ in range(draws):
        chosen = np.concatenate([groups[k] for k in rng.integers(size, size=size)])
        try:
            drawn.append(fitted_scores(made.only(chosen), score)[0])
        except InspectionError:  # in this draw one method has won or lost all
            continue
    reach = np.full(score.size, np.nan)
    if len(drawn) > draws // 2:
        deviation = np.std(drawn, axis=0, ddof=1) * np.sqrt(size / (size - 1))
        reach = deviation * float(t.ppf(0.5 + _LEVEL / 2, size - 1))
    over = "raters" if over_raters else "answers of one rater"
    return Scores(made.methods, score, tie, score - reach, score + reach, over)


def rater_ranks(made: Comparisons) -> Floats:
    """Rank the methods for each rater by the share of comparisons that they have won.

    Returns
    -------
    (n_raters, m) float64
        1 is the best; equal shares have their mean rank.
    """
    ranks = []
    for rater in np.unique(made.rater):
        wins, ties = _counts(made.only(made.rater == rater))
        seen = (wins + wins.T + ties).sum(1)
        share = (wins.sum(1) + ties.sum(1) / 2) / np.maximum(seen, 1)
        ranks.append(rankdata(-share))
    return np.array(ranks)


def kendall_w(ranks: Floats) -> float:
    """Kendall's coefficient of concordance of several rankings, corrected for ties.

    Parameters
    ----------
    ranks : (n_raters, m) float64

    Returns
    -------
    float
        0 without any agreement, 1 with complete agreement; it is never negative (the paper writes
        [-1, 1], which is the range of `kendall_u`).

    Notes
    -----
    W = 12 S / (R^2 (m^3 - m) - R T) with S the sum of squares of the rank sums about their mean and
    T the sum of t^3 - t over groups of t equal ranks.
    """
    raters, count = ranks.shape
    total = ranks.sum(0)
    squares = float(((total - total.mean()) ** 2).sum())
    tied = 0.0
    for one in ranks:
        sizes = np.unique(one, return_counts=True)[1]
        tied += float((sizes**3 - sizes).sum())
    scale = raters**2 * (count**3 - count) - raters * tied
    return 12.0 * squares / scale if scale > 0 else float("nan")


def kendall_u(made: Comparisons) -> float:
    """Kendall's coefficient of agreement in paired comparisons, of raters who saw the same items.

    Parameters
    ----------
    made : Comparisons
        Answers of no difference are left out.

    Returns
    -------
    float
        1 if all raters always agree; about 0 for answers by chance; -1 / (R - 1), or -1 / R for an
        odd number of raters R, at least. NaN if no item was answered by two raters.

    Notes
    -----
    u = 2 A / N - 1 with N the pairs of raters over all items and A those that agree [3]_.
    """
    agree, pairs = 0.0, 0.0
    low = np.minimum(made.first, made.second)
    for_low = np.where(made.first == low, made.outcome, -made.outcome)
    for item in np.unique(made.item):
        answers = for_low[(made.item == item) & (made.outcome != 0)]
        a, b = float((answers > 0).sum()), float((answers < 0).sum())
        agree += a * (a - 1) / 2 + b * (b - 1) / 2
        pairs += (a + b) * (a + b - 1) / 2
    return 2 * agree / pairs - 1 if pairs else float("nan")


def self_consistency(made: Comparisons) -> float:
    """Share of repeated items that a rater has answered as before; NaN without repeats."""
    low = np.minimum(made.first, made.second)
    for_low = np.where(made.first == low, made.outcome, -made.outcome)
    alike, repeats = 0, 0
    seen: dict[tuple[int, int], int] = {}
    for rater, item, answer in zip(made.rater, made.item, for_low, strict=True):
        key = (int(rater), int(item))
        if key in seen:
            repeats += 1
            alike += int(seen[key] == int(answer))
        seen[key] = int(answer)
    return alike / repeats if repeats else float("nan")


def _counts(made: Comparisons) -> tuple[Floats, Floats]:
    """How often k was preferred to l, and how often neither was: (m, m) both, ties twice."""
    count = len(made.methods)
    wins, ties = np.zeros((count, count)), np.zeros((count, count))
    won, lost = made.outcome > 0, made.outcome < 0
    np.add.at(wins, (made.first[won], made.second[won]), 1)
    np.add.at(wins, (made.second[lost], made.first[lost]), 1)
    tied = made.outcome == 0
    np.add.at(ties, (made.first[tied], made.second[tied]), 1)
    return wins, ties + ties.T


def _apart(methods: Sequence[str], part: NDArray[np.int32]) -> str:
    smallest = np.argmin(np.bincount(part))
    return ", ".join(name for name, own in zip(methods, part, strict=True) if own == smallest)
