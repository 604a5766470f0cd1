"""How often the intervals of Bradley-Terry scores hold the true scores.

    python benchmarks/ranking_coverage.py [--studies 200] [--answers 3000] [--taste 0.2]

Every study has six methods with scores drawn anew and raters who follow the model; with ``--taste``
every rater has scores of its own around the common ones, and the common ones are what the intervals
are to hold.
"""

from __future__ import annotations

import argparse
from time import process_time

import numpy as np

from pv_inspect.evaluation.ranking import Comparisons, scores_with_intervals

METHODS = ("A", "B", "C", "D", "E", "F")


def study(seed: int, raters: int, answers: int, taste: float) -> tuple[Comparisons, np.ndarray]:
    """Draw the scores of a study and its answers."""
    rng = np.random.default_rng([160, seed])
    common = rng.normal(0, 0.4, len(METHODS))
    common -= common.mean()
    own = common + rng.normal(0, taste, (raters, len(METHODS)))
    first = rng.integers(len(METHODS), size=answers)
    second = (first + rng.integers(1, len(METHODS), size=answers)) % len(METHODS)
    rater = rng.integers(raters, size=answers)
    chance = 1 / (1 + np.exp(own[rater, second] - own[rater, first]))
    outcome = np.where(rng.random(answers) < chance, 1, -1)
    return Comparisons(METHODS, first, second, outcome, rater, np.arange(answers)), common


def main() -> None:
    """Print the share of scores inside, and of studies in which all six are."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--studies", type=int, default=200)
    parser.add_argument("--raters", type=int, default=7)
    parser.add_argument("--answers", type=int, default=3000)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--taste", type=float, default=0.0)
    options = parser.parse_args()
    inside, widths, begun = [], [], process_time()
    for seed in range(options.studies):
        made, true = study(seed, options.raters, options.answers, options.taste)
        found = scores_with_intervals(made, options.draws, seed)
        inside.append((found.low <= true) & (true <= found.high))
        widths.append((found.high - found.low).mean())
    scores = np.array(inside)
    print(
        f"{options.studies} studies of {options.raters} raters, {options.answers} answers: "
        f"{scores.mean():.3f} of the scores inside, all six in {scores.all(1).mean():.3f}; mean "
        f"width {np.mean(widths):.3f}; {process_time() - begun:.0f} CPU-s"
    )


if __name__ == "__main__":
    main()
