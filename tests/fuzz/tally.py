"""Many cases for one reader, and what came of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from time import process_time

from hypothesis import HealthCheck, Phase, given, seed, settings

from tests.fuzz.case import Case, Outcome
from tests.fuzz.cases import CASES, SHARES
from tests.fuzz.pool import Reader

__all__ = ["SEED", "Tally", "shares_of", "tried"]

SEED = 20_261_127


@dataclass
class Tally:
    """What came of the cases of one kind.

    Parameters
    ----------
    kind : str
    cases, accepted : int
    most_cpu_s, most_mib : float
        Of one case.
    cpu_s : float
        Of all cases, and of making them.
    failures : list of (Case, Outcome)
    """

    kind: str
    cases: int = 0
    accepted: int = 0
    most_cpu_s: float = 0.0
    most_mib: float = 0.0
    cpu_s: float = 0.0
    failures: list[tuple[Case, Outcome]] = field(default_factory=list)


def shares_of(n_cases: int) -> dict[str, int]:
    """How many of ``n_cases`` each kind gets."""
    return {kind: -(-n_cases * share // sum(SHARES.values())) for kind, share in SHARES.items()}


def tried(kind: str, n_cases: int, number: int, reader: Reader) -> Tally:
    """Give a reader ``n_cases`` cases; the same number, the same cases."""
    tally = Tally(kind)
    begun = process_time()

    @seed(number)
    @settings(
        max_examples=n_cases,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(CASES[kind]())
    def one(case: Case) -> None:
        outcome = reader.read(case)
        tally.cases += 1
        tally.accepted += not outcome.said and not outcome.fault
        tally.most_cpu_s = max(tally.most_cpu_s, outcome.cpu_s)
        tally.most_mib = max(tally.most_mib, outcome.peak_mib)
        tally.cpu_s += outcome.cpu_s
        if outcome.fault:
            tally.failures.append((case, outcome))

    one()
    tally.cpu_s += process_time() - begun
    return tally
