"""Photometric registration of every frame against the virtual module image (paper, Eq. 6).

The reference is not a frame but the mean of all frames on the module plane, free of perspective
and lens distortion, and it is built anew between the rounds: no single frame's noise or aliasing
enters the poses.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.calibration.calibrate import Calibration
from pv_inspect.common.work import Progress
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.pose import Pose
from pv_inspect.memory import release
from pv_inspect.module_choice.choice import choose_module
from pv_inspect.registration.alignment import N_PARAMETERS, normal_equations
from pv_inspect.registration.light_falloff import evenly_lit
from pv_inspect.registration.module_mean import blur, detail_correlation, indices, module_mean
from pv_inspect.registration.registration import Registration, normalised, unregistered
from pv_inspect.registration.straightening import shown_points, straighten
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings

__all__ = ["left_out", "register"]

MESSAGE = "registering the frames against the module"

Array = NDArray[np.float64]
Image = NDArray[np.float32]


@dataclass(frozen=True)
class _Round:
    """One pass over all frames.

    Blur of both images [LR px], pixel stride, iterations per frame, magnification of the module
    image.
    """

    blur_lr_px: float
    stride: int
    iterations: int
    magnification: float


ROUNDS = (
    _Round(2.5, 2, 5, 1.0),
    _Round(1.0, 2, 3, 1.0),
    _Round(0.0, 2, 3, 2.0),
    _Round(0.0, 1, 2, 2.0),
)
"""Coarse to fine: the first round catches errors of a few pixels, the last polishes."""
COARSE_ROUNDS = 2
STRAIGHTENING_MAGNIFICATION = 3.0
LEFT_OUT = "left out as the settings say"
NOT_CONVERGED = "registration did not converge"
KAPPA_SLACK = 3.0
"""The detection's own bias leaves kappa up to so many standard deviations off."""
MIN_FRAMES_TO_STRAIGHTEN = 5
"""The mean of fewer frames shows their noise and aliasing."""
HUBER = 2.5
MIN_CORRELATION = 0.5
"""Correlation of detail with the module image, relative to that of a typical frame."""
MIN_TYPICAL = 0.2
"""If the frames hardly correlate, all cells look alike and the correlation tells nothing."""
MAX_STRAY_CELLS = 0.4
"""A registered frame that moved further from its crossing points is lost, in cell widths."""


