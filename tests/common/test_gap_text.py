from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pv_inspect.common.gap_text import gap_text, gaps_from


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


@given(st.dictionaries(st.integers(1, 199), st.integers(1, 2000), max_size=5))
def test_what_is_written_is_read_again(widths: dict[int, int]) -> None:
    gaps = tuple(sorted((after, width / 1000) for after, width in widths.items()))
    assert gaps_from(gap_text(gaps)) == gaps
