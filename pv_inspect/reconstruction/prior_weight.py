"""How strong the prior has to be, from how well the image predicts pixels that it has not seen.

Parts of the module are reconstructed from four fifths of the LR pixels, with several weights from
strong to weak. The weight that predicts the remaining fifth best is taken: too strong a prior
predicts a blur, too weak a one the noise of the others. The PSF is known to some per cent only, and
an error of it is the same in all pixels: an image that is sharpened with a wrong PSF predicts them
well with that PSF. They are predicted with a wider and a narrower one instead.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.parallel import parallel_map
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.observation.normal_equations import NormalEquations
from pv_inspect.reconstruction.held_out import HeldOutPixels, View, equations_of, model_of, split
from pv_inspect.reconstruction.prior import DEFAULT_PRIOR, PriorName
from pv_inspect.reconstruction.solver import Problem, first_guess, minimise

__all__ = [
    "Trial",
    "choose_prior_weight",
    "typical_prior_weight",
    "windows_of",
]

Image = NDArray[np.floating]

CANDIDATES = {
    "sparse_curvature": tuple(float(v) for v in 8.0 * 0.5 ** np.arange(9)),
    "learned": tuple(float(v) for v in 8.0 * 0.5 ** np.arange(9)),
    "wbtv": tuple(float(v) for v in 8.0 * 0.5 ** np.arange(10)),
    "btv": tuple(float(v) for v in 4.0 * 0.5 ** np.arange(10)),
    "tikhonov": tuple(float(v) for v in 0.2 * 0.5 ** np.arange(11)),
}
"""Weights that are tried, from strong to weak."""
# Best crack masks and as few cracks missed as with stronger ones in single simulated frames
# (`benchmarks/few_frames.py`, seeds 0 to 33); of the others the middle candidate.
_TYPICAL = {"learned": 0.35}
_HELD_OUT = 0.2
_SEED = 7
# Steps from the first guess, and from the image of the next stronger weight.
_FIRST_STEPS, _NEXT_STEPS = 50, 30
# Share by which the PSF that predicts is wider, and narrower, than the one that reconstructs.
_PSF_ERROR = 0.12
# Windows lie on the module's diagonals, and are this wide.
_WINDOW_CENTRES = ((0.22, 0.27), (0.68, 0.36), (0.45, 0.74))
_SIDE_LR_PX = 48.0
# Weights this many steps beyond a minimum are no longer tried.
_BEYOND = 1


@dataclass(frozen=True, eq=False)
class Trial:
    """A part of the module with what every frame sees of it.

    Parameters
    ----------
    grid : HrGrid
    views : tuple of View
        What the frames see of it.
    """

    grid: HrGrid
    views: tuple[View, ...]


def typical_prior_weight(name: PriorName) -> float:
    """Return a weight that does no great harm, where there is nothing to choose by."""
    candidates = CANDIDATES[name]
    return _TYPICAL.get(name, candidates[len(candidates) // 2])


def windows_of(grid: HrGrid, side_lr_px: float = _SIDE_LR_PX) -> list[HrGrid]:
    """Return square windows of a grid, spread over the module."""
    side = int(min(side_lr_px * grid.magnification, *grid.shape))
    windows = []
    for at in _WINDOW_CENTRES:
        x, y = np.round(grid.to_pixels(np.asarray(at) * grid.layout.size)).astype(int) - side // 2
        x = int(np.clip(x, 0, grid.shape[1] - side))
        y = int(np.clip(y, 0, grid.shape[0] - side))
        windows.append(grid.window(slice(y, y + side), slice(x, x + side)))
    return windows


def choose_prior_weight(
    camera: Camera,
    trials: Sequence[Trial],
    sigma: float,
    name: PriorName = DEFAULT_PRIOR,
) -> Generator[float, None, tuple[float, tuple[tuple[float, float], ...]]]:
    """Find the prior weight that predicts held-out pixels best.

    Parameters
    ----------
    camera : Camera
    trials : sequence of Trial
        Parts of the module; their residuals are pooled.
    sigma : float
        Optical sigma, LR px.
    name : {"learned", "sparse_curvature", "wbtv", "btv", "tikhonov"}

    Yields
    ------
    float
        Share of the work done.

    Returns
    -------
    weight : float
        lambda: the vertex of the parabola in log lambda through the best candidate and its
        neighbours.
    curve : tuple of (float, float)
        Candidates from weak to strong, with the mean squared residual of the held-out pixels in
        units of the noise; 1 is noise alone, the error of the PSF adds to it. Empty if no frame
        sees a window.
    """
    seen = [trial for trial in trials if trial.views]
    runs = parallel_map(lambda trial: _Run.of(camera, trial, sigma, name), seen)
    runs = [run for run in runs if run.equations.n_pixels]
    candidates = CANDIDATES[name]
    scores: list[float] = []
    for k, weight in enumerate(candidates):
        pooled = np.array(parallel_map(partial(_Run.error, weight=weight), runs))
        if not len(pooled) or pooled[:, 1].sum() == 0:
            return typical_prior_weight(name), ()
        scores.append(float(pooled[:, 0].sum() / pooled[:, 1].sum()))
        yield (k + 1) / len(candidates)
        if k - int(np.argmin(scores)) >= _BEYOND:
            break
    curve = tuple(zip(candidates, scores, strict=False))[::-1]
    return _vertex(curve), curve


@dataclass(eq=False)
class _Run:
    """A window in the course of its reconstructions."""

    equations: NormalEquations
    held_out: tuple[HeldOutPixels, ...]
    name: PriorName
    brightness: float
    image: Image
    steps: int = _FIRST_STEPS

    @classmethod
    def of(cls, camera: Camera, trial: Trial, sigma: float, name: PriorName) -> _Run:
        grid, views = trial.grid, trial.views
        train, test = split(views, _HELD_OUT, _SEED)
        equations = equations_of(model_of(camera, grid, views, sigma), views, train)
        held_out = tuple(
            HeldOutPixels.of(model_of(camera, grid, views, sigma * factor), views, test)
            for factor in (1.0 - _PSF_ERROR, 1.0 + _PSF_ERROR)
        )
        guess = first_guess(equations)
        return cls(equations, held_out, name, _typical(guess), guess)

    def error(self, weight: float) -> tuple[float, int]:
        """Reconstruct with a weight from where the last one ended; squared residuals and number."""
        problem = Problem(self.equations, weight, self.brightness, self.name)
        for state in minimise(problem, self.image, self.steps, tolerance=0.0):
            self.image = state.image
        self.steps = _NEXT_STEPS
        total = sum(held_out.residual(self.image) for held_out in self.held_out)
        return total, sum(held_out.n_pixels for held_out in self.held_out)


def _typical(image: Image) -> float:
    return max(float(np.median(image)), 1e-6)


def _vertex(curve: tuple[tuple[float, float], ...]) -> float:
    """Vertex of the parabola through the best weight and its neighbours, in log lambda."""
    x, y = np.log([w for w, _ in curve]), np.array([e for _, e in curve])
    k = int(np.argmin(y))
    if k in (0, len(y) - 1) or len(y) < 3:
        return float(np.exp(x[k]))
    c2, c1, _ = np.polyfit(x[k - 1 : k + 2] - x[k], y[k - 1 : k + 2], 2)
    step = -c1 / (2 * c2) if c2 > 0 else 0.0
    return float(np.exp(np.clip(x[k] + step, x[k - 1], x[k + 1])))
