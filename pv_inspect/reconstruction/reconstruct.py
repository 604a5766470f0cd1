"""The reconstruction: one HR module image out of all frames (paper, Sec. III-B, Eq. 7)."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pv_inspect.calibration.camera_profile import read_profile
from pv_inspect.common.work import Progress, forwarded
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.memory import release, require_memory
from pv_inspect.observation.motion_blur import length_and_angle
from pv_inspect.observation.stencil import Quadratic
from pv_inspect.photometry.photometry import (
    Photometry,
    estimate_photometry,
    mean_illumination,
)
from pv_inspect.reconstruction.accumulation import Accumulation
from pv_inspect.reconstruction.cell_sight import sight_of
from pv_inspect.reconstruction.held_out import View, cut_view
from pv_inspect.reconstruction.in_use import values_in_use
from pv_inspect.reconstruction.motion_estimation import estimate_motion
from pv_inspect.reconstruction.prior import PriorName
from pv_inspect.reconstruction.prior_weight import (
    Trial,
    choose_prior_weight,
    typical_prior_weight,
    windows_of,
)
from pv_inspect.reconstruction.profile_psf import evidence_of
from pv_inspect.reconstruction.profile_sensor import known_sensor
from pv_inspect.reconstruction.psf_combination import combined
from pv_inspect.reconstruction.psf_estimate import PsfEstimate
from pv_inspect.reconstruction.psf_estimation import TYPICAL_SIGMA_LR_PX
from pv_inspect.reconstruction.psf_evidence import (
    estimate_psf,
    read_borders,
    without_contradicted,
)
from pv_inspect.reconstruction.reconstruction import NO_CURVE, Curve, Reconstruction, brightness_of
from pv_inspect.reconstruction.resampling import resampled
from pv_inspect.reconstruction.sampling import between, of_more_than_one, sampling_of
from pv_inspect.reconstruction.solver import Problem, Solution, first_guess, minimise
from pv_inspect.reconstruction.support import FAINT, support_of
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings

__all__ = ["TYPICAL_SIGMA_LR_PX", "Progress", "reconstruct", "solve"]

Image = NDArray[np.float32]


# Steps after which the solver is usually near its end; for the progress only.
_TYPICAL_STEPS = 15.0
# Solver steps to the module image that the sensor is judged by.
_DRAFT_STEPS = 10
# Next to nothing passes the aperture beyond one cycle per LR pixel, so that the first image, by
# which the sensor is judged, need not be finer than three HR pixels per LR pixel. With two the
# columns of a sensor with streaks are told worse: 0.1 dB of D2, which this was decided on.
_DRAFT_MAGNIFICATION = 3.0


def reconstruct(
    sequence: FrameSequence, registration: Registration, settings: Settings
) -> Generator[Progress, None, Reconstruction]:
    """Reconstruct the module from all frames that are in use.

    Parameters
    ----------
    sequence : FrameSequence
    registration : Registration
    settings : Settings
        ``magnification``, ``prior``, ``prior_weight`` and ``psf_sigma_lr_px`` (both estimated if
        None, as far as the frames can say them: see
        `pv_inspect.reconstruction.sampling`), ``motion_blur``, ``second_pass`` and
        ``max_iterations`` count here.

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
    motion = np.zeros((len(sequence), 2))
    if settings.motion_blur == "auto":
        yield Progress(0.03, "estimating the motion blur")
        motion = estimate_motion(sequence, registration)
    require_memory(sequence.shape, int(used.size), grid, motion)
    profile = None
    if settings.camera_profile is not None:
        profile = read_profile(settings.camera_profile, sequence.shape)
    photometry = known_sensor(sequence, registration, profile)
    draft: Image | None = None
    if settings.second_pass:
        assumed = values_in_use(settings).psf_sigma_lr_px
        coarse = min(settings.magnification, _DRAFT_MAGNIFICATION)
        seen = HrGrid.covering(registration.layout, registration.lr_px_per_unit, coarse)
        first = Accumulation.begin(sequence, registration, seen, rays, assumed, motion, photometry)
        photometry, draft = yield from _draft(first, used, settings, grid)
        del first
        release()
    sampling = sampling_of(registration, sequence.shape)
    further = evidence_of(profile)
    psf, borders = combined(None, None, registration.lr_px_per_unit, further), None
    if sampling and (settings.psf_sigma_lr_px is None or motion.any()):
        yield Progress(0.25, "reading the borders of the cells")
        borders = read_borders(sequence, registration, photometry, rays, motion)
        motion = without_contradicted(motion, registration, borders)
    if settings.psf_sigma_lr_px is not None:
        psf = PsfEstimate(settings.psf_sigma_lr_px, 0.0, "given")
    elif sampling:
        psf = yield from estimate_psf(
            sequence, registration, photometry, rays, motion, borders, further
        )
        if psf.evidence == "pixels":
            # Held-out pixels of few frames are folded as those that predict them; borders are not.
            psf = replace(psf, sigma=between(TYPICAL_SIGMA_LR_PX, psf.sigma, sampling))
    sigma = psf.sigma
    data = Accumulation.begin(sequence, registration, grid, rays, sigma, motion, photometry, draft)
    windows = windows_of(grid) if settings.prior_weight is None and sampling else []
    trials = yield from _all_added(data, used, windows, 0.4, 0.5)
    _need_pixels(data)
    start = first_guess(data.equations) if draft is None else draft
    weight, curve = settings.prior_weight, NO_CURVE
    if weight is None:
        weight = typical_prior_weight(settings.prior)
        if windows:
            chosen = _choose_prior_weight(registration, trials, sigma, settings.prior)
            found, curve = yield from chosen
            weight = between(weight, found, sampling)
    del trials  # of hundreds of frames more than the module image itself
    release()
    made = yield from solve(data, start, weight, settings)
    return replace(made, lambda_curve=curve, psf=psf)


