"""The geometry that all frames share, measured on the gaps of the module image.

Frames that are registered to each other agree to a few thousandths of a pixel, but an error that
they share, a bend left by kappa above all, is in their mean as well. On a module the gaps between
the cells are straight and evenly spaced: what they show of a bend is taken out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.robust import MAD_TO_SIGMA
from pv_inspect.detection.edges import CellEdges, EdgeOffsets, cell_edges, measure_gaps_robustly
from pv_inspect.detection.gap_model import GapShape
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.pose import Pose
from pv_inspect.registration.seen_lines import seen_lines

__all__ = ["Straightened", "sharpened", "shown_points", "straighten"]

Array = NDArray[np.float64]
Image = NDArray[np.float32]

BLUR_LR_PX = 0.6
"""Standard deviation of the blur of a mean of frames: optics, aperture, interpolation."""
NOISE_TO_SIGNAL = 0.02
SHARPENED_GAP = GapShape(blur=0.3, width=1.1, reach=1.4)
"""A gap after sharpening, LR pixels: the cells beside it hardly reach into the fit."""
UNRESOLVED_LR_PX = 2.2
"""Sharpened gaps of the usual width seem 1.4 to 2.1 LR px wide, and the usual shape is found in
their middle (benchmarks/gapped_modules.py, seeds 0 to 23). In one of 2.5 px, too narrow for the
layout to have it, it was found up to 0.4 px off to either side (seed 24)."""
SEARCH_UNITS = 0.05
MIN_GAPS = 30
"""Fewer do not determine the 11 parameters better than the crossing points of all frames."""
CAUCHY = 2.385
"""95 % efficient on normal errors."""
CENTRE_STD_PX = 1.0
"""How far the principal point may go from where the calibration put it."""
SHOWN_BEYOND = 0.25
"""Cells. A photograph cropped to the edge of the module may cut half a gap; its outer crossing
points count."""


@dataclass(frozen=True, eq=False)
class Straightened:
    """What the gaps say of the camera.

    Parameters
    ----------
    camera : Camera
    homographies : (n, 3, 3) float64
    kappa_error, centre_error_px : float
        Standard deviations of kappa and of the principal point, per axis; 0 if they were kept.
    """

    camera: Camera
    homographies: Array
    kappa_error: float
    centre_error_px: float


def straighten(
    module: Image,
    grid: HrGrid,
    camera: Camera,
    homographies: Array,
    shape: tuple[int, int],
    kappa_std: float,
) -> Straightened | None:
    """Choose camera and poses so that the gaps of the module image are where they should be.

    Parameters
    ----------
    module : (H, W) float32
        Mean of the registered frames.
    grid : HrGrid
        Where its pixels lie.
    camera : Camera
    homographies : (n, 3, 3) float64
        Poses of the frames, module plane to normalised image coordinates.
    shape : tuple of int
        (height, width) of a frame.
    kappa_std : float
        How far kappa may go from where it is, standard deviation of a prior. 0 keeps kappa and
        principal point: only the homography common to all frames is fitted.

    Returns
    -------
    Straightened or None
        None if too few gaps are seen or they do not determine it.

    Notes
    -----
    Under the present geometry a gap that belongs at y appears at y + d. A change of the common
    homography (8 parameters p), of kappa and of the principal point moves what appears there by
    B(y) p + F(y) q, linear for such small changes; its normal component is fitted to the measured
    d by robust least squares, Cauchy weights on residuals over the sigma of each gap. F is averaged
    over the frames that show the point, which differ little.
    """
    layout = grid.layout
    edges = cell_edges(layout)
    plane = Pose(Camera(np.eye(3), 0.0), np.asarray(np.linalg.inv(grid.matrix), np.float64))
    sharp = sharpened(module, BLUR_LR_PX * grid.magnification)
    gap = SHARPENED_GAP
    seen = _seen_width(sharp, grid)
    if seen > UNRESOLVED_LR_PX:
        gap = gap.widened(seen - gap.width)
    offsets = measure_gaps_robustly(
        sharp, edges, plane, SEARCH_UNITS, gap.scaled(grid.magnification)
    )
    if offsets.found.sum() < MIN_GAPS:
        return None
    poses = [Pose(camera, H) for H in homographies]
    solution, errors = _fit(edges, offsets, poses, shape, grid, kappa_std)
    if not np.isfinite(solution).all():
        return None
    ideal = layout.crossings()
    appears = ideal + np.einsum("nki,i->nk", _basis(ideal, poses, shape, edges), solution)
    d_kappa, d_x, d_y = -solution[8:]
    K = camera.K + np.array([[0, 0, d_x], [0, 0, d_y], [0, 0, 0]])
    fitted = Camera(K, camera.kappa + d_kappa)
    known = []
    for pose in poses:
        shown = shown_points(pose, ideal, shape)
        moved = pose.under(fitted, ideal[shown], appears[shown])
        if moved is not None:
            known.append(moved.homography)
    if len(known) < len(poses) or not np.isfinite(known).all():
        return None
    centre_error = float(np.sqrt(np.square(errors[1:]).mean()))
    return Straightened(fitted, np.array(known), float(errors[0]), centre_error)


def _seen_width(sharp: Image, grid: HrGrid) -> float:
    """Width of the usual gaps beyond what the layout has of it, LR pixels; 0 if none is seen."""
    widths = []
    for lines, gap in zip(seen_lines(sharp, grid), grid.layout.cell_gap, strict=True):
        width = lines.widths[0]
        if np.isfinite(width).any():
            widths.append((float(np.nanmedian(width)) - gap) * lines.lr_px)
    return min(widths, default=0.0)


def sharpened(image: Image, sigma: float) -> Image:
    """Take a Gaussian blur out of an image by a Wiener filter.

    Parameters
    ----------
    image : (H, W) float32
    sigma : float
        Standard deviation of the blur, pixels.
    """
    pad = int(np.ceil(6 * sigma))
    padded = np.pad(image, pad, mode="edge")
    fy, fx = np.fft.fftfreq(padded.shape[0])[:, None], np.fft.rfftfreq(padded.shape[1])[None]
    transfer = np.exp(-2 * (np.pi * sigma) ** 2 * (fx**2 + fy**2))
    wiener = (1 + NOISE_TO_SIGNAL) * transfer / (transfer**2 + NOISE_TO_SIGNAL)
    out = np.fft.irfft2(np.fft.rfft2(padded) * wiener, padded.shape)
    return np.asarray(out[pad:-pad, pad:-pad], np.float32)


def _fit(
    edges: CellEdges,
    offsets: EdgeOffsets,
    poses: list[Pose],
    shape: tuple[int, int],
    grid: HrGrid,
    kappa_std: float,
) -> tuple[Array, Array]:
    """Solution, and standard deviations of kappa and the principal point."""
    scale = grid.pixels_per_unit / grid.magnification
    use = offsets.found
    basis = _basis(edges.middle, poses, shape, edges)
    rows = scale * np.einsum("nki,nk->ni", basis, edges.normal)[use]
    values = scale * offsets.offset[use]
    sigma = scale * offsets.sigma[use]
    # Columns of one order; a camera that must stay has a prior without any slack.
    size = np.maximum(np.abs(rows).max(axis=0), 1e-12)
    slack = np.array([np.inf] * 8 + [kappa_std] + [CENTRE_STD_PX if kappa_std > 0 else 0.0] * 2)
    slack = np.maximum(slack, 1e-12)
    prior = np.diag(1 / (slack * size))
    weight, usual = np.ones(len(values)), 1.0
    for _ in range(30):
        w = np.sqrt(weight) / (usual * sigma)
        design = np.vstack([rows / size * w[:, None], prior])
        solution, *_ = np.linalg.lstsq(design, np.append(values * w, np.zeros(11)), rcond=None)
        residual = (values - rows / size @ solution) / sigma
        usual = max(MAD_TO_SIGMA * float(np.median(np.abs(residual))), 1e-3)
        weight = 1 / (1 + (residual / (CAUCHY * usual)) ** 2)
    covariance = np.linalg.pinv(design.T @ design)
    errors = np.sqrt(np.diag(covariance)[8:]) / size[8:] * (kappa_std > 0)
    return np.asarray(solution / size), np.asarray(errors)


def shown_points(pose: Pose, points: Array, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Whether module points lie in a frame, or so little outside that its edge cut a gap.

    What a frame that shows a part of the module says of the rest is extrapolated.
    """
    jacobian = pose.camera.jacobian(pose.homography, points)
    with np.errstate(invalid="ignore"):
        scale = float(np.nanmedian(np.sqrt(np.abs(np.linalg.det(jacobian)))))
    return pose.shows(points, shape, SHOWN_BEYOND * scale)


