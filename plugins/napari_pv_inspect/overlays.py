"""Crossing points and grid lines of all frames as arrays; neither Qt nor napari."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from napari_pv_inspect.coordinates import in_frame, segments_in_frame
from pv_inspect.camera import Camera
from pv_inspect.layout import ModuleLayout
from pv_inspect.pipeline import Inspection

__all__ = ["CrossingMarks", "crossing_marks", "frame_grid", "frame_poses", "grid_of_frames"]

Array = NDArray[np.float64]

# Distortion bends a cell border by far less than a pixel within a quarter of a cell.
SEGMENTS_PER_CELL = 4


@dataclass(frozen=True)
class CrossingMarks:
    """Crossing points of all frames.

    Attributes
    ----------
    points : (n, 3) float64
        (frame, row, col).
    measured : (n,) bool
        False: predicted from its neighbours or from the fit.
    """

    points: Array
    measured: NDArray[np.bool_]


def crossing_marks(inspection: Inspection) -> CrossingMarks:
    """Return where the crossing points were measured, and where the fit expects the others."""
    points, measured = [np.empty((0, 3))], [np.empty(0, dtype=bool)]
    crossings = inspection.crossings
    for i, frame in enumerate(crossings.frames if crossings is not None else ()):
        found = frame.points_px.copy()
        is_measured = frame.measured & np.isfinite(found).all(axis=1)
        if (fit := inspection.calibration) is not None and fit.used[i]:
            found[~is_measured] = fit.crossings_px(i)[~is_measured]
        known = np.isfinite(found).all(axis=1)
        points.append(in_frame(found[known], i))
        measured.append(is_measured[known])
    return CrossingMarks(np.concatenate(points), np.concatenate(measured))


def frame_poses(inspection: Inspection) -> tuple[Camera, Array, NDArray[np.bool_]] | None:
    """Return camera, homographies (n_frames, 3, 3) and used (n_frames,), as well as known."""
    geometry = inspection.registration or inspection.calibration
    if geometry is None:
        return None
    return geometry.camera, geometry.homographies, geometry.used


def frame_grid(layout: ModuleLayout, camera: Camera, homography: Array, frame: int) -> Array:
    """Cell borders of one frame as short segments.

    Returns
    -------
    (n, 2, 3) float64
        Start (frame, row, col) and way to the end; without those beyond the fold of the lens.
    """
    start, end = grid_segments(layout)
    ends = camera.project(homography, np.concatenate([start, end]))
    a, b = ends[: len(start)], ends[len(start) :]
    visible = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
    return segments_in_frame(a[visible], b[visible], frame)


def grid_of_frames(inspection: Inspection) -> list[Array]:
    """Return the segments of every frame; an empty array for a frame that is not used."""
    poses = frame_poses(inspection)
    if poses is None:
        return []
    camera, homographies, used = poses
    nothing = np.empty((0, 2, 3))
    return [
        frame_grid(inspection.layout, camera, homographies[i], i) if used[i] else nothing
        for i in range(len(used))
    ]


def grid_segments(layout: ModuleLayout) -> tuple[Array, Array]:
    """Cell borders in the module plane, cut into short segments: starts and ends, each (n, 2)."""
    width, height = layout.size
    across = np.linspace(0.0, width, layout.cols * SEGMENTS_PER_CELL + 1)
    down = np.linspace(0.0, height, layout.rows * SEGMENTS_PER_CELL + 1)
    starts, ends = [], []
    for y in down[::SEGMENTS_PER_CELL]:
        line = np.column_stack([across, np.full_like(across, y)])
        starts.append(line[:-1])
        ends.append(line[1:])
    for x in across[::SEGMENTS_PER_CELL]:
        line = np.column_stack([np.full_like(down, x), down])
        starts.append(line[:-1])
        ends.append(line[1:])
    return np.concatenate(starts), np.concatenate(ends)
