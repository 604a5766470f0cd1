"""The ablation OURS-H (paper, Sec. IV-B): plain homographies between frames instead of a camera.

Every frame is aligned to one of the frames by maximising the enhanced correlation coefficient
(ECC; Evangelidis and Psarakis 2008, doi:10.1109/TPAMI.2008.113). There is no lens distortion and
no module image to align to: what the method loses by that is what the ablation measures.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.calibration.calibrate import Calibration
from pv_inspect.calibration.focal_length import usual_camera
from pv_inspect.common.work import Progress
from pv_inspect.detection.crossings import Crossings
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.module_choice.choice import choose_module
from pv_inspect.registration.alignment import normal_equations
from pv_inspect.registration.module_mean import module_mean
from pv_inspect.registration.register import MESSAGE, NOT_CONVERGED, left_out
from pv_inspect.registration.registration import Registration, normalised
from pv_inspect.sequence.frame import Frame
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings

__all__ = ["register_by_homography"]

Array = NDArray[np.float64]
Image = NDArray[np.float32]

GAUSS_SIZES = (15, 7, 5)
"""Side of ECC's own smoothing in successive rounds, LR px: coarse to fine."""
MAX_STEPS = 40
SMALLEST_GAIN = 1e-6
"""ECC ends when a step raises the correlation by less than this."""
MIN_CORRELATION = 0.85
"""ECC of a frame that shows the same module, relative to that of a typical frame."""
MAX_STRAY_CELLS = 0.4
MIN_POINTS = 8
MARGIN_CELLS = 0.2
REFERENCE_MAGNIFICATION = 2.0
HUBER = 2.5


@dataclass(frozen=True)
class _Aligned:
    """Pixel homography from the reference frame to a frame, and the correlation it reaches."""

    warp: Array
    correlation: float


def register_by_homography(
    sequence: FrameSequence,
    crossings: Crossings,
    settings: Settings,
    calibration: Calibration | None = None,
) -> Generator[Progress, None, Registration]:
    """Register every frame to a reference frame by a plain homography.

    Parameters
    ----------
    sequence : FrameSequence
    crossings : Crossings
        Only measured points count: they give the homographies to start from and, in the reference
        frame, the module plane.
    settings : Settings
        ``focal_length_px`` is the gauge if given; pixels do not depend on it. ``skip_frames`` and
        ``keep_frames`` overrule what is used, ``module_of`` chooses the module.
    calibration : Calibration, optional
        Poses of the frames, by which frames of other modules are told and left out.

    Yields
    ------
    Progress

    Returns
    -------
    Registration
        With kappa = 0. A frame that can't be aligned is not used, and says why.

    Raises
    ------
    InspectionError
        If no frame has enough measured crossing points, or the frames show several modules and
        none is shown by most.

    Notes
    -----
    x_i = W_i x_ref with W_i from ECC, coarse to fine, and x_ref = G y with the homography G of the
    module plane by the direct linear transform; hence H_i = K^-1 W_i G.
    """
    layout = crossings.layout
    comparable = True
    if calibration is not None:
        choice = choose_module(sequence, calibration, settings)
        crossings, comparable = choice.of_crossings(crossings), choice.comparable
    points = [_measured(frame.points_px, frame.measured, frame.why) for frame in crossings.frames]
    why = [frame.why or _too_few(p) for frame, p in zip(crossings.frames, points, strict=True)]
    for index, reason in left_out(sequence, settings).items():
        why[index] = why[index] or reason
    reference = _reference(points, why)
    plane = _homography(layout.crossings(), points[reference])
    if plane is None:
        raise InspectionError(
            f"The crossing points of {sequence.names[reference]} do not fit a module of "
            f"{layout.rows} x {layout.cols} cells: check rows and cols."
        )
    camera = usual_camera(sequence.shape, settings)
    target = sequence.frame(reference).image
    warps: dict[int, _Aligned] = {reference: _Aligned(np.eye(3), 1.0)}
    for index in range(len(sequence)):
        if not why[index] and index != reference:
            frame, start = sequence.frame(index), _homography(points[reference], points[index])
            mask = _mask(frame, points[index], layout)
            found = None if start is None else _aligned(target, frame, mask, start)
            if start is None or found is None:
                why[index] = "the alignment to the reference frame (ECC) did not converge"
            elif not _stray_cells(found.warp, start, points[reference], layout) < MAX_STRAY_CELLS:
                why[index] = "the alignment to the reference frame (ECC) lost it"
            else:
                warps[index] = found
        yield Progress(0.85 * (index + 1) / len(sequence), MESSAGE)
    _reject_other_modules(warps, why, reference, sequence.indices(settings.keep_frames))

    homographies = np.full((len(sequence), 3, 3), np.nan)
    used = np.array([not reason for reason in why])
    to_normalised = np.linalg.inv(camera.K)
    for index in (i for i in warps if used[i]):
        homographies[index] = _in_front(to_normalised @ warps[index].warp @ plane, layout)
    count = len(sequence)
    state = Registration(
        layout,
        camera,
        homographies,
        used,
        tuple(why),
        np.ones(count),
        np.zeros(count),
        np.full(count, np.nan),
        comparable,
    )
    return (yield from _with_photometry(sequence, state))


