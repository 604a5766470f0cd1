"""Generators that do the work of others."""

from __future__ import annotations

from collections.abc import Generator

import pytest

from pv_inspect.common.work import forwarded, result_of


def counting(ended: list[str]) -> Generator[int, None, str]:
    try:
        yield 1
        yield 2
        return "made"
    finally:
        ended.append("closed")


def test_work_is_driven_to_its_end_and_told_in_other_words() -> None:
    seen: list[str] = []
    assert result_of(forwarded(counting([]), lambda n: f"step {n}"), seen.append) == "made"
    assert seen == ["step 1", "step 2"]


def test_closing_the_whole_closes_its_part() -> None:
    ended: list[str] = []
    whole = forwarded(counting(ended), str)
    next(whole)
    whole.close()
    assert ended == ["closed"]


def test_an_error_of_the_listener_closes_the_work() -> None:
    ended: list[str] = []

    def refuse(_: int) -> None:
        raise KeyError("no")

    with pytest.raises(KeyError):
        result_of(counting(ended), refuse)
    assert ended == ["closed"]