def register(
    sequence: FrameSequence, calibration: Calibration, settings: Settings
) -> Generator[Progress, None, Registration]:
    """Refine every pose so that the frame agrees with the module image (Eq. 6).

    Parameters
    ----------
    sequence : FrameSequence
    calibration : Calibration
    settings : Settings
        If ``kappa`` or ``calibration_file`` is given, the camera stays as it is.

    Yields
    ------
    Progress

    Returns
    -------
    Registration

    Raises
    ------
    InspectionError
        If no frame is left, or the frames show several modules and none is shown by most.

    Notes
    -----
    Gauss-Newton on 8 parameters plus gain and offset per frame, minimising
    sum_x rho((g_i(x) - gain f(m_i^-1(x)) - offset) / sigma(x)) with Huber's rho. This determines
    the poses relative to each other only: an error that all frames share, a bend left by kappa
    above all, is in the module image too. Before the last round the gaps of the module image, which
    are straight and evenly spaced, are therefore measured and the camera is fitted again; in the
    end the homography common to all frames is chosen so that the crossing points stay where this
    fit has them.

    Where frames show different parts of the module, the fall-off of the light is told from them
    after the coarse rounds and taken out of the frames: gains and offsets are those of frames
    without it then (see `pv_inspect.registration.light_falloff`).
    """
    choice = choose_module(sequence, calibration, settings)
    calibration = choice.of_calibration(calibration)
    state = replace(unregistered(calibration), comparable=choice.comparable)
    state = _without(state, left_out(sequence, settings))
    if int(state.used.sum()) == 0:
        raise InspectionError(
            f"No frame is left to register ({_first_reason(state.why)}): check rows and cols."
        )
    lr_px_per_unit = state.lr_px_per_unit
    rays = _rays(state.camera, sequence.shape)
    anchor: Calibration | Registration = calibration
    total = len(ROUNDS) * len(sequence)
    done = 0
    for number, plan in enumerate(ROUNDS):
        release()
        if number == COARSE_ROUNDS:
            sequence, state = evenly_lit(sequence, state)
        if number == len(ROUNDS) - 1:
            free = settings.kappa is None and settings.calibration_file is None
            slack = KAPPA_SLACK * calibration.kappa_std if free else 0.0
            straight = _straightened(sequence, state, slack)
            if straight is not None:
                state = anchor = straight
                rays = _rays(state.camera, sequence.shape)
            yield Progress(done / total, MESSAGE)
        grid = HrGrid.covering(state.layout, lr_px_per_unit, plan.magnification, 0.1)
        reference, covered = module_mean(sequence, state, grid)
        yield Progress(done / total, MESSAGE)
        blurred = blur(reference, plan.blur_lr_px * grid.magnification)
        correlation = np.full(len(sequence), np.nan)
        rms = np.full(len(sequence), np.nan)
        homographies, gain, offset = (
            state.homographies.copy(),
            state.gain.copy(),
            state.offset.copy(),
        )
        for index in range(len(sequence)):
            done += 1
            if state.used[index]:
                frame = sequence.frame(index)
                precision = sequence.noise.precision(frame.image, frame.valid, frame.added_variance)
                try:
                    (homographies[index], gain[index], offset[index], rms[index]) = _align(
                        blur(frame.image, plan.blur_lr_px),
                        precision,
                        rays,
                        blurred,
                        covered,
                        grid,
                        (homographies[index], float(gain[index]), float(offset[index])),
                        plan,
                    )
                except np.linalg.LinAlgError:
                    homographies[index] = np.nan
                if number == 0 and np.isfinite(homographies[index]).all():
                    correlation[index] = detail_correlation(
                        frame.image, state.camera, homographies[index], blurred, covered, grid
                    )
            yield Progress(done / total, MESSAGE)
        found = np.isfinite(homographies).all(axis=(1, 2)) & np.isfinite(gain + offset)
        lost = dict.fromkeys(indices(state.used & ~found), NOT_CONVERGED)
        state = normalised(_without(state, lost), homographies, gain, offset, rms)
        if number == 0 and state.used.any():
            kept = sequence.indices(settings.keep_frames)
            state = _rejected(state, calibration, correlation, kept)
        if not state.used.any():
            raise InspectionError(
                "The frames do not agree with each other "
                f"({_first_reason(state.why)}): check that they show the same module."
            )
    return _anchored(state, anchor, sequence.shape)


def _align(
    image: Image,
    precision: Image,
    rays: Array,
    module: Image,
    covered: NDArray[np.bool_],
    grid: HrGrid,
    start: tuple[Array, float, float],
    plan: _Round,
) -> tuple[Array, float, float, float]:
    homography, gain, offset = start
    height, width = grid.shape
    size = 0.5 * max(height, width)
    scale = np.array(
        [
            [1 / size, 0, -0.5 * (width - 1) / size],
            [0, 1 / size, -0.5 * (height - 1) / size],
            [0, 0, 1],
        ]
    )
    unscale = np.linalg.inv(scale)
    to_grid = np.asarray(np.linalg.inv(homography @ grid.matrix), np.float64)
    rms = float("nan")
    for _ in range(plan.iterations):
        A, b, chi2, count = normal_equations(
            image, precision, rays, module, covered, to_grid, size, gain, offset, HUBER, plan.stride
        )
        if count < 20 * N_PARAMETERS:
            break
        rms = float(np.sqrt(chi2 / count))
        damping = 1e-9 * np.diag(A) + 1e-12
        step = np.linalg.solve(A + np.diag(damping), b)
        increment = np.append(step[:8], 0.0).reshape(3, 3)
        to_grid = np.asarray(unscale @ (np.eye(3) + increment) @ scale @ to_grid, np.float64)
        gain, offset = gain + float(step[8]), offset + float(step[9])
        gain = float(np.clip(gain, 0.05, 20))
        if np.abs(step[:8]).max() * size < 1e-4:
            break
    refined = np.linalg.inv(to_grid) @ np.linalg.inv(grid.matrix)
    # Keep the scale of H, whose sign says what lies in front of the camera.
    refined *= homography[2, 2] / refined[2, 2]
    return refined, gain, offset, rms