def _measured(points_px: Array, measured: NDArray[np.bool_], why: str) -> Array:
    """Measured points (n_crossings, 2), all others NaN."""
    good = np.asarray(measured, dtype=bool) & (why == "")
    return np.where(good[:, None], points_px, np.nan)


def _too_few(points: Array) -> str:
    n = int(np.isfinite(points).all(axis=1).sum())
    needed = max(4, min(MIN_POINTS, len(points)))
    return "" if n >= needed else f"only {n} of {len(points)} crossing points were measured"


def _reference(points: list[Array], why: list[str]) -> int:
    """Choose the frame with the most points; among equals the one nearest to the others."""
    candidates = [i for i, reason in enumerate(why) if not reason]
    if not candidates:
        first = next((reason for reason in why if reason), "there is no frame")
        raise InspectionError(f"No frame is left to register ({first}): check rows and cols.")
    counts = {i: int(np.isfinite(points[i]).all(axis=1).sum()) for i in candidates}
    best = [i for i in candidates if counts[i] == max(counts.values())]
    middles = {i: np.nanmean(points[i], axis=0) for i in best}
    typical = np.median(list(middles.values()), axis=0)
    return min(best, key=lambda i: float(np.linalg.norm(middles[i] - typical)))


def _homography(source: Array, target: Array) -> Array | None:
    """Homography between two sets of points by least squares; None if they do not fix one."""
    good = np.isfinite(source).all(axis=1) & np.isfinite(target).all(axis=1)
    if good.sum() < 4:
        return None
    H = np.asarray(cv2.findHomography(source[good], target[good], 0)[0], np.float64)
    if H.shape != (3, 3):  # there is none
        return None
    return H if np.isfinite(H).all() and abs(np.linalg.det(H)) > 1e-12 else None


def _mask(frame: Frame, points: Array, layout: ModuleLayout) -> NDArray[np.uint8]:
    """Pixels of the module that are valid: light from around it does not move with it."""
    plane = _homography(layout.crossings(), points)
    mask = np.zeros(frame.image.shape, np.uint8)
    if plane is None:
        return mask
    width, height = layout.size
    m = MARGIN_CELLS
    corners = np.array([[-m, -m], [width + m, -m], [width + m, height + m], [-m, height + m]])
    outline = cv2.perspectiveTransform(corners[None], plane)[0]
    cv2.fillConvexPoly(mask, np.round(outline).astype(np.int32), 255)
    mask[~frame.valid] = 0
    return mask


