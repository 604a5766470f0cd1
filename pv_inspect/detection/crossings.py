"""Crossing points: the record of what was measured, and how gaps become crossings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.robust import MAD_TO_SIGMA
from pv_inspect.detection.edges import CellEdges, EdgeOffsets
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose

__all__ = ["Crossings", "FrameCrossings", "crossings_of"]

Array = NDArray[np.float64]

HAND_SIGMA_PX = 0.3
"""Of a point set by hand in a frame without any other."""
MIN_ON_SIDE = 3
"""So many outer edges say where the others of their side are."""


@dataclass(frozen=True)
class FrameCrossings:
    """Crossing points of one frame.

    Parameters
    ----------
    points_px : (n_crossings, 2) float64
        (x, y) in LR pixels, row-major; NaN where unknown. May lie outside of the frame.
    sigma_px : (n_crossings,) float64
        Standard deviation of a coordinate.
    measured : (n_crossings,) bool
        Whether both coordinates come from visible gaps; otherwise the point is predicted.
    why : str
        Empty, or the reason why the frame failed.
    edited : (n_crossings,) bool or None
        Which points a person has set, so that no fit takes them for outliers, or, where they are
        not measured, has removed. None: none.
    """

    points_px: Array
    sigma_px: Array
    measured: NDArray[np.bool_]
    why: str = ""
    edited: NDArray[np.bool_] | None = None

    @property
    def by_hand(self) -> NDArray[np.bool_]:
        """``edited`` as an array: (n_crossings,) bool."""
        return np.zeros(len(self.measured), bool) if self.edited is None else self.edited

    def with_edits(self, edits: Mapping[int, tuple[float, float] | None]) -> FrameCrossings:
        """Return the points as a person wants them.

        Parameters
        ----------
        edits : mapping of crossing number to (x, y) or None
            LR px; None removes the point: its crossing counts as not measured. A point that was
            set is as sure as the usual measured one of the frame.
        """
        points, sigma, measured = self.points_px.copy(), self.sigma_px.copy(), self.measured.copy()
        edited = self.by_hand.copy()
        sure = self.measured & np.isfinite(self.sigma_px)
        usual = float(np.median(self.sigma_px[sure])) if sure.any() else HAND_SIGMA_PX
        for k, point in edits.items():
            edited[k], measured[k] = True, point is not None
            if point is not None:
                points[k], sigma[k] = point, usual
        # A frame that was given up gets another chance; the calibration counts its points.
        return FrameCrossings(points, sigma, measured, edited=edited)

    @classmethod
    def failed(cls, layout: ModuleLayout, why: str) -> FrameCrossings:
        """Return the record of a frame in which nothing was found."""
        n = layout.n_crossings
        return cls(np.full((n, 2), np.nan), np.full(n, np.inf), np.zeros(n, bool), why)

    def turned(self, layout: ModuleLayout, quarter_turns: int) -> FrameCrossings:
        """Return the same points for a module turned as by `Pose.turned` of the same size."""
        index = np.arange(layout.n_crossings).reshape(layout.rows + 1, layout.cols + 1)
        order = np.rot90(index, quarter_turns).ravel()
        return replace(
            self,
            points_px=self.points_px[order],
            sigma_px=self.sigma_px[order],
            measured=self.measured[order],
            edited=None if self.edited is None else self.edited[order],
        )


@dataclass(frozen=True)
class Crossings:
    """Crossing points of all frames of a sequence, in the order of the frames."""

    layout: ModuleLayout
    frames: tuple[FrameCrossings, ...]


def crossings_of(
    layout: ModuleLayout, edges: CellEdges, offsets: EdgeOffsets, pose: Pose
) -> FrameCrossings:
    """Combine the gaps that meet at a crossing; what they do not measure is predicted."""
    ideal = layout.crossings()
    total = np.zeros((layout.n_crossings, 2))
    weight = np.zeros((layout.n_crossings, 2))
    spread = (
        MAD_TO_SIGMA * np.median(np.abs(offsets.offset[offsets.found]))
        if offsets.found.any()
        else 1
    )
    use = offsets.found & (np.abs(offsets.offset) < 5 * max(spread, 1e-3))
    precision = np.where(use, 1.0 / np.hypot(offsets.sigma, spread) ** 2, 0.0)
    axis = np.argmax(np.abs(edges.normal), axis=1)
    for end in range(2):
        np.add.at(weight, (edges.crossings[:, end], axis), precision)
        np.add.at(
            total, (edges.crossings[:, end], axis), precision * np.where(use, offsets.offset, 0)
        )
    known = weight > 0
    shift = np.divide(total, weight, out=_side_shifts(layout, edges, offsets, use), where=known)
    points = pose.project(ideal + shift)
    with np.errstate(invalid="ignore"):  # NaN beyond the fold of the lens
        scale = np.sqrt(np.abs(np.linalg.det(pose.camera.jacobian(pose.homography, ideal))))
    variance = np.divide(1.0, weight, out=np.full_like(weight, (4 * spread) ** 2), where=known)
    measured = known.all(axis=1) & np.isfinite(points).all(axis=1)
    sigma = np.where(np.isfinite(scale), scale, np.inf) * np.sqrt(variance.mean(axis=1))
    return FrameCrossings(points, np.maximum(sigma, 0.01), np.asarray(measured))


def _side_shifts(
    layout: ModuleLayout, edges: CellEdges, offsets: EdgeOffsets, use: NDArray[np.bool_]
) -> Array:
    """How far each side of the module lies off the pose, for its crossings: (n_crossings, 2).

    The outer cells may end elsewhere than the pitch of the others says, all along a side.
    """
    shift = np.zeros((layout.n_crossings, 2))
    for axis in range(2):
        for side in (1, -1):
            on_it = ~edges.inner & (edges.normal[:, axis] == 1) & (edges.side == side)
            if (on_it & use).sum() >= MIN_ON_SIDE:
                shift[edges.crossings[on_it], axis] = np.median(offsets.offset[on_it & use])
    return shift
