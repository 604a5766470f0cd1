"""The priors against numerical derivatives and their majorisers' defining properties."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pv_inspect.observation.stencil import OFFSETS, Stencil
from pv_inspect.reconstruction.filter_prior import FilterPrior, learned_prior, sparse_curvature
from pv_inspect.reconstruction.prior import prior_named
from pv_inspect.reconstruction.total_variation import Btv, WeightedBtv

PRIORS = (
    sparse_curvature(0.2),
    sparse_curvature(0.2, smoothing=0.5, exponent=0.5),
    sparse_curvature(0.2, exponent=2.0),
    learned_prior(0.2),
    Btv(0.2),
    Btv(0.2, exponent=0.6),
    Btv(0.2, exponent=2.0),
    WeightedBtv(0.2),
    WeightedBtv(0.2, threshold=1.0),
    WeightedBtv(0.2, sparsity=0.7, threshold=0.3),
)


AnyPrior = FilterPrior | Btv | WeightedBtv


def image(seed: int = 0, shape: tuple[int, int] = (9, 11)) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, 0.4, shape)


def gradient(prior: AnyPrior, f: np.ndarray) -> np.ndarray:
    """What the majoriser says of d R / d f at the image that it touches R at."""
    return prior.majoriser(f).apply(f)


@pytest.mark.parametrize("prior", PRIORS)
def test_gradient_is_the_derivative_of_the_objective(
    prior: AnyPrior,
) -> None:
    f, step = image(), 1e-6
    numerical = np.empty_like(f)
    for index in np.ndindex(f.shape):
        e = np.zeros_like(f)
        e[index] = step
        numerical[index] = (prior.objective(f + e) - prior.objective(f - e)) / (2 * step)
    scale = np.abs(numerical).max()
    np.testing.assert_allclose(gradient(prior, f), numerical, rtol=1e-5, atol=1e-7 * scale)


@pytest.mark.parametrize("prior", PRIORS)
@given(seed=st.integers(0, 10_000), size=st.floats(0.01, 2.0))
@settings(deadline=None, max_examples=15)
def test_majoriser_lies_above_the_objective_and_touches_it(
    prior: AnyPrior, seed: int, size: float
) -> None:
    f = image(seed)
    other = f + size * image(seed + 1)
    L = prior.majoriser(f)
    bound = prior.objective(f) + 0.5 * (np.vdot(other, L.apply(other)) - np.vdot(f, L.apply(f)))
    assert prior.objective(other) <= bound * (1 + 1e-9)


@pytest.mark.parametrize("prior", PRIORS)
def test_constant_images_cost_nothing_and_slopes_cost_the_curvature_prior_nothing(
    prior: AnyPrior,
) -> None:
    flat = np.full((9, 11), 0.7)
    y, x = np.mgrid[:9, :11]
    slope = 0.1 * x - 0.05 * y
    for f in (
        (flat, slope) if isinstance(prior, FilterPrior) and prior.groups[0].reach == 1 else (flat,)
    ):
        assert prior.objective(f) == pytest.approx(0.0, abs=1e-10)
        np.testing.assert_allclose(gradient(prior, f), 0.0, atol=1e-10)


@pytest.mark.parametrize("prior", PRIORS)
def test_prior_is_the_same_for_mirrored_and_turned_images(
    prior: AnyPrior,
) -> None:
    f = image()
    expected = prior.objective(f)
    for other in (f[::-1], f[:, ::-1], f.T, f + 3.0, -f):
        assert prior.objective(np.ascontiguousarray(other)) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("name", ["learned", "sparse_curvature", "wbtv", "btv", "tikhonov"])
def test_prior_of_a_brighter_image_is_the_same_in_its_own_contrast(name: str) -> None:
    f = image()
    one = prior_named(name, 0.1).objective(f)  # type: ignore[arg-type]
    assert prior_named(name, 0.3).objective(3 * f) == pytest.approx(one)  # type: ignore[arg-type]


def test_tikhonov_is_quadratic_and_the_others_are_not() -> None:
    f = image()
    grown = {n: prior_named(n, 0.1) for n in ("learned", "sparse_curvature", "btv", "tikhonov")}  # type: ignore[arg-type]
    ratio = {n: prior.objective(10 * f) / prior.objective(f) for n, prior in grown.items()}
    assert ratio["tikhonov"] == pytest.approx(100.0)
    assert ratio["sparse_curvature"] < 20
    assert ratio["btv"] < 20
    assert ratio["learned"] < 20


def test_weighted_btv_without_a_threshold_is_btv_on_one_shift() -> None:
    f = image(shape=(1, 2))
    plain, weighted = Btv(0.2, alpha=1.0, smoothing=1.0), WeightedBtv(0.2, alpha=1.0)
    assert weighted.objective(f) == pytest.approx(plain.objective(f))
    np.testing.assert_allclose(gradient(weighted, f), gradient(plain, f))


def test_weighted_btv_counts_differences_over_the_threshold_for_less() -> None:
    """One pair of pixels: h' is 1 below t and p (t / u)^(1 - p) above, to be read off R."""
    prior = WeightedBtv(1.0, alpha=1.0, smoothing=1e-6, threshold=2.0)
    cost = [prior.objective(np.array([[0.0, z]])) for z in (1.0, 2.0, 8.0, 32.0)]
    np.testing.assert_allclose(cost, [1.0, 2.0, 4.0, 8.0], rtol=1e-5)
    pull = [gradient(prior, np.array([[0.0, z]]))[0, 1] for z in (1.0, 8.0, 32.0)]
    np.testing.assert_allclose(pull, [1.0, 0.25, 0.125], rtol=1e-5)