def _aligned(target: Image, frame: Frame, mask: NDArray[np.uint8], start: Array) -> _Aligned | None:
    """Maximise the ECC from coarse to fine; None if it fails."""
    warp = np.asarray(start / start[2, 2], np.float32)
    correlation = float("nan")
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, MAX_STEPS, SMALLEST_GAIN)
    for size in GAUSS_SIZES:
        try:
            correlation, found = cv2.findTransformECC(
                target, frame.image, warp, cv2.MOTION_HOMOGRAPHY, criteria, mask, size
            )
            warp = np.asarray(found, np.float32)
        except cv2.error:
            return None
        if not (np.isfinite(correlation) and np.isfinite(warp).all()):
            return None
    return _Aligned(np.asarray(warp, np.float64), float(correlation))


def _stray_cells(warp: Array, start: Array, points: Array, layout: ModuleLayout) -> float:
    """How far ECC has carried the crossing points from where they were measured, in cells."""
    good = points[np.isfinite(points).all(axis=1)]
    to, at = (cv2.perspectiveTransform(good[None], H)[0] for H in (warp, start))
    area = float(cv2.contourArea(cv2.convexHull(good.astype(np.float32))))
    width, height = layout.size
    distance = np.hypot(to[:, 0] - at[:, 0], to[:, 1] - at[:, 1])
    return float(np.median(distance) / np.sqrt(area / (width * height)))


def _reject_other_modules(
    warps: dict[int, _Aligned], why: list[str], reference: int, kept: list[int]
) -> None:
    """Take out frames that correlate far less with the reference, unless a person keeps them."""
    others = {i: found.correlation for i, found in warps.items() if i != reference}
    if not others:
        return
    typical = float(np.median(list(others.values())))
    for index, correlation in others.items():
        if correlation < MIN_CORRELATION * typical and index not in kept:
            why[index] = (
                "it does not show the same module as the reference frame "
                f"(correlation {correlation:.2f}, typically {typical:.2f})"
            )


def _in_front(H: Array, layout: ModuleLayout) -> Array:
    """Scale H so that the middle of the module has depth 1."""
    width, height = layout.size
    return np.asarray(H / (H[2] @ [width / 2, height / 2, 1.0]))


def _with_photometry(
    sequence: FrameSequence, state: Registration
) -> Generator[Progress, None, Registration]:
    """Fit gain and offset of every frame to the mean of all, and measure the residual."""
    grid = HrGrid.covering(state.layout, state.lr_px_per_unit, REFERENCE_MAGNIFICATION, 0.1)
    mean, covered = module_mean(sequence, state, grid)
    height, width = sequence.shape
    rows, cols = np.mgrid[0:height, 0:width].astype(np.float64)
    rays = state.camera.to_normalised(np.stack([cols, rows], axis=-1))
    size = 0.5 * max(grid.shape)
    gain, offset, rms = state.gain.copy(), state.offset.copy(), state.rms.copy()
    lost = []
    for index in np.flatnonzero(state.used):
        frame = sequence.frame(int(index))
        precision = sequence.noise.precision(frame.image, frame.valid, frame.added_variance)
        try:
            to_grid = np.asarray(np.linalg.inv(state.homographies[index] @ grid.matrix), np.float64)
        except np.linalg.LinAlgError:
            lost.append(int(index))
            continue
        for last in (False, False, True):
            A, b, chi2, n = normal_equations(
                frame.image,
                precision,
                rays,
                mean,
                covered,
                to_grid,
                size,
                float(gain[index]),
                float(offset[index]),
                HUBER,
                1,
            )
            if n < 20:
                break
            rms[index] = np.sqrt(chi2 / n)
            if not last:
                step = np.linalg.lstsq(A[8:, 8:], b[8:], rcond=None)[0]
                gain[index] = np.clip(gain[index] + step[0], 0.05, 20.0)
                offset[index] += step[1]
        yield Progress(0.85 + 0.15 * (int(index) + 1) / len(sequence), MESSAGE)
    used = state.used.copy()
    used[lost] = False
    why = tuple(NOT_CONVERGED if i in lost else reason for i, reason in enumerate(state.why))
    state = replace(state, used=used, why=why)
    return normalised(state, state.homographies, gain, offset, rms)
