from __future__ import annotations

import pytest

from napari_pv_inspect.models.remaining_time import remaining_s, remaining_text


def test_a_run_of_even_pace_is_foretold_exactly() -> None:
    assert remaining_s(0.25, 10.0) == pytest.approx(30.0)
    assert remaining_s(1.0, 10.0) == 0.0


def test_nothing_is_told_before_there_is_something_to_tell_by() -> None:
    assert remaining_s(0.0, 100.0) is None
    assert remaining_s(0.5, 0.1) is None
    assert remaining_text(0.01, 1.0) == ""
    assert remaining_text(1.0, 60.0) == ""


@pytest.mark.parametrize(
    ("left", "text"),
    [
        (3, "a few seconds left"),
        (22, "about 20 s left"),
        (54, "about 55 s left"),
        (100, "about 2 min left"),
        (5400, "about 1.5 h left"),
    ],
)
def test_the_words_are_as_coarse_as_the_estimate(left: float, text: str) -> None:
    assert remaining_text(0.5, float(left)) == text