def _basis(points: Array, poses: list[Pose], shape: tuple[int, int], edges: CellEdges) -> Array:
    """Displacements in the module plane: 8 of a homography, then kappa, cx, cy; (n, 2, 11)."""
    centre = edges.middle.mean(axis=0)
    x, y = ((points - centre) / np.ptp(edges.middle, axis=0).max()).T
    one, zero = np.ones_like(x), np.zeros_like(x)
    plane = np.stack(
        [
            np.stack([one, x, y, zero, zero, zero, x * x, x * y], axis=-1),
            np.stack([zero, zero, zero, one, x, y, x * y, y * y], axis=-1),
        ],
        axis=1,
    )
    moved, count = np.zeros((len(points), 2, 3)), np.zeros(len(points))
    for pose in poses:
        shown = shown_points(pose, points, shape)
        derivatives = pose.camera.derivatives(pose.homography, points[shown])
        by_camera = np.concatenate(
            [derivatives.d_kappa[..., None], derivatives.d_intrinsics[..., 2:]], axis=-1
        )
        # The pixel stays, so the point of the module that it shows moves the other way.
        moved[shown] -= np.linalg.solve(derivatives.d_module, by_camera)
        count += shown
    return np.concatenate([plane, moved / np.maximum(count, 1)[:, None, None]], axis=-1)
