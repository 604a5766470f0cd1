from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pv_inspect.common.gap_text import gap_text, gaps_from, sizes_from


@pytest.mark.parametrize(
    ("text", "gaps"),
    [
        ("10:0.1", ((10, 0.1),)),
        (" 12 : 0.5, 3:.25 ", ((3, 0.25), (12, 0.5))),
        ("10:16mm", ((10, 0.1),)),
        ("none", ()),
        ("", ()),
    ],
)
def test_gaps_are_read_in_cell_widths_and_in_millimetres(
    text: str, gaps: tuple[tuple[int, float], ...]
) -> None:
    assert gaps_from(text, cell_width_mm=160.0) == gaps


@pytest.mark.parametrize("text", ["10", "ten:0.1", "10:0.1:3", "10;0.1", "10:-1", "1" * 5000])
def test_what_is_no_gap_is_told_in_one_sentence(text: str) -> None:
    with pytest.raises(ValueError, match="AFTER:WIDTH") as caught:
        gaps_from(text)
    assert len(str(caught.value)) < 300


def test_millimetres_need_the_width_of_a_cell() -> None:
    with pytest.raises(ValueError, match="cell_width_mm"):
        gaps_from("10:16mm")


def test_widths_of_columns_are_read_as_gaps_are() -> None:
    assert sizes_from("12:78mm, 1:0.25", cell_width_mm=156.0) == ((1, 0.25), (12, 0.5))
    assert sizes_from("none") == ()
    with pytest.raises(ValueError, match="'12' is no width: write NUMBER:WIDTH, for example 12:0"):
        sizes_from("12")
    with pytest.raises(ValueError, match="cell_width_mm"):
        sizes_from("12:78mm")


@given(st.dictionaries(st.integers(1, 199), st.integers(1, 2000), max_size=5))
def test_what_is_written_is_read_again(widths: dict[int, int]) -> None:
    gaps = tuple(sorted((after, width / 1000) for after, width in widths.items()))
    assert gaps_from(gap_text(gaps)) == gaps
