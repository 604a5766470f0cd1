"""LR pixels on both sides of the cell borders, by their distance from them.

After registration the borders of the cells are straight lines whose place is known to some
hundredths of a pixel. Every frame crosses them at other places between its pixels, so that all
together they sample the profile of a border far more finely than one pixel (the slanted edge of
ISO 12233).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.parallel import parallel_map
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.photometry.photometry import Photometry, observed
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["REACH_LR_PX", "BorderSamples", "border_samples"]

Array = NDArray[np.float64]

REACH_LR_PX = 5.0
"""Distance from a border up to which pixels are looked at, LR px."""
# Of the length of a cell's side; the rest are corners, which wafers have cut, and other borders.
_INNER = (0.1, 0.9)
# Pieces along a border, LR px: as wide as a busbar that meets it.
_PIECE_LR_PX = 2.0
# Samples of a frame: more are no gain, for what limits the estimate is not noise.
_MAX_SAMPLES = 12000
# Borders on both sides of a wider gap don't fit into one profile, LR px.
_WIDE_GAP_LR_PX = 1.5
# Rows of the sensor that are looked at together, for the memory.
_STRIP = 256


@dataclass(frozen=True, eq=False)
class BorderSamples:
    """Samples of the borders of cells, all (n,).

    Parameters
    ----------
    frame : int64
        Place in the list of frames.
    axis : int64
        0: the border is a line between columns, 1: between rows.
    outer : int64
        -1 or 1 if the module begins or ends at the line, 0 between cells.
    segment, piece : int64
        Side of a cell, and piece of some LR px along it; numbered across the module.
    distance : float64
        From the line, LR px; positive to the right or below.
    value : float64
        Intensity on the module's scale.
    box : float64
        Larger side of the pixel, projected on the distance.
    motion : float64
        Path during the exposure, projected on the distance, LR px.
    scale : float64
        LR px per module unit along the distance.
    """

    frame: NDArray[np.int64]
    axis: NDArray[np.int64]
    outer: NDArray[np.int64]
    segment: NDArray[np.int64]
    piece: NDArray[np.int64]
    distance: Array
    value: Array
    box: Array
    motion: Array
    scale: Array

    def __len__(self) -> int:
        return len(self.distance)

    def still(self, frames: NDArray[np.int64]) -> BorderSamples:
        """Return the samples with no motion in some frames."""
        return replace(self, motion=np.where(np.isin(self.frame, frames), 0.0, self.motion))


def border_samples(
    sequence: FrameSequence,
    registration: Registration,
    frames: NDArray[np.intp],
    photometry: Photometry | None,
    rays: SensorRays,
    motion: Array,
) -> BorderSamples:
    """Gather the pixels near the borders of cells.

    Parameters
    ----------
    sequence : FrameSequence
    registration : Registration
    frames : (n,) int
    photometry : Photometry or None
        The sensor's part.
    rays : SensorRays
    motion : (n_frames, 2) float64
        Of all frames of the sequence.
    """
    scale = registration.lr_px_per_unit

    def samples_of(number: int) -> BorderSamples:
        i = int(frames[number])
        g, weights = observed(sequence, registration, i, photometry)
        to_module = np.linalg.inv(registration.homographies[i])
        seen: list[BorderSamples] = []
        for start in range(0, g.shape[0], _STRIP):
            part = (slice(start, start + _STRIP), slice(None))
            frame = _Frame(number, g[part], weights[part] > 0, rays.cut(part), to_module, motion[i])
            seen += frame.samples(registration.layout, scale)
        return _thinned(_joined(seen))

    return _joined(parallel_map(samples_of, range(len(frames))))


@dataclass(frozen=True, eq=False)
class _Frame:
    """A strip of one frame."""

    number: int
    g: NDArray[np.float32]
    valid: NDArray[np.bool_]
    rays: SensorRays
    to_module: Array
    motion: Array

    def samples(self, layout: ModuleLayout, lr_px_per_unit: float) -> Iterator[BorderSamples]:
        """Pixels near the lines of both axes."""
        homogeneous = self.rays.xy @ self.to_module[:, :2].T + self.to_module[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            at = homogeneous[..., :2] / homogeneous[..., 2:]
        valid = self.valid & (homogeneous[..., 2] > 0)
        widths = (layout.widths, layout.heights)
        lines, wide = (layout.col_lines, layout.row_lines), (layout.col_gaps, layout.row_gaps)
        starts = (layout.col_starts, layout.row_starts)
        most = max(layout.rows, layout.cols) + 2
        for axis in (0, 1):
            if layout.cell_gap[axis] * lr_px_per_unit > _WIDE_GAP_LR_PX:
                continue
            line, other = lines[axis], starts[1 - axis]
            nearest = np.searchsorted((line[1:] + line[:-1]) / 2, at[..., axis])
            near = np.abs(at[..., axis] - line[nearest]) * lr_px_per_unit < 1.5 * REACH_LR_PX
            px = np.nonzero(near & valid)
            # The rest is looked at for these few only.
            nearest, along = nearest[px], at[..., 1 - axis][px]
            cell = np.searchsorted(other, along) - 1
            length = widths[1 - axis][cell]
            inside = (along - other[cell]) / length
            keep = (cell >= 0) & (inside > _INNER[0]) & (inside < _INNER[1])
            for before, _ in wide[axis]:
                keep &= nearest != before
            px = (px[0][keep], px[1][keep])
            nearest, cell, inside, place = nearest[keep], cell[keep], inside[keep], at[px]
            pieces = np.maximum((length[keep] * lr_px_per_unit / _PIECE_LR_PX).astype(np.int64), 1)
            # d module / d pixel of the coordinate across the line.
            M, w = self.to_module, homogeneous[px][:, 2:]
            by_ray = (M[axis, :2] - place[:, axis, None] * M[2, :2]) / w
            gradient = np.einsum("nk,nkl->nl", by_ray, self.rays.per_px[px])
            steepness = np.hypot(gradient[:, 0], gradient[:, 1])
            normal = gradient / steepness[:, None]
            segment = (axis * most + nearest) * most + cell
            piece = np.minimum((inside * pieces).astype(np.int64), pieces - 1)
            yield BorderSamples(
                np.full(len(cell), self.number),
                np.full(len(cell), axis),
                (nearest == len(line) - 1).astype(np.int64) - (nearest == 0),
                segment.astype(np.int64),
                segment * 1000 + np.minimum(piece, 999),
                (place[:, axis] - line[nearest]) / steepness,
                self.g[px].astype(np.float64),
                np.abs(normal).max(axis=1),
                np.abs(normal @ self.motion),
                1.0 / steepness,
            )


def _joined(parts: list[BorderSamples]) -> BorderSamples:
    if not parts:
        none, nothing = np.zeros(0, np.int64), np.zeros(0)
        numbers, lengths = (none, none, none, none, none), (nothing,) * 5
        return BorderSamples(*numbers, *lengths)
    return BorderSamples(
        *(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(BorderSamples))
    )


def _thinned(samples: BorderSamples) -> BorderSamples:
    """Leave out what is too far away, and whole sides of cells if there are too many."""
    keep = np.abs(samples.distance) < REACH_LR_PX
    for axis in (0, 1):
        # Sides at the outline are few and say most.
        inner = keep & (samples.axis == axis) & (samples.outer == 0)
        every = int(np.ceil(2 * inner.sum() / _MAX_SAMPLES))
        if every > 1:
            sides = np.unique(samples.segment[inner])
            rng = np.random.default_rng(int(axis))
            left = sides[rng.permutation(len(sides))[: len(sides) // every + 1]]
            keep &= ~inner | np.isin(samples.segment, left)
        outer = keep & (samples.axis == axis) & (samples.outer != 0)
        every = max(int(np.ceil(2 * outer.sum() / _MAX_SAMPLES)), 1)
        keep &= ~outer | (samples.piece % every == 0)
    return BorderSamples(*(getattr(samples, f.name)[keep] for f in fields(BorderSamples)))
