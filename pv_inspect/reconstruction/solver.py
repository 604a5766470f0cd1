"""Minimiser of Eq. 7: majorise the prior by a quadratic, solve by conjugate gradients, repeat."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace
from functools import partial

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from pv_inspect.common.compiling import compiled
from pv_inspect.observation.normal_equations import NormalEquations
from pv_inspect.observation.stencil import Quadratic, dot
from pv_inspect.reconstruction.preconditioner import Spectral
from pv_inspect.reconstruction.prior import DEFAULT_PRIOR, Prior, PriorName, prior_named

__all__ = ["Problem", "Solution", "first_guess", "minimise"]

Image = NDArray[np.floating]

# Steps on one majoriser: with fewer most time goes into new ones, with more into minimising one
# that is out of date. The first ones are far off anyway.
_INNER_ITERATIONS = (4, 8, 12)
_INNER_ITERATIONS_SPECTRAL = (3, 4, 6)
# The prior measures differences in this share of the module's brightness.
_CONTRAST = 0.02


@dataclass(frozen=True, eq=False)
class Problem:
    """What to minimise.

    Parameters
    ----------
    equations : NormalEquations
        All data.
    prior_weight : float
        lambda.
    brightness : float
        Typical intensity of the module, full-scale units.
    prior_name : {"learned", "sparse_curvature", "wbtv", "btv", "tikhonov"}
        R.
    continued_prior : Prior, optional
        R with its scale as it was at an image; see `continued`.

    Notes
    -----
    ``E(f) = (1 / M) [ sum_i |g_i - W_i f|^2_{V_i^-1} + lambda s^-1 R(f / c) ]`` with M valid LR
    pixels, their noise variances V, the magnification s and c = 2 % of the brightness. The data
    term is a mean in units of the noise, about 1 at the truth. R sums over HR pixels, whose
    number over M falls as frames are added: a frame weighs the same, and with it lambda, for 5
    frames or 50. s^-1 makes what an edge costs the same on every grid.
    """

    equations: NormalEquations
    prior_weight: float
    brightness: float
    prior_name: PriorName = DEFAULT_PRIOR
    continued_prior: Prior | None = None

    @property
    def prior(self) -> Prior:
        """R(f / c) with c in full-scale units."""
        if self.continued_prior is not None:
            return self.continued_prior
        return prior_named(self.prior_name, _CONTRAST * self.brightness)

    def continued(self, image: Image, rounds: int) -> Problem:
        """Return the problem of the next round: itself, unless R's scale follows the image."""
        prior = self.prior
        following = prior.continued(image, rounds)
        return self if following is prior else replace(self, continued_prior=following)

    def majoriser(self, image: Image) -> Quadratic:
        """Return the prior's majoriser at an image, on the scale of the equations."""
        return self.prior.majoriser(image, self.prior_factor / 2.0)

    @property
    def prior_factor(self) -> float:
        """Factor of R in the objective times M."""
        return self.prior_weight / self.equations.model.grid.magnification


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the minimiser is.

    Parameters
    ----------
    image : (height, width) float32
    objective : tuple of float
        E after every majoriser, since the prior's scale stays.
    iterations : int
        Conjugate gradient steps.
    converged : bool
    problem : Problem
        What was minimised, with the prior's scale as it was at the end.
    """

    image: Image
    objective: tuple[float, ...]
    iterations: int
    converged: bool
    problem: Problem


def first_guess(equations: NormalEquations) -> Image:
    """Weighted average of the LR pixels around every HR pixel; where there are none, the nearest.

    Where no frame looks the prior alone decides, and it reaches only slowly what is right there.
    """
    blur = equations.model.blur
    weight = blur.apply(equations.coverage)
    mean = blur.apply(equations.back_projection)
    known = weight > 1e-3 * float(weight.max())
    mean[known] /= weight[known]
    if not known.any():
        return np.zeros_like(mean)
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(mean[tuple(nearest)])


def minimise(
    problem: Problem,
    start: Image,
    max_iterations: int,
    tolerance: float = 7e-4,
    spectral: bool = False,
) -> Generator[Solution, None, Solution]:
    """Minimise E from a start image; yields after every conjugate gradient step.

    Parameters
    ----------
    problem : Problem
    start : (height, width) float32
    max_iterations : int
        Limit of conjugate gradient steps in all.
    tolerance : float
        Converged when a whole round lowers E by less than this share of it and changes the image
        by less than three times this share of the brightness, rms. With the spectral
        preconditioner the default ends within about 0.1 dB of what ten times the steps give.
    spectral : bool
        Precondition in the frequency domain as well: half of the steps. Without, the learned prior
        ends early, 1.4 dB from its minimiser on one small scene.

    Yields
    ------
    Solution
        The current state; its arrays are views that go on changing.

    Notes
    -----
    R is majorised by a quadratic and the sum minimised by preconditioned conjugate gradients from
    where the last round ended: E falls from round to round. The loop keeps the residual of the data
    apart and updates everything in one pass; that of the support (`support_of`) does without. In
    one function they would round in another way.
    """
    equations = problem.equations
    f = start.copy()
    b = equations.right_hand_side
    residual = b - equations.apply(f)
    diagonal = equations.diagonal
    floor = 1e-6 * float(diagonal.max()) + np.finfo(np.float32).tiny
    m = max(equations.n_pixels, 1)
    objective: list[float] = []
    iterations, rounds, converged = 0, 0, False
    r, p = np.empty_like(f), np.empty_like(f)
    problem = problem.continued(f, 0)
    laplacian = problem.majoriser(f)
    steps = _INNER_ITERATIONS_SPECTRAL if spectral else _INNER_ITERATIONS
    frequencies: Spectral | None = None
    while not converged and iterations < max_iterations:
        if rounds:
            following = problem.continued(f, rounds)
            if following is not problem:
                problem = following
                objective.clear()
            laplacian = problem.majoriser(f)
        before = f.copy()
        scale = 1.0 / (diagonal + laplacian.diagonal + floor)
        np.subtract(residual, laplacian.apply(f), out=r)
        if spectral:
            root = np.sqrt(scale)
            if frequencies is None:
                frequencies = Spectral.of(partial(_whole, equations, laplacian), root)
            p = frequencies.apply(r, root)
        else:
            np.multiply(scale, r, out=p)
        rz = first = dot(r, p)
        inner = steps[min(rounds, len(steps) - 1)]
        for _ in range(min(inner, max_iterations - iterations)):
            if rz <= 0.0:
                break
            data = equations.apply(p)
            full = laplacian.apply(p)
            full += data
            curvature = dot(p, full)
            if curvature <= 0.0:
                break
            new = _step(rz / curvature, f, residual, r, p, data, full, scale)
            if frequencies is None:
                _turn(new / rz, p, r, scale)
            else:
                z = frequencies.apply(r, root)
                new = dot(r, z)
                p *= p.dtype.type(new / rz)
                p += z
            rz = new
            iterations += 1
            yield Solution(f, tuple(objective), iterations, False, problem)
            if rz < 1e-4 * first:
                break
        rounds += 1
        misfit = (equations.energy - dot(f, b) - dot(f, residual)) / m
        objective.append(misfit + problem.prior_factor * problem.prior.objective(f) / m)
        np.subtract(f, before, out=before)
        change = np.sqrt(dot(before, before) / f.size) / problem.brightness
        fall = objective[-2] - objective[-1] if len(objective) > 1 else np.inf
        converged = bool(change < 3.0 * tolerance and fall < tolerance * objective[-1])
    return Solution(f, tuple(objective), iterations, converged, problem)


def _whole(equations: NormalEquations, laplacian: Quadratic, f: Image) -> Image:
    return equations.apply(f) + laplacian.apply(f)


def _step(
    length: float,
    f: Image,
    residual: Image,
    r: Image,
    p: Image,
    data: Image,
    full: Image,
    scale: Image,
) -> float:
    rows = np.empty(f.shape[0])
    _step_rows(f.dtype.type(length), f, residual, r, p, data, full, scale, rows)
    return float(rows.sum())


def _turn(beta: float, p: Image, r: Image, scale: Image) -> None:
    _turn_rows(p.dtype.type(beta), p, r, scale)


@compiled(parallel=True, fastmath={"contract", "reassoc"})
def _step_rows(length, f, residual, r, p, data, full, scale, rows):  # type: ignore[no-untyped-def]
    """Go along p and update both residuals; rows of r' scale r."""
    for y in numba.prange(f.shape[0]):
        s = 0.0
        for x in range(f.shape[1]):
            f[y, x] += length * p[y, x]
            residual[y, x] -= length * data[y, x]
            q = r[y, x] - length * full[y, x]
            r[y, x] = q
            s += np.float64(q) * np.float64(q) * np.float64(scale[y, x])
        rows[y] = s


@compiled(parallel=True, fastmath={"contract"})
def _turn_rows(beta, p, r, scale):  # type: ignore[no-untyped-def]
    """Next conjugate direction."""
    for y in numba.prange(p.shape[0]):
        for x in range(p.shape[1]):
            p[y, x] = scale[y, x] * r[y, x] + beta * p[y, x]
