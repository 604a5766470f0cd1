"""Whatever is in a file or on the command line: accepted, or refused in one sentence.

Two hundred of the cases of `make fuzz`, the same ones each time. Every reader runs in a process of
its own, so that a crash or a hang fails one test.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest

if sys.platform == "win32":
    pytest.skip("processes are limited and measured as POSIX does it", allow_module_level=True)

from tests.fuzz.case import Case, Outcome, fault_of
from tests.fuzz.pool import Reader
from tests.fuzz.readers import MISBEHAVIOUR
from tests.fuzz.tally import SEED, shares_of, tried

N_CASES = 200


@pytest.fixture(scope="module")
def reader() -> Iterator[Reader]:
    with Reader() as started:
        yield started


@pytest.mark.parametrize(("kind", "n_cases"), shares_of(N_CASES).items())
def test_any_input_is_accepted_or_refused_in_one_sentence(
    reader: Reader, kind: str, n_cases: int
) -> None:
    tally = tried(kind, n_cases, SEED, reader)
    assert not tally.failures, "\n".join(
        f"{outcome.fault} {outcome.where}\n    {case}"[:1500] for case, outcome in tally.failures
    )
    # That valid input is accepted is checked before the first case.
    assert tally.accepted < tally.cases == n_cases


class _Collector(Reader):
    """Reads nothing."""

    def __init__(self) -> None:
        self.seen: list[Case] = []

    def read(self, case: Case) -> Outcome:
        self.seen.append(case)
        return Outcome()


def test_the_same_number_makes_the_same_cases() -> None:
    first, again, other = _Collector(), _Collector(), _Collector()
    for number, collector in ((1, first), (1, again), (2, other)):
        tried("frames, TIFF", 30, number, collector)
    assert first.seen == again.seen != other.seen


@pytest.mark.parametrize("how", MISBEHAVIOUR)
def test_a_reader_that_misbehaves_is_noticed(reader: Reader, how: str) -> None:
    told = {
        "hangs": "did not end",
        "waits": "waiting for something",
        "crashes": "the process died of SIGSEGV",
        "prints": "printed b'libsomething",
        "grows": "MiB",
        "is slow": "s of processor time",
        "raises": "KeyError",
        "says much": "no whole sentence",
    }
    assert told[how] in reader.read(Case("misbehaves", args=(how,))).fault
    assert reader.read(Case("misbehaves")).fault == ""


@pytest.mark.parametrize(
    "said", ["", "No.", "This is no sentence", "Two\nlines are one too many.", "x " * 300 + "."]
)
def test_what_is_no_short_sentence_is_a_fault(said: str) -> None:
    assert fault_of(said)
    assert not fault_of("a.tif can't be read: remove it or copy it again.")
