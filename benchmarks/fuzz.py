"""Fuzz every reader: random damage in files and arguments; one table, and the inputs that fail.

python -m benchmarks.fuzz            (make fuzz) all readers, 24,000 cases
python -m benchmarks.fuzz --kind settings --seed 3 --cases 2000
python -m benchmarks.fuzz --again fuzz_failures/001
"""

from __future__ import annotations

import argparse
import pickle
import re
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from time import perf_counter

from tests.fuzz.case import Case, Outcome
from tests.fuzz.cases import CASES
from tests.fuzz.pool import Reader
from tests.fuzz.tally import SEED, Tally, shares_of, tried


def _alone(kind: str, n_cases: int, number: int) -> Tally:
    with Reader() as reader:
        return tried(kind, n_cases, number, reader)


def main() -> int:
    """Run what the command line asks for; 1 if anything failed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=24_000, help="default 24000")
    parser.add_argument("--kind", choices=CASES, action="append", help="only this kind")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--jobs", type=int, default=2, help="processes at a time, default 2")
    parser.add_argument(
        "--keep", type=Path, default=Path("fuzz_failures"), help="folder for the failing inputs"
    )
    parser.add_argument("--again", type=Path, help="read one kept case again")
    given = parser.parse_args()
    if given.again:
        case = pickle.loads((given.again / "case.pickle").read_bytes())
        with Reader() as reader:
            print(reader.read(case))
        return 0
    begun = perf_counter()
    parts = _parts(shares_of(given.cases), given.kind or list(CASES), given.seed)
    with ProcessPoolExecutor(given.jobs) as pool:
        tallies = list(pool.map(_alone, *zip(*parts, strict=True)))
    _print(tallies, perf_counter() - begun)
    failures = [(t.kind, case, outcome) for t in tallies for case, outcome in t.failures]
    _keep(failures, given.keep, given.seed)
    return bool(failures)


def _parts(shares: dict[str, int], kinds: list[str], number: int) -> list[tuple[str, int, int]]:
    """Work in pieces, so that all processes end at about the same time."""
    parts = []
    for kind in kinds:
        n = shares[kind]
        pieces = -(-n // 1000)
        parts += [(kind, -(-n // pieces), number + k) for k in range(pieces)]
    return parts


def _print(tallies: list[Tally], seconds: float) -> None:
    kinds = list(dict.fromkeys(tally.kind for tally in tallies))
    head = ("kind", "cases", "accepted", "refused", "failed", "CPU s", "longest s", "most MiB")
    rows = []
    for kind in [*kinds, ""]:
        part = [tally for tally in tallies if kind in ("", tally.kind)]
        cases, accepted = sum(t.cases for t in part), sum(t.accepted for t in part)
        failed = sum(len(t.failures) for t in part)
        rows.append(
            (
                kind or "all",
                str(cases),
                str(accepted),
                str(cases - accepted - failed),
                str(failed),
                f"{sum(t.cpu_s for t in part):.0f}",
                f"{max(t.most_cpu_s for t in part):.2f}",
                f"{max(t.most_mib for t in part):.0f}",
            )
        )
    for row in (head, *rows):
        print(f"{row[0]:22}" + "".join(f"{text:>10}" for text in row[1:]))
    print(f"{seconds:.0f} s in all")


def _keep(failures: list[tuple[str, Case, Outcome]], folder: Path, number: int) -> None:
    """Write the failing inputs, one of each sort, and say what failed."""
    alike: Counter[tuple[str, str]] = Counter()
    for kind, case, outcome in failures:
        sort = (kind, outcome.where or re.sub(r"[^a-zA-Z ]+", "", outcome.fault)[:60])
        alike[sort] += 1
        if alike[sort] > 1:
            continue
        place = folder / f"{len(alike):03d}"
        place.mkdir(parents=True, exist_ok=True)
        (place / "case.pickle").write_bytes(pickle.dumps(case))
        print(f"\n{place}  {kind}, seed {number}: {outcome.fault}")
        print(f"    {outcome.where}  {case.args or [name for name, _ in case.files]}")
    for (kind, what), n in alike.most_common():
        print(f"{n:6}  {kind}: {what}")


if __name__ == "__main__":
    sys.exit(main())
