"""Crossing points and grid lines of all frames as arrays; neither Qt nor napari."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from napari_pv_inspect.coordinates import in_frame, segments_in_frame
from pv_inspect.detection.crossings import Crossings
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.inspection.inspection import Inspection

__all__ = [
    "EDITED",
    "MEASURED",
    "PREDICTED",
    "CrossingMarks",
    "crossing_marks",
    "frame_grid",
    "frame_poses",
    "grid_of_frames",
]

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
    frame, crossing : (n,) int
        Which frame, and which crossing of the module, row-major.
    kind : (n,) int
        MEASURED, PREDICTED from its neighbours or from the fit, or EDITED by a person.
    """

    points: Array
    frame: NDArray[np.intp]
    crossing: NDArray[np.intp]
    kind: NDArray[np.intp]

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Points that the fit uses: (n,) bool."""
        return np.asarray(self.kind != PREDICTED)


MEASURED, PREDICTED, EDITED = 0, 1, 2


def crossing_marks(
    crossings: Crossings | None, predicted: Callable[[int], Array] | None = None
) -> CrossingMarks:
    """Return where the crossing points were measured, and where the others should lie.

    Parameters
    ----------
    crossings : Crossings or None
    predicted : callable, optional
        (n_crossings, 2) px of a frame; without it, or where it is NaN, the detection's own guess.
    """
    points, numbers, kinds = [np.empty((0, 3))], [np.empty((0, 2), int)], [np.empty(0, int)]
    for i, frame in enumerate(crossings.frames if crossings is not None else ()):
        found = frame.points_px.copy()
        is_measured = frame.measured & np.isfinite(found).all(axis=1)
        if predicted is not None:
            better = predicted(i)
            use = ~is_measured & np.isfinite(better).all(axis=1)
            found[use] = better[use]
        known = np.isfinite(found).all(axis=1)
        kind = np.where(is_measured, np.where(frame.by_hand, EDITED, MEASURED), PREDICTED)
        points.append(in_frame(found[known], i))
        where = np.flatnonzero(known)
        numbers.append(np.column_stack([np.full_like(where, i), where]))
        kinds.append(kind[known])
    number = np.concatenate(numbers)
    return CrossingMarks(np.concatenate(points), number[:, 0], number[:, 1], np.concatenate(kinds))


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
    lines = layout.grid_lines(SEGMENTS_PER_CELL)
    return np.concatenate([line[:-1] for line in lines]), np.concatenate([x[1:] for x in lines])
