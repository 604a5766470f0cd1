"""The reconstruction: one HR module image out of all frames (paper, Sec. III-B, Eq. 7)."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.layout import HrGrid
from pv_inspect.observation import NormalEquations, ObservationModel, SensorRays
from pv_inspect.photometry import (
    Photometry,
    estimate_photometry,
    huber_weights,
    mean_illumination,
    observed,
)
from pv_inspect.psf_estimation import cut_view, estimate_psf_sigma, window_of
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
# Solver steps to the module image that the sensor is judged by.
_FIRST_LOOK = 10
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
    """

    image: Image
    support: Image
    grid: HrGrid
    prior_weight: float
    psf_sigma_lr_px: float
    objective: tuple[float, ...]
    converged: bool


def reconstruct(
    sequence: Sequence, registration: Registration, settings: Settings
) -> Generator[Progress, None, Reconstruction]:
    """Reconstruct the module from all frames that are in use.

    Parameters
    ----------
    sequence : Sequence
    registration : Registration
    settings : Settings
        ``magnification``, ``prior_weight``, ``psf_sigma_lr_px`` (estimated if None),
        ``second_look`` and ``max_iterations`` count here.

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
        sigma = yield from _estimate_psf(sequence, registration, settings, grid, rays)
    psf = f"PSF sigma {sigma:.2f} LR px"

    model = ObservationModel.build(
        rays, registration.camera, registration.homographies[used], grid, sigma
    )
    equations = NormalEquations.empty(model)
    for k, i in enumerate(used):
        g, weights = observed(sequence, registration, int(i))
        equations.add(registration.homographies[i], g, weights)
        yield Progress(
            0.2 + 0.2 * (k + 1) / used.size, f"adding frame {k + 1} of {used.size}, {psf}"
        )
    if equations.n_pixels == 0:
        raise InspectionError(
            "None of the registered frames shows any part of the module: check rows, cols and the "
            "crossing points."
        )
    guess = first_guess(equations)
    problem = Problem(equations, settings.prior_weight, _brightness(guess, grid))
    if settings.second_look:
        look = guess
        for step, state in enumerate(minimise(problem, guess, _FIRST_LOOK)):
            look = np.asarray(state.image)
            share = 0.4 + 0.15 * step / _FIRST_LOOK
            yield Progress(share, f"first look at the module, {psf}", look)
        equations, guess = yield from _second_look(sequence, registration, equations, look)
        problem = Problem(equations, settings.prior_weight, _brightness(guess, grid))
    solver = minimise(problem, guess, settings.max_iterations)
    while True:
        try:
            state = next(solver)
        except StopIteration as end:
            solution: Solution = end.value
            break
        share = state.iterations / settings.max_iterations
        message = f"solving, step {state.iterations} of at most {settings.max_iterations}, {psf}"
        yield Progress(0.65 + 0.34 * share, message, np.asarray(state.image, np.float32))
    return Reconstruction(
        np.asarray(solution.image, np.float32),
        _support(equations, solution),
        grid,
        settings.prior_weight,
        sigma,
        solution.objective,
        solution.converged,
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


def _second_look(
    sequence: Sequence, registration: Registration, first: NormalEquations, image: Image
) -> Generator[Progress, None, tuple[NormalEquations, Image]]:
    """Add all frames again, less what the sensor did to them, outliers with lower weights.

    Returns the equations and the image as it is without the vignetting.
    """
    model, used = first.model, np.flatnonzero(registration.used)
    steps = estimate_photometry(sequence, registration, model, image)
    while True:
        try:
            share = next(steps)
        except StopIteration as end:
            photometry: Photometry = end.value
            break
        yield Progress(0.55 + 0.04 * share, "telling the sensor from the scene")
    image = image / mean_illumination(photometry, registration, model)
    blurred = model.blur.apply(image)
    equations = NormalEquations.empty(model)
    for k, i in enumerate(used):
        g, weights = observed(sequence, registration, int(i), photometry)
        predicted = model.frame(registration.homographies[i]).sample(blurred)
        equations.add(registration.homographies[i], g, huber_weights(g, predicted, weights))
        share = (k + 1) / used.size
        yield Progress(0.59 + 0.06 * share, f"adding frame {k + 1} of {used.size} again")
    return equations, image


def _estimate_psf(
    sequence: Sequence,
    registration: Registration,
    settings: Settings,
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
    estimate = estimate_psf_sigma(camera, window, views, settings.prior_weight)
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
