"""How wide the optical blur is, from the frames themselves.

A part of the module is reconstructed with several widths from nine tenths of the LR pixels. The
width that predicts the remaining tenth best is taken: too wide a PSF asks for detail that the noise
forbids, too narrow a one for more contrast between neighbours than the prior believes.
"""

from __future__ import annotations

from collections.abc import Generator

import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.parallel import parallel_map
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.observation.motion_blur import detail_left
from pv_inspect.observation.normal_equations import NormalEquations
from pv_inspect.reconstruction.held_out import HeldOutPixels, View, equations_of, model_of, split
from pv_inspect.reconstruction.solver import Problem, first_guess, minimise

__all__ = [
    "SEARCHED_LR_PX",
    "TYPICAL_SIGMA_LR_PX",
    "TYPICAL_SPREAD_LR_PX",
    "estimate_psf_sigma",
    "window_of",
]

Image = NDArray[np.float32]

TYPICAL_SIGMA_LR_PX = 0.45
"""Optical sigma of lenses that are in focus, LR px; the first draft of the module assumes it."""
TYPICAL_SPREAD_LR_PX = 0.12
"""Spread that is expected of it, LR px."""
SEARCHED_LR_PX = (0.13, 1.5)
"""Limits of the search, LR px."""
# Where the search begins, and its steps, LR px.
_FIRST_SIGMA, _STEP = 0.49, 0.06
# A range that is narrower says more than the usual start, LR px.
_NARROW = 0.5
# Weight of the prior that the search begins with, and its limits.
_FIRST_WEIGHT, _LEAST_WEIGHT, _LARGEST_WEIGHT = 0.015, 1e-4, 1.0
_HELD_OUT = 0.1
_ITERATIONS = 25
_SIDE_LR_PX = 64.0
_SEED = 20


def window_of(grid: HrGrid, image: Image, side_lr_px: float = _SIDE_LR_PX) -> HrGrid:
    """Return the square window of a grid with the most detail in a first image of it."""
    side = int(min(side_lr_px * grid.magnification, *grid.shape))
    # In place, for the grid of a large sensor has a hundred million pixels.
    down, across = np.gradient(image)
    energy = np.asarray(np.abs(down), np.float32)
    del down
    energy += np.abs(across)
    del across
    np.minimum(energy, 4.0 * float(np.mean(energy)), out=energy)
    # The outline of the module is no detail of cells, and its surroundings are dark.
    x0, y0 = np.maximum(np.ceil(grid.to_pixels(np.zeros(2))).astype(int), 0)
    x1, y1 = np.floor(grid.to_pixels(np.asarray(grid.layout.size))).astype(int)
    x1, y1 = max(x1 - side, x0), max(y1 - side, y0)
    y0, y1, x0, x1 = (
        int(np.clip(v, 0, n - side))
        for v, n in (
            (y0, grid.shape[0]),
            (y1, grid.shape[0]),
            (x0, grid.shape[1]),
            (x1, grid.shape[1]),
        )
    )
    ys, xs = np.meshgrid(
        np.linspace(y0, y1, 24).astype(int), np.linspace(x0, x1, 24).astype(int), indexing="ij"
    )
    total = [
        float(energy[y : y + side, x : x + side].sum(dtype=np.float64))
        for y, x in zip(ys.ravel(), xs.ravel(), strict=True)
    ]
    k = int(np.argmax(total))
    y, x = int(ys.ravel()[k]), int(xs.ravel()[k])
    return grid.window(slice(y, y + side), slice(x, x + side))


