"""The reconstruction: one HR module image out of all frames (paper, Sec. III-B, Eq. 7)."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.held_out import Trial, choose_prior_weight, windows_of
from pv_inspect.layout import HrGrid
from pv_inspect.observation import NormalEquations, ObservationModel, SensorRays
from pv_inspect.psf_estimation import View, cut_view, estimate_psf_sigma, window_of
from pv_inspect.registration import Registration
from pv_inspect.sequence import Sequence
from pv_inspect.settings import Settings
from pv_inspect.solver import Problem, Solution, first_guess, minimise

__all__ = ["Progress", "Reconstruction", "bicubic", "observed", "reconstruct"]

Image = NDArray[np.float32]

# Optical sigma [LR px] that the first look at the module assumes.
_TYPICAL_SIGMA = 0.45
# Frames that the first look and the PSF are estimated from.
_PSF_FRAMES = 20
# lambda of the squared differences that the PSF is estimated with.
_PSF_PRIOR_WEIGHT = 0.07
# HR rows that `bicubic` projects at a time.
_ROWS = 256


@dataclass(frozen=True, eq=False)
class Progress:
    """How far the reconstruction is.

    Parameters
    ----------
    fraction : float
        Share of the work that is done, 0..1.
    message : str
        What is being done.
    image : (height, width) float32, optional
        Current estimate, for previews; it goes on changing.
    """

    fraction: float
    message: str
    image: Image | None = None


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """The HR module image.

    Parameters
    ----------
    image : (height, width) float32
        Intensities, full scale = 1.
    support : (height, width) float32
        0..1: how much of a pixel is said by the frames; the rest is the prior's.
    grid : HrGrid
        Where the pixels lie on the module.
    prior_weight : float
        lambda that was used.
    psf_sigma_lr_px : float
        Optical blur that was used, LR px.
    objective : tuple of float
        Value of Eq. 7 after every round of the solver.
    converged : bool
        False: the iteration limit came first.
    lambda_curve : tuple of (float, float)
        Weights that were tried and what they left of held-out pixels, mean square in noise units;
        empty if the user gave lambda.
    iterations : int
        Steps of the solver.
    """

    image: Image
    support: Image
    grid: HrGrid
    prior_weight: float
    psf_sigma_lr_px: float
    objective: tuple[float, ...]
    converged: bool
    lambda_curve: tuple[tuple[float, float], ...] = ()
    iterations: int = 0


def reconstruct(
    sequence: Sequence, registration: Registration, settings: Settings
) -> Generator[Progress, None, Reconstruction]:
    """Reconstruct the module from all frames that are in use.

    Parameters
    ----------
    sequence : Sequence
    registration : Registration
    settings : Settings
        ``magnification``, ``prior``, ``prior_weight`` and ``psf_sigma_lr_px`` (both estimated if
        None) and ``max_iterations`` count here.

    Yields
    ------
    Progress
        Several times a second once the code is compiled; closing the generator cancels.

    Returns
    -------
    Reconstruction

    Raises
    ------
    InspectionError
        If no frame is in use or none of them shows the module.
    """
    used = np.flatnonzero(registration.used)
    if used.size == 0:
        raise InspectionError(
            f"None of the {len(sequence)} frames could be registered, so there is nothing to "
            "reconstruct: look at the reasons given for the frames."
        )
    grid = HrGrid.covering(registration.layout, registration.lr_px_per_unit, settings.magnification)
    rays = SensorRays.of(registration.camera, sequence.shape)
    yield Progress(0.02, "tracing the rays of the sensor")
    sigma = settings.psf_sigma_lr_px
    if sigma is None:
        sigma = yield from _estimate_psf(sequence, registration, grid, rays)
    psf = f"PSF sigma {sigma:.2f} LR px"

    model = ObservationModel.build(
        rays, registration.camera, registration.homographies[used], grid, sigma
    )
    equations = NormalEquations.empty(model)
    windows = windows_of(grid) if settings.prior_weight is None else []
    views: list[list[View]] = [[] for _ in windows]
    for k, i in enumerate(used):
        g, weights = observed(sequence, registration, int(i))
        for window, seen in zip(windows, views, strict=True):
            view = cut_view(
                registration.camera, registration.homographies[i], rays, window, g, weights
            )
            if view is not None:
                seen.append(view)
        equations.add(registration.homographies[i], g, weights)
        yield Progress(
            0.2 + 0.2 * (k + 1) / used.size, f"adding frame {k + 1} of {used.size}, {psf}"
        )
    if equations.n_pixels == 0:
        raise InspectionError(
            "None of the registered frames shows any part of the module: check rows, cols and the "
            "crossing points."
        )
    prior_weight = settings.prior_weight
    curve: tuple[tuple[float, float], ...] = ()
    if prior_weight is None:
        trials = [Trial(w, tuple(seen)) for w, seen in zip(windows, views, strict=True)]
        choice = choose_prior_weight(registration.camera, trials, sigma, settings.prior)
        while True:
            try:
                share = next(choice)
            except StopIteration as end:
                prior_weight, curve = end.value
                break
            yield Progress(0.4 + 0.1 * share, "choosing lambda from held-out pixels")
    guess = first_guess(equations)
    problem = Problem(equations, prior_weight, _brightness(guess, grid), settings.prior)
    solver = minimise(problem, guess, settings.max_iterations)
    while True:
        try:
            state = next(solver)
        except StopIteration as end:
            solution: Solution = end.value
            break
        share = state.iterations / settings.max_iterations
        message = f"solving, step {state.iterations} of at most {settings.max_iterations}, {psf}"
        yield Progress(0.5 + 0.49 * share, message, np.asarray(state.image, np.float32))
    return Reconstruction(
        np.asarray(solution.image, np.float32),
        _support(equations, solution),
        grid,
        prior_weight,
        sigma,
        solution.objective,
        solution.converged,
        curve,
        solution.iterations,
    )


def bicubic(
    sequence: Sequence, registration: Registration, grid: HrGrid, frame: int
) -> NDArray[np.float32]:
    """Rectify one frame by bicubic interpolation: what there is without super-resolution.

    Parameters
    ----------
    sequence : Sequence
    registration : Registration
    grid : HrGrid
    frame : int

    Returns
    -------
    (height, width) float32
        On the module's intensity scale; 0 where the frame does not see the module plane.
    """
    offset, gain = float(registration.offset[frame]), float(registration.gain[frame])
    image = np.ascontiguousarray((sequence.frame(frame).image - offset) / gain, dtype=np.float32)
    height, width = grid.shape
    out = np.empty(grid.shape, np.float32)
    for top in range(0, height, _ROWS):
        y, x = np.mgrid[top : min(top + _ROWS, height), :width].astype(np.float64)
        points = grid.to_module(np.stack([x, y], axis=-1))
        px = registration.camera.project(registration.homographies[frame], points)
        px = np.nan_to_num(px, nan=-10.0).astype(np.float32)
        out[top : top + _ROWS] = cv2.remap(
            image, px[..., 0], px[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT
        )
    return out


def observed(sequence: Sequence, registration: Registration, frame: int) -> tuple[Image, Image]:
    """Map a frame to the module's intensities.

    Returns
    -------
    g : (height, width) float32
        ``(image - offset) / gain``.
    weights : (height, width) float32
        1 / variance of g; 0 for pixels that are not valid.
    """
    ready = sequence.frame(frame)
    gain = float(registration.gain[frame])
    g = (ready.image - np.float32(registration.offset[frame])) / np.float32(gain)
    # The variance follows the light, not the pixel's own noise.
    smooth = cv2.GaussianBlur(ready.image, (0, 0), 1.0)
    weights = (gain / sequence.noise.sigma(smooth)) ** 2
    weights[~ready.valid] = 0.0
    return g.astype(np.float32), weights.astype(np.float32)


def _estimate_psf(
    sequence: Sequence,
    registration: Registration,
    grid: HrGrid,
    rays: SensorRays,
) -> Generator[Progress, None, float]:
    """Estimate the optical sigma on the part of the module with the most detail."""
    used = np.flatnonzero(registration.used)
    if used.size > _PSF_FRAMES:
        used = used[np.linspace(0, used.size - 1, _PSF_FRAMES).round().astype(int)]
    camera, homographies = registration.camera, registration.homographies
    # One frame, rectified, shows where detail is.
    look = bicubic(sequence, registration, grid, int(used[len(used) // 2]))
    smooth = cv2.GaussianBlur(look, (0, 0), max(grid.magnification / 2, 0.5))
    window = window_of(grid, np.asarray(smooth, np.float32))
    yield Progress(0.04, "estimating the PSF")
    views = []
    for i in used:
        g, weights = observed(sequence, registration, int(i))
        view = cut_view(camera, homographies[i], rays, window, g, weights)
        if view is not None:
            views.append(view)
    if not views:
        return _TYPICAL_SIGMA
    estimate = estimate_psf_sigma(camera, window, views, _PSF_PRIOR_WEIGHT)
    while True:
        try:
            share = next(estimate)
        except StopIteration as end:
            sigma: float = end.value
            return sigma
        yield Progress(0.05 + 0.15 * share, "estimating the PSF")


def _brightness(image: Image, grid: HrGrid) -> float:
    """Median intensity of the module; the prior measures contrast against it."""
    x0, y0 = np.round(grid.to_pixels(np.zeros(2)) + 0.5).astype(int)
    x1, y1 = np.round(grid.to_pixels(np.asarray(grid.layout.size)) + 0.5).astype(int)
    return max(float(np.median(image[y0:y1:2, x0:x1:2])), 1e-6)


def _support(equations: NormalEquations, solution: Solution) -> Image:
    """Share of the data in what holds an HR pixel in its place.

    Notes
    -----
    ``d / (d + r)`` with the diagonals d of the data and r of the prior. Samples that lie on a few
    HR pixels only, as those of frames that did not move, leave the others to the prior: d is
    therefore scaled by the harmonic over the arithmetic mean of the sampling density over one LR
    pixel, 1 for even sampling and 0 if there are holes.
    """
    density = equations.stencil.diagonal.astype(np.float32)
    side = max(round(equations.model.grid.magnification), 1)
    floor = 1e-4 * max(float(density.max()), 1e-30)
    mean = cv2.blur(density, (side, side))
    harmonic = 1.0 / cv2.blur(1.0 / (density + floor), (side, side))
    evenness = np.clip(harmonic / np.maximum(mean, floor), 0.0, 1.0)
    evenness[mean <= floor] = 0.0
    data = solution.data_diagonal * evenness
    total = data + solution.prior_diagonal
    support = np.divide(data, total, out=np.zeros_like(data), where=total > 0)
    return np.clip(support, 0.0, 1.0).astype(np.float32)