def test_threshold_is_twice_the_weighted_deviation_of_the_differences() -> None:
    """Laplacian differences: half of them are smaller than ln 2 of their scale."""
    steps = np.random.default_rng(3).laplace(0.0, 5.0, 40_000)
    f = np.cumsum(steps).reshape(1, -1)
    prior = WeightedBtv(1.0, alpha=1e-3)
    assert prior.continued(f, 0).threshold == np.inf
    # With alpha so small only the two nearest of the twelve differences are not zero; one is here.
    z = np.concatenate([1e-3 * np.diff(f[0]), 1e-6 * (f[0, 2:] - f[0, :-2])])
    expected = 2 * np.median(np.abs(z - np.median(z)))
    fitted = WeightedBtv(1.0, alpha=1e-3, smoothing=1e-9).continued(f, 1)
    assert fitted.threshold == pytest.approx(expected, rel=1e-6)
    confident = fitted.continued(f, 2)
    assert confident.threshold < fitted.threshold
    assert confident.continued(f, 100) is confident


def test_threshold_of_a_constant_image_is_the_smoothing() -> None:
    assert WeightedBtv(0.1).continued(np.full((8, 9), 0.5), 1).threshold == 1.0


def test_float32_majoriser_is_that_of_float64() -> None:
    f = image()
    for prior in PRIORS:
        double = prior.majoriser(f).diagonal
        single = prior.majoriser(f.astype(np.float32)).diagonal
        assert single.dtype == np.float32
        np.testing.assert_allclose(single, double, atol=1e-5 * np.abs(double).max())


@pytest.mark.parametrize("prior", PRIORS)
def test_majoriser_is_a_symmetric_matrix_with_the_diagonal_that_it_says(
    prior: AnyPrior,
) -> None:
    f = image(shape=(37, 8))
    L = prior.majoriser(f)
    units = np.eye(f.size).reshape(-1, *f.shape)
    matrix = np.array([L.apply(unit).ravel() for unit in units])
    scale = np.abs(matrix).max()
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12 * scale)
    np.testing.assert_allclose(np.diag(matrix), L.diagonal.ravel(), atol=1e-12 * scale)


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