def _rays(camera: Camera, shape: tuple[int, int]) -> Array:
    """Undistorted normalised coordinates of all LR pixels; NaN beyond the fold."""
    rows, cols = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float64)
    return camera.undistort(camera.to_normalised(np.stack([cols, rows], axis=-1)))


def left_out(sequence: FrameSequence, settings: Settings) -> dict[int, str]:
    """Say why frames are not used whatever they show: no measurements, or not wanted."""
    skipped = dict.fromkeys(sequence.indices(settings.skip_frames), LEFT_OUT)
    return sequence.no_measurements | skipped


def _without(state: Registration, reasons: dict[int, str]) -> Registration:
    """Leave out some frames."""
    used, why = state.used.copy(), list(state.why)
    for index, reason in reasons.items():
        used[index] = False
        why[index] = why[index] or reason
    return replace(state, used=used, why=tuple(why))


def _rejected(
    state: Registration, calibration: Calibration, correlation: Array, kept: list[int]
) -> Registration:
    """Take out frames that show something else than the others do; a person may keep them."""
    used, why = state.used.copy(), list(state.why)
    typical = float(np.nanmedian(correlation))
    scale = state.lr_px_per_unit
    for index in indices(state.used):
        moved = state.crossings_px(index) - calibration.crossings_px(index)
        stray = float(np.nanmedian(np.linalg.norm(moved, axis=1))) / scale
        alien = typical > MIN_TYPICAL and correlation[index] < MIN_CORRELATION * typical
        if alien and index not in kept:
            why[index] = (
                "it does not show the same module as the others "
                f"(correlation {correlation[index]:.2f}, typically {typical:.2f})"
            )
        elif not stray < MAX_STRAY_CELLS:
            why[index] = f"registration lost it (moved by {stray:.1f} cells)"
        used[index] = why[index] == ""
    return replace(state, used=used, why=tuple(why), rms=np.where(used, state.rms, np.nan))


def _straightened(
    sequence: FrameSequence, state: Registration, kappa_std: float
) -> Registration | None:
    """Refit camera and poses to the gaps of the module image; None if they are not seen enough."""
    if state.used.sum() < MIN_FRAMES_TO_STRAIGHTEN:
        return None
    grid = HrGrid.covering(state.layout, state.lr_px_per_unit, STRAIGHTENING_MAGNIFICATION)
    module, _ = module_mean(sequence, state, grid)
    fitted = straighten(
        module, grid, state.camera, state.homographies[state.used], sequence.shape, kappa_std
    )
    if fitted is None:
        return None
    camera, poses = fitted.camera, fitted.homographies
    homographies = state.homographies.copy()
    homographies[state.used] = poses
    errors = (fitted.kappa_error, fitted.centre_error_px) if kappa_std > 0 else None
    return replace(state, camera=camera, homographies=homographies, camera_errors=errors)


def _anchored(
    state: Registration, anchor: Calibration | Registration, shape: tuple[int, int]
) -> Registration:
    """Choose the homography common to all frames so that the crossings stay where they were."""
    ideal = state.layout.crossings()
    mean = _mean_crossings(state, anchor, shape)
    good = np.isfinite(mean).all(axis=1)
    if good.sum() < 4:
        return state
    common = np.asarray(cv2.findHomography(ideal[good], mean[good], 0)[0], np.float64)
    if common.shape != (3, 3) or not np.isfinite(common).all():
        return state
    homographies = state.homographies.copy()
    homographies[state.used] = homographies[state.used] @ common
    return replace(state, homographies=homographies)


def _mean_crossings(
    state: Registration, anchor: Calibration | Registration, shape: tuple[int, int]
) -> Array:
    """Where the crossing points of other poses lie on the registered module, on average.

    NaN where no frame shows them.
    """
    ideal = state.layout.crossings()
    total, count = np.zeros_like(ideal), np.zeros(len(ideal))
    for i in indices(state.used):
        shown = shown_points(Pose(anchor.camera, anchor.homographies[i]), ideal, shape)
        found = state.camera.unproject(state.homographies[i], anchor.crossings_px(i))
        shown &= np.isfinite(found).all(axis=1)
        total[shown] += found[shown]
        count += shown
    with np.errstate(invalid="ignore"):
        return np.asarray(total / count[:, None])


def _first_reason(why: tuple[str, ...]) -> str:
    return next((reason for reason in why if reason), "no reason recorded")
