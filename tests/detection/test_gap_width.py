from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pv_inspect.detection.gap_model import GAP_SHAPES, STEP_PX, gap_basis
from pv_inspect.detection.gap_model import GapShape as Shape
from pv_inspect.detection.gap_width import gap_width, width_between_sides

X = STEP_PX * np.arange(-80.0, 81.0)


def _profiles(width: float, blur: float, floor: float, places: NDArray[np.float64]) -> NDArray:
    basis = (gap_basis(X - place, Shape(blur, width, 20.0))[0] for place in places)
    noise = np.random.default_rng(1).normal(0, 0.004, (len(places), len(X)))
    return np.array([one @ [1.0, 0.9, floor] for one in basis]) + noise


PLACES = np.linspace(-0.4, 0.4, 9)


@pytest.mark.parametrize("width", [2.2, 2.8, 3.6, 4.6])
@pytest.mark.parametrize("blur", [0.6, 0.9])
def test_a_resolved_gap_that_is_lit_is_as_wide_as_it_is(width: float, blur: float) -> None:
    profiles = _profiles(width, blur, 0.2, PLACES)
    assert gap_width(profiles, X, PLACES, GAP_SHAPES[2]) == pytest.approx(width, abs=0.12)


def test_a_narrow_gap_is_as_wide_as_the_light_that_it_takes() -> None:
    profiles = _profiles(1.0, 0.6, 0.0, PLACES)
    assert gap_width(profiles, X, PLACES, GAP_SHAPES[1]) == pytest.approx(1.0, abs=0.05)


def test_what_is_dark_on_both_sides_has_no_width() -> None:
    assert gap_width(np.zeros((3, len(X))), X, np.zeros(3), GAP_SHAPES[1]) == 0.0


@pytest.mark.parametrize("expected", [10.5, 12.0, 13.5])
def test_the_sides_of_a_wide_gap_tell_its_width(expected: float) -> None:
    profiles = _profiles(12.0, 0.7, 0.1, PLACES)
    assert width_between_sides(profiles, X, 1.0, expected) == pytest.approx(12.0, abs=0.15)


def test_a_width_whose_sides_are_not_seen_stays_as_expected() -> None:
    noise = np.random.default_rng(2).normal(0.5, 0.05, (6, len(X)))
    assert width_between_sides(noise, X, 1.0, 12.0) == 12.0
