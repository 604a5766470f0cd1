from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pv_inspect.cracks.centreline import branches, skeleton_length

SIDE = 256
_FRACTION_BITS = 4


def drawn(points: np.ndarray, width: int) -> np.ndarray:
    """A line through (n, 2) points (x, y), placed to a sixteenth of a pixel."""
    mask = np.zeros((SIDE, SIDE), np.uint8)
    fixed = np.round(np.asarray(points) * 2**_FRACTION_BITS).astype(np.int32)
    cv2.polylines(mask, [fixed.reshape(-1, 1, 2)], False, 1, width, cv2.LINE_8, _FRACTION_BITS)
    return mask > 0


@settings(max_examples=60, deadline=None)
@given(
    angle=st.floats(0, 180),
    width=st.integers(1, 6),
    length=st.floats(130, 220),
    shift=st.floats(-3, 3),
)
def test_the_length_of_a_line_is_right_within_two_percent_in_every_direction(
    angle: float, width: int, length: float, shift: float
) -> None:
    half = length / 2 * np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    middle = np.array([127 + shift, 127 - shift])
    mask = drawn([middle - half, middle + half], width)
    assert skeleton_length(mask) == pytest.approx(length, rel=0.02)
    assert len(branches(mask)) == 1


@pytest.mark.parametrize("width", [1, 2, 3, 5])
@pytest.mark.parametrize("period", [20, 35, 60])
def test_the_length_of_a_wavy_crack_is_right_within_two_percent(width: int, period: float) -> None:
    x = np.linspace(20, 236, 400)
    y = 127 + 25 * np.sin(x / period)
    length = np.hypot(np.diff(x), np.diff(y)).sum()
    assert skeleton_length(drawn(np.c_[x, y], width)) == pytest.approx(length, rel=0.02)


@pytest.mark.parametrize("width", [1, 3, 6])
@pytest.mark.parametrize("slope", [0.0, 0.3, -0.8])
def test_a_crack_is_followed_up_to_the_edges_of_the_cell(width: int, slope: float) -> None:
    mask = drawn([(-30, 127 - 157 * slope), (286, 127 + 159 * slope)], width)
    assert skeleton_length(mask) == pytest.approx(256 * np.hypot(1, slope), rel=0.02)


@pytest.mark.parametrize("radius", [40, 80])
def test_the_length_of_a_ring_is_its_circumference(radius: int) -> None:
    mask = np.zeros((SIDE, SIDE), np.uint8)
    cv2.circle(mask, (127, 127), radius, 1, 3)
    assert skeleton_length(mask > 0) == pytest.approx(2 * np.pi * radius, rel=0.02)


@pytest.mark.parametrize("width", [2, 3, 5])
@pytest.mark.parametrize("turn", [0, 17, 45, 80])
def test_three_cracks_that_meet_are_three_branches(width: int, turn: float) -> None:
    mask = np.zeros((SIDE, SIDE), bool)
    for angle in np.radians([turn, turn + 120, turn + 240]):
        end = 127 + 80 * np.array([np.cos(angle), np.sin(angle)])
        mask |= drawn([(127, 127), end], width)
    assert len(branches(mask)) == 3
    assert skeleton_length(mask) == pytest.approx(240, rel=0.02)


def test_a_rough_edge_makes_no_branches() -> None:
    rng = np.random.default_rng(0)
    mask = drawn([(20, 60), (230, 190)], 7)
    edge = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > mask
    mask |= edge & (rng.random(mask.shape) < 0.3)
    assert len(branches(mask)) == 1
    assert skeleton_length(mask) == pytest.approx(np.hypot(210, 130), rel=0.03)


def test_nothing_and_a_single_pixel_have_no_length() -> None:
    mask = np.zeros((20, 20), bool)
    assert skeleton_length(mask) == 0
    mask[10, 10] = True
    assert skeleton_length(mask) == 0
