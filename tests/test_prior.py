"""The prior against numerical derivatives and its majoriser's defining properties."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pv_inspect.prior import WeightedBtv
from pv_inspect.stencil import OFFSETS, Stencil

PRIOR = WeightedBtv(threshold=0.3, smoothing=0.05)


def image(seed: int = 0, shape: tuple[int, int] = (9, 11)) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, 0.4, shape)


@pytest.mark.parametrize("sparsity", [0.3, 0.5, 1.0])
def test_gradient_is_the_derivative_of_the_objective(sparsity: float) -> None:
    prior = replace(PRIOR, sparsity=sparsity)
    f, step = image(), 1e-6
    numerical = np.empty_like(f)
    for index in np.ndindex(f.shape):
        e = np.zeros_like(f)
        e[index] = step
        numerical[index] = (prior.objective(f + e) - prior.objective(f - e)) / (2 * step)
    np.testing.assert_allclose(prior.gradient(f), numerical, rtol=1e-5, atol=1e-7)


@given(st.integers(0, 10_000), st.floats(0.01, 2.0))
@settings(deadline=None, max_examples=30)
def test_majoriser_lies_above_the_objective_and_touches_it(seed: int, size: float) -> None:
    f = image(seed)
    other = f + size * image(seed + 1)
    L = PRIOR.majoriser(f)
    bound = PRIOR.objective(f) + 0.5 * (np.vdot(other, L.apply(other)) - np.vdot(f, L.apply(f)))
    assert PRIOR.objective(other) <= bound + 1e-9


def test_constant_images_cost_nothing() -> None:
    f = np.full((9, 11), 0.7)
    assert PRIOR.objective(f) == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(PRIOR.gradient(f), 0.0, atol=1e-12)


def test_prior_is_the_same_for_mirrored_and_turned_images() -> None:
    f = image()
    expected = PRIOR.objective(f)
    for other in (f[::-1], f[:, ::-1], f.T, f + 3.0, -f):
        assert PRIOR.objective(np.ascontiguousarray(other)) == pytest.approx(expected, rel=1e-12)


def test_weights_of_edges_are_continuous_at_the_threshold() -> None:
    def slope(d: float) -> float:
        f = np.zeros((1, 2))
        f[0, 1] = d
        return float(PRIOR.gradient(f)[0, 1])

    at = np.sqrt(PRIOR.threshold**2 - PRIOR.smoothing**2)
    assert slope(at * (1 + 1e-7)) == pytest.approx(slope(at * (1 - 1e-7)), rel=1e-5)
    assert slope(10 * at) < slope(at)


def test_threshold_follows_the_contrast_of_the_image() -> None:
    f = image(shape=(60, 60))
    one = PRIOR.adapted_to(f).threshold
    assert PRIOR.adapted_to(3 * f).threshold == pytest.approx(3 * one, rel=1e-9)
    assert PRIOR.adapted_to(np.zeros((9, 9))).threshold == PRIOR.smoothing


def test_stencil_is_the_symmetric_matrix_that_its_planes_say() -> None:
    rng = np.random.default_rng(7)
    shape = (4, 5)
    planes = rng.normal(size=(len(OFFSETS), *shape))
    matrix = np.zeros((20, 20))
    for k, (dy, dx) in enumerate(OFFSETS):
        for y, x in np.ndindex(shape):
            if 0 <= y + dy < shape[0] and 0 <= x + dx < shape[1]:
                a, b = y * 5 + x, (y + dy) * 5 + x + dx
                matrix[a, b] = matrix[b, a] = planes[k, y, x]
    f = rng.normal(size=shape)
    np.testing.assert_allclose(Stencil(planes).apply(f).ravel(), matrix @ f.ravel(), atol=1e-12)
