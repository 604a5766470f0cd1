"""The pose that puts the measured gaps between cells where they belong."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pv_inspect.detection.edges import CellEdges, EdgeOffsets
from pv_inspect.detection.outline import OutlineError
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.pose import Pose

__all__ = ["refined_pose", "split_edges"]

Array = NDArray[np.float64]

KAPPA_STEP = 1e-5
MIN_PARTS = 24
"""A pose and a lens have 9 parameters; so many measurements leave some to spare."""
PARTS = 3
SPLIT_LENGTH = 0.7
"""The share of an edge that its parts cover: mono cells have cut corners at the ends."""


def split_edges(edges: CellEdges) -> CellEdges:
    """Cut the edges of a single row, column or cell into parts, to be measured one by one.

    Where no line has two edges, an edge measured as one says where the line is but not how it is
    turned, and the pose stays open; and four cells have hardly more edges than a pose parameters.
    """
    upright = edges.normal[:, 0] == 1
    # As many different places along each direction as there are rows or columns.
    single = any(
        len(np.unique(edges.middle[side][:, axis].round(6))) == 1
        for axis, side in ((1, upright), (0, ~upright))
    )
    if not single and len(edges.middle) >= MIN_PARTS:
        return edges
    parts = max(PARTS, -(-MIN_PARTS // len(edges.middle)))
    step = ((np.arange(parts) + 0.5) / parts - 0.5) * SPLIT_LENGTH
    return CellEdges(
        (edges.middle[:, None] + step[:, None] * edges.along[:, None]).reshape(-1, 2),
        np.repeat(edges.normal, parts, axis=0),
        np.repeat(edges.along * SPLIT_LENGTH / parts, parts, axis=0),
        np.repeat(edges.crossings, parts, axis=0),
        np.repeat(edges.inner, parts),
        np.repeat(edges.side, parts),
        np.repeat(edges.gap, parts),
    )


def refined_pose(pose: Pose, edges: CellEdges, offsets: EdgeOffsets) -> Pose:
    """Fit homography and kappa to the measured gaps (robust, 9 parameters)."""
    use = offsets.found
    if use.sum() < 9:
        raise OutlineError(f"only {use.sum()} borders between cells were found")
    middle = edges.middle[use]
    normal = edges.normal[use]
    pixels = pose.project(middle + offsets.offset[use, None] * normal)
    sigma = np.maximum(offsets.sigma[use], 1e-4)
    # Dividing by a floor keeps a few very sharp gaps from deciding everything.
    weight = 1.0 / np.hypot(sigma, np.median(sigma))
    centre = middle.mean(axis=0)
    size = max(float(np.ptp(edges.middle, axis=0).max()) / 2, 1.0)
    inner = np.array([[size, 0, centre[0]], [0, size, centre[1]], [0, 0, 1.0]])
    first = pose.homography @ inner
    first = first / first[2, 2]

    def rebuilt(parameters: Array) -> Pose:
        matrix = np.append(parameters[:8], 1.0).reshape(3, 3) @ np.linalg.inv(inner)
        return Pose(Camera(pose.camera.K, float(parameters[8])), matrix)

    def residuals(parameters: Array) -> Array:
        moved = rebuilt(parameters).unproject(pixels)
        distance = np.nan_to_num(((moved - middle) * normal).sum(axis=1), nan=1.0)
        return np.append(weight * distance, (parameters[8] - pose.camera.kappa) / 0.2)

    normalised = pose.camera.to_normalised(pixels)

    def derivatives(parameters: Array) -> Array:
        # Module point = q[:2] / q[2], q = inner P^-1 ray: the eight of P analytically, kappa by
        # a difference, since it moves nothing but the rays.
        matrix = np.append(parameters[:8], 1.0).reshape(3, 3)
        inverse = np.linalg.inv(matrix)
        to_plane = inner @ inverse
        moved = []
        for kappa in (parameters[8], parameters[8] + KAPPA_STEP):
            ray = Camera(pose.camera.K, float(kappa)).undistort(normalised)
            q = np.column_stack([ray, np.ones(len(ray))]) @ to_plane.T
            moved.append((ray, q, q[:, :2] / q[:, 2:]))
        (ray, q, point), (_, _, further) = moved
        s = np.column_stack([ray, np.ones(len(ray))]) @ inverse.T
        along = ((normal @ to_plane[:2]) - (normal * point).sum(axis=1)[:, None] * to_plane[2]) / q[
            :, 2:
        ]
        by_matrix = -(along[:, :, None] * s[:, None, :]).reshape(len(s), 9)[:, :8]
        by_kappa = ((further - point) * normal).sum(axis=1) / KAPPA_STEP
        rows = np.nan_to_num(weight[:, None] * np.column_stack([by_matrix, by_kappa]))
        return np.vstack([rows, np.append(np.zeros(8), 1 / 0.2)])

    fit = least_squares(
        residuals,
        np.append(first.ravel()[:8], pose.camera.kappa),
        derivatives,
        loss="cauchy",
        f_scale=2.0,
        max_nfev=40,
    )
    return rebuilt(fit.x)
