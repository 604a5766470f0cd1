from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pv_inspect.cracks.isolation import (
    Busbars,
    busbars_from_image,
    busbars_from_map,
    isolated_share,
)

SIDE = 240


def bars(*centres: int, width: int = 5, horizontal: bool = True) -> Busbars:
    lines = np.zeros(SIDE, bool)
    for centre in centres:
        lines[centre - width // 2 : centre + width // 2 + 1] = True
    return Busbars(horizontal, lines)


def drawn(*lines: tuple[tuple[int, int], tuple[int, int]], width: int = 3) -> np.ndarray:
    mask = np.zeros((SIDE, SIDE), np.uint8)
    for a, b in lines:
        cv2.line(mask, a, b, 1, width)
    return mask > 0


@pytest.mark.parametrize("width", [1, 3, 5, 7])
def test_a_crack_along_the_outer_busbar_cuts_off_the_strip_behind_it(width: int) -> None:
    share = isolated_share(drawn(((0, 20), (239, 20)), width=width), bars(60, 180))
    # the middle of the crack is at 20: 20 whole rows and half of its own
    assert share.mean() == pytest.approx(20.5 / SIDE, rel=0.005)


def test_a_crack_between_busbars_cuts_nothing_off() -> None:
    assert not isolated_share(drawn(((0, 120), (239, 120))), bars(60, 180)).any()


@pytest.mark.parametrize("width", [1, 3, 5])
def test_two_cracks_between_busbars_cut_off_what_lies_between_them(width: int) -> None:
    mask = drawn(((0, 100), (239, 100)), ((0, 140), (239, 140)), width=width)
    assert isolated_share(mask, bars(60, 180)).mean() == pytest.approx(40 / SIDE, rel=0.005)


def test_a_crack_over_half_of_the_width_breaks_the_fingers_that_it_crosses() -> None:
    share = isolated_share(drawn(((0, 20), (119, 20)), width=1), bars(60, 180))
    assert share[:, :120].mean() == pytest.approx(20.5 / SIDE, rel=0.005)
    assert not share[:, 122:].any()


def test_a_crack_along_the_fingers_cuts_nothing_off() -> None:
    share = isolated_share(drawn(((120, 0), (120, 239)), width=1), bars(60, 180))
    assert share.sum() < 40


@settings(max_examples=40, deadline=None)
@given(x=st.integers(60, 200), y=st.integers(40, 110), width=st.sampled_from([2, 3, 5]))
def test_a_crack_across_a_corner_cuts_off_the_triangle(x: int, y: int, width: int) -> None:
    row, col = np.mgrid[:SIDE, :SIDE]
    # drawn by its distance: cv2.line rounds where a line leaves the image
    mask = np.abs(col / x + row / y - 1) / np.hypot(1 / x, 1 / y) <= width / 2
    share = isolated_share(mask, bars(130, 200)).sum()
    # the line x'/x + y'/y = 1 against the edges of the cell at -0.5
    legs = x + 0.5 + 0.5 * x / y, y + 0.5 + 0.5 * y / x
    assert share == pytest.approx(legs[0] * legs[1] / 2, rel=0.01)


@pytest.mark.parametrize("centres", [(120,), (60, 180), (30, 90, 150, 210), range(20, 230, 26)])
def test_any_number_of_busbars_feeds_what_lies_next_to_them(centres: tuple[int, ...]) -> None:
    busbars = bars(*centres)
    assert busbars.count == len(centres)
    mask = drawn(((0, 8), (239, 8)), ((0, 232), (239, 232)), width=1)
    share = isolated_share(mask, busbars)
    assert share.mean() == pytest.approx((8.5 + 7.5) / SIDE, rel=0.005)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000))
def test_vertical_busbars_are_horizontal_ones_turned(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ends = rng.integers(0, SIDE, (4, 2, 2)).tolist()
    mask = drawn(*[(tuple(a), tuple(b)) for a, b in ends])
    level = isolated_share(mask, bars(60, 180))
    upright = isolated_share(mask.T, bars(60, 180, horizontal=False))
    np.testing.assert_array_equal(level, upright.T)
    # and nothing depends on which way is up
    mirrored = Busbars(True, bars(60, 180).lines[::-1])
    np.testing.assert_array_equal(isolated_share(mask[::-1], mirrored), level[::-1])


def test_more_cracks_never_cut_off_less() -> None:
    rng = np.random.default_rng(3)
    mask, before = np.zeros((SIDE, SIDE), bool), 0.0
    for _ in range(8):
        a, b = rng.integers(0, SIDE, (2, 2)).tolist()
        mask |= drawn((tuple(a), tuple(b)))
        share = isolated_share(mask, bars(60, 180))
        outside = float(share[~mask].sum() + mask.sum())
        assert outside >= before
        before = float(share[~mask].sum())


def test_busbars_are_found_in_the_map_and_in_the_image_of_a_cell() -> None:
    lines = bars(60, 180).lines
    for horizontal in (True, False):
        probability = np.where(lines[:, None], 0.8, 0.02).repeat(SIDE, 1).astype(np.float32)
        image = 1 - 0.7 * probability
        if not horizontal:
            probability, image = probability.T, image.T
        from_map = busbars_from_map(probability)
        from_image = busbars_from_image(image.astype(np.float32))
        for found in (from_map, from_image):
            assert found is not None
            assert (found.horizontal, found.count) == (horizontal, 2)
        np.testing.assert_array_equal(from_map.lines, lines)


def test_a_cell_without_busbars_has_none() -> None:
    assert busbars_from_map(np.full((50, 60), 0.1, np.float32)) is None
    assert busbars_from_image(np.full((50, 60), 0.1, np.float32)) is None