def estimate_psf_sigma(
    camera: Camera,
    window: HrGrid,
    views: list[View],
    within: tuple[float, float] = SEARCHED_LR_PX,
) -> Generator[float, None, float | None]:
    """Find the optical sigma that predicts held-out pixels best.

    Parameters
    ----------
    camera : Camera
    window : HrGrid
        See `window_of`.
    views : list of View
    within : tuple of float, optional
        Least and largest sigma that is looked for, LR px.

    Yields
    ------
    float
        Share of the work done.

    Returns
    -------
    float or None
        Optical sigma, LR px: the vertex of the parabola through the best candidate and its
        neighbours. None if the best lies beyond the limits.

    Notes
    -----
    A stronger prior wants a narrower PSF for the same contrast between neighbours: prior weight and
    sigma are therefore found together, the best sigma of every weight, then the best weight. Where
    noise or motion leaves sigma open, what lenses usually do decides: n times the mean residual is
    -2 log likelihood, to which ((sigma - 0.45) / 0.12)^2 is added. Motion of less than about a
    pixel is no motion to the model; the sigma that is found contains it.
    """
    train, test = split(views, _HELD_OUT, _SEED)
    n_judged = max(sum(int((weights > 0).sum()) for weights in test), 1)
    scores: dict[tuple[float, float], float] = {}
    parts: dict[float, tuple[NormalEquations, HeldOutPixels]] = {}

    def score(sigma: float, weight: float) -> float:
        if sigma not in parts:
            model = model_of(camera, window, views, sigma)
            parts[sigma] = equations_of(model, views, train), HeldOutPixels.of(model, views, test)
        residual = _held_out_residual(*parts[sigma], weight)
        return residual + ((sigma - TYPICAL_SIGMA_LR_PX) / TYPICAL_SPREAD_LR_PX) ** 2 / n_judged

    def held_out(sigmas: list[float], weight: float) -> list[float]:
        new = [a for a in sigmas if (a, weight) not in scores]
        for a, value in zip(new, parallel_map(lambda a: score(a, weight), new), strict=True):
            scores[a, weight] = value
        return [scores[a, weight] for a in sigmas]

    def profile(weight: float, start: float) -> tuple[float, float]:
        """Best score at one weight, and its sigma: downhill in steps from a start."""
        sigma = start
        while True:
            around = [sigma + d for d in (-_STEP, 0.0, _STEP)]
            found = held_out(around, weight)
            best = int(np.argmin(found))
            if best == 1 or not within[0] < around[best] < within[1]:
                return found[1], sigma
            sigma = around[best]

    # Frames with motion blur say less of detail: the prior must weigh less by as much.
    weight = _FIRST_WEIGHT * detail_left(np.array([view.motion for view in views]))
    # From the middle of a narrow range, on the grid of the wide one.
    start = sum(within) / 2 if within[1] - within[0] < _NARROW else _FIRST_SIGMA
    steps = round((start - _FIRST_SIGMA) / _STEP)
    least, sigma = profile(weight, _FIRST_SIGMA + steps * _STEP)
    yield 0.5
    for factor in (0.5, 2.0):
        while _LEAST_WEIGHT < weight < _LARGEST_WEIGHT:
            other, at = profile(weight * factor, sigma)
            yield 0.75
            if other >= least:
                break
            least, sigma, weight = other, at, weight * factor
    return _vertex({s: value for (s, w), value in scores.items() if w == weight})


def _held_out_residual(
    equations: NormalEquations, held_out: HeldOutPixels, prior_weight: float
) -> float:
    """Mean squared prediction error of the held-out pixels in units of the noise."""
    guess = image = first_guess(equations)
    # A prior that sharpens edges by itself is content with too wide a PSF.
    problem = Problem(equations, prior_weight, float(np.median(guess)), "tikhonov")
    for state in minimise(problem, guess, _ITERATIONS, tolerance=0.0):
        image = state.image
    return held_out.residual(image) / max(held_out.n_pixels, 1)


def _vertex(scores: dict[float, float]) -> float | None:
    """Vertex of the parabola through the best width and its neighbours; None without both."""
    x = np.array(sorted(scores))
    y = np.array([scores[v] for v in x])
    k = int(np.argmin(y))
    if not 0 < k < len(x) - 1:
        return None
    c2, c1, _ = np.polyfit(x[k - 1 : k + 2], y[k - 1 : k + 2], 2)
    vertex = -c1 / (2 * c2) if c2 > 0 else x[k]
    return float(np.clip(vertex, x[k - 1], x[k + 1]))
