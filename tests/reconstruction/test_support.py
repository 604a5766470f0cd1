"""The support map against the resolution matrix it stands for."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.sparse.linalg import LinearOperator, minres

from pv_inspect.common.work import result_of
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.observation.model import ObservationModel
from pv_inspect.observation.normal_equations import NormalEquations
from pv_inspect.observation.stencil import Quadratic, Stencil
from pv_inspect.reconstruction.prior import prior_named
from pv_inspect.reconstruction.solver import Problem, minimise
from pv_inspect.reconstruction.support import FAINT, probe, support_of
from tests.recording import CAMERA, LAYOUT, NOISE, SHAPE, SIGMA, recording


def equations_of(moving: bool, n: int = 12) -> NormalEquations:
    sequence, registration, _ = recording(n, moving=moving)
    grid = HrGrid.covering(LAYOUT, registration.lr_px_per_unit, 3.0)
    homographies = registration.homographies
    model = ObservationModel.build(SensorRays.of(CAMERA, SHAPE), CAMERA, homographies, grid, SIGMA)
    equations = NormalEquations.empty(model)
    weights = np.full(SHAPE, NOISE**-2, np.float32)
    for H, image in zip(homographies, sequence.images, strict=True):
        equations.add(H, image, weights)
    return equations


def prior_of(equations: NormalEquations, strength: float) -> Stencil:
    """The same quadratic everywhere: strength times the mean of the data's diagonal."""
    shape = equations.model.grid.shape
    flat, squares = np.zeros(shape, np.float32), prior_named("tikhonov", 1.0)
    unit = squares.majoriser(flat)
    factor = strength * float(equations.diagonal.mean()) / float(unit.diagonal.mean())
    return squares.majoriser(flat, factor)


def same(prior: Quadratic) -> Callable[[np.ndarray], Quadratic]:
    """A prior that does not depend on the image."""
    return lambda _: prior


def support(
    equations: NormalEquations, prior_with: Callable[[np.ndarray], Quadratic]
) -> np.ndarray:
    return result_of(support_of(equations, prior_with))


def inner(image: np.ndarray) -> np.ndarray:
    h, w = image.shape
    return image[h // 3 : -h // 3, w // 3 : -w // 3]


def test_the_probe_holds_only_details_finer_than_the_lr_pixels() -> None:
    z = probe((512, 512), 4.0)
    spectrum = np.abs(np.fft.fft2(z)) ** 2
    f = 4.0 * np.hypot(np.fft.fftfreq(512)[:, None], np.fft.fftfreq(512)[None])
    band = (f >= 0.55) & (f <= 0.8)
    assert spectrum[band].sum() > 0.999 * spectrum.sum()
    assert z.std() == pytest.approx(1.0, rel=1e-3)


def test_without_a_prior_all_comes_from_the_frames_and_with_a_strong_one_nothing() -> None:
    equations = equations_of(moving=True)
    assert np.median(inner(support(equations, same(prior_of(equations, 1e-3))))) > 0.7
    assert np.median(inner(support(equations, same(prior_of(equations, 1e4))))) < 0.02


def test_support_falls_as_the_prior_gains_weight() -> None:
    equations = equations_of(moving=True)
    medians = [
        np.median(inner(support(equations, same(prior_of(equations, s))))) for s in (0.1, 1.0, 10.0)
    ]
    assert medians[0] > medians[1] > medians[2]


def test_frames_in_one_place_support_no_detail_beyond_their_own_resolution() -> None:
    moving, still = (equations_of(moving=m) for m in (True, False))
    prior = prior_of(moving, 0.1)
    moved = np.median(inner(support(moving, same(prior))))
    assert np.median(inner(support(still, same(prior)))) < 0.5 * moved


def test_support_is_what_arrives_of_a_detail_that_is_put_into_the_scene() -> None:
    equations = equations_of(moving=True)
    prior = prior_of(equations, 0.3)
    share = support(equations, same(prior))
    shape = equations.model.grid.shape
    z = np.roll(probe(shape, 3.0), (17, 31), axis=(0, 1))
    n = z.size

    def full(x: np.ndarray) -> np.ndarray:
        f = x.reshape(shape).astype(np.float32)
        return (equations.apply(f) + prior.apply(f)).ravel().astype(np.float64)

    b = equations.apply(z).astype(np.float64).ravel()
    u = minres(LinearOperator((n, n), matvec=full, dtype=np.float64), b, rtol=1e-5)[0]
    u = u.reshape(shape)
    arrived = float((inner(u) * inner(z)).sum() / (inner(z) ** 2).sum())
    assert arrived == pytest.approx(float(inner(share).mean()), abs=0.08)


def test_support_is_zero_where_no_frame_looks() -> None:
    equations = equations_of(moving=True)
    share = support(equations, same(prior_of(equations, 1e-3)))
    assert share[0, 0] == 0
    assert share.min() >= 0
    assert share.max() <= 1


@pytest.mark.parametrize("weight", [0.1, 0.3, 1.0])
def test_of_a_faint_detail_in_a_smooth_cell_arrives_as_much_as_support_says(weight: float) -> None:
    _, registration, _ = recording(12)
    grid = HrGrid.covering(LAYOUT, registration.lr_px_per_unit, 3.0)
    poses = registration.homographies
    model = ObservationModel.build(SensorRays.of(CAMERA, SHAPE), CAMERA, poses, grid, SIGMA)
    flat, z = np.full(grid.shape, 0.5, np.float32), probe(grid.shape, 3.0)
    faint = np.float32(FAINT * 0.5)

    def problem_of(scene: np.ndarray) -> Problem:
        equations = NormalEquations.empty(model)
        rng = np.random.default_rng(5)
        for H in poses:
            seen = model.frame(H).forward(scene) + rng.normal(0, NOISE, SHAPE)
            equations.add(H, seen.astype(np.float32), np.full(SHAPE, NOISE**-2, np.float32))
        return Problem(equations, weight, 0.5)

    without, with_detail = problem_of(flat), problem_of(flat + faint * z)
    plain, shown = (
        list(minimise(p, flat, 300, tolerance=1e-5))[-1].image for p in (without, with_detail)
    )
    difference = inner(shown - plain)
    arrived = float((difference * inner(z)).sum() / (inner(z) ** 2).sum()) / float(faint)
    share = support(without.equations, lambda u: without.majoriser(plain + faint * u))
    assert float(inner(share).mean()) == pytest.approx(arrived, abs=0.1)