def solve(
    data: Accumulation, start: Image, prior_weight: float, settings: Settings
) -> Generator[Progress, None, Reconstruction]:
    """Reconstruct the module from the frames that have entered so far.

    Parameters
    ----------
    data : Accumulation
    start : (height, width) float32
        Image to start from: of `first_guess`, or what the frames before had given.
    prior_weight : float
        lambda.
    settings : Settings
        ``prior`` and ``max_iterations`` count here.

    Yields
    ------
    Progress

    Returns
    -------
    Reconstruction
    """
    equations, grid = data.equations, data.equations.model.grid
    sigma = equations.model.psf_sigma_lr_px
    problem = Problem(equations, prior_weight, brightness_of(start, grid), settings.prior)
    told = f"PSF sigma {sigma:.2f} LR px, lambda {prior_weight:.2g}"
    solver = minimise(problem, start, settings.max_iterations, spectral=True)

    def solving(state: Solution) -> Progress:
        share = 1 - np.exp(-state.iterations / _TYPICAL_STEPS)
        now = np.asarray(state.image, np.float32)
        return Progress(0.6 + 0.3 * share, f"solving, step {state.iterations}, {told}", now)

    solution = yield from forwarded(solver, solving)
    image = data.extremes.limit(np.asarray(solution.image, np.float32))
    faint = np.float32(FAINT * problem.brightness)

    def prior_with(detail: Image) -> Quadratic:
        return solution.problem.majoriser(image + faint * detail)

    support = yield from forwarded(
        support_of(equations, prior_with),
        lambda share: Progress(0.9 + 0.03 * share, "measuring the support by the frames", image),
    )
    support *= np.float32(of_more_than_one(sampling_of(data.registration, data.sequence.shape)))
    sight = yield from forwarded(
        sight_of(equations, prior_with, image),
        lambda share: Progress(0.93 + 0.02 * share, "measuring how cracks would show", image),
    )
    consistency, residual_rms = yield from forwarded(
        data.compare(image),
        lambda share: Progress(0.95 + 0.05 * share, "comparing the frames with the result", image),
    )
    return Reconstruction(
        image,
        support,
        grid,
        prior_weight,
        sigma,
        solution.objective,
        solution.converged,
        consistency,
        tuple(float(r) for r in residual_rms),
        tuple(length_and_angle(m) for m in data.motion),
        solution.iterations,
        photometry=data.photometry,
        prior=settings.prior,
        sight=sight,
    )


def _all_added(
    data: Accumulation,
    frames: NDArray[np.intp],
    windows: list[HrGrid],
    begin: float,
    end: float,
) -> Generator[Progress, None, list[Trial]]:
    """Let all frames enter; returns what they show of some windows."""
    registration, rays = data.registration, data.equations.model.rays
    views: list[list[View]] = [[] for _ in windows]
    grain = data.sequence.noise.grain_px
    for k, i in enumerate(frames):
        g, weights = data.add(int(i))
        H, motion = registration.homographies[i], data.motion[i]
        for window, seen in zip(windows, views, strict=True):
            view = cut_view(registration.camera, H, rays, window, g, weights, motion, grain)
            if view is not None:
                seen.append(view)
        share = begin + (end - begin) * (k + 1) / frames.size
        yield Progress(share, f"adding frame {k + 1} of {frames.size}")
    return [Trial(window, tuple(seen)) for window, seen in zip(windows, views, strict=True)]


def _draft(
    data: Accumulation, frames: NDArray[np.intp], settings: Settings, grid: HrGrid
) -> Generator[Progress, None, tuple[Photometry, Image]]:
    """Look at the module once to learn what the sensor does.

    Returns what it does, and the image, on a grid, as it is without the vignetting.
    """
    model, registration = data.equations.model, data.registration
    yield from _all_added(data, frames, [], 0.05, 0.12)
    _need_pixels(data)
    start = first_guess(data.equations)
    weight = values_in_use(settings).prior_weight
    problem = Problem(data.equations, weight, brightness_of(start, model.grid), settings.prior)
    draft = start
    for step, state in enumerate(minimise(problem, start, _DRAFT_STEPS)):
        draft = np.asarray(state.image, np.float32)
        shown = resampled(draft, model.grid, grid)
        yield Progress(0.12 + 0.08 * step / _DRAFT_STEPS, "a first image of the module", shown)
    known = data.photometry
    steps = estimate_photometry(data.sequence, registration, model, draft, data.motion, known)
    photometry = yield from forwarded(
        steps, lambda share: Progress(0.2 + 0.05 * share, "telling the sensor from the scene")
    )
    draft = draft / mean_illumination(photometry, registration, model, known)
    return photometry, resampled(draft, model.grid, grid)


def _need_pixels(data: Accumulation) -> None:
    if data.equations.n_pixels == 0:
        raise InspectionError(
            "None of the registered frames shows any part of the module: check rows, cols and the "
            "crossing points."
        )


def _choose_prior_weight(
    registration: Registration, trials: list[Trial], sigma: float, prior: PriorName
) -> Generator[Progress, None, tuple[float, Curve]]:
    choice = choose_prior_weight(registration.camera, trials, sigma, prior)
    return (
        yield from forwarded(
            choice,
            lambda share: Progress(0.5 + 0.1 * share, "choosing lambda from held-out pixels"),
        )
    )
