"""What the learned prior has beyond the others: convexity, bands of rows, filters from a file."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pv_inspect.reconstruction.filter_prior import FilterBank, learned_prior

SHAPE = (90, 37)
PRIOR = learned_prior(0.02)


def image(seed: int, scale: float = 0.05) -> np.ndarray:
    return 0.6 + scale * np.random.default_rng(seed).normal(size=SHAPE)


def test_filters_have_no_mean() -> None:
    for group in PRIOR.groups:
        np.testing.assert_allclose(group.filters.sum((1, 2)), 0.0, atol=1e-9)


def test_a_flat_image_costs_nothing() -> None:
    assert PRIOR.objective(np.full(SHAPE, 0.7)) == pytest.approx(0.0, abs=1e-6)


def test_the_diagonal_is_that_of_the_operator() -> None:
    bank = PRIOR.majoriser(image(0))
    for at in [(0, 0), (3, 5), (44, 20), (63, 2), (64, 18), (89, 36)]:
        unit = np.zeros(SHAPE)
        unit[at] = 1.0
        assert bank.diagonal[at] == pytest.approx(bank.apply(unit)[at], rel=1e-9, abs=1e-9)


def test_bands_join_without_a_seam() -> None:
    f = image(3)
    bank = PRIOR.majoriser(f)
    for cut in (slice(0, 64), slice(30, 90)):
        part = FilterBank(bank.groups, [v[cut] for v in bank.weights]).apply(f[cut])
        inside = slice(6, -6)
        np.testing.assert_allclose(part[inside], bank.apply(f)[cut][inside], rtol=1e-9, atol=1e-9)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 1000), st.floats(0.001, 1.0), st.floats(0.1, 0.9))
def test_it_is_convex(seed: int, scale: float, share: float) -> None:
    f, other = image(seed), image(seed + 1, scale)
    between = PRIOR.objective(share * f + (1 - share) * other)
    chord = share * PRIOR.objective(f) + (1 - share) * PRIOR.objective(other)
    assert between <= chord * (1 + 1e-9)
