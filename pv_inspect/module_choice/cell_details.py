"""What tells the cells of a module apart, as one frame shows it: the basis of comparing frames."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.calibration.calibrate import Calibration
from pv_inspect.common.robust import MAD_TO_SIGMA
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["CellDetails", "cell_details", "degrees_of_freedom", "noise_spectrum"]

Array = NDArray[np.float64]

INNER = (0.12, 0.88)
"""Part of a cell that is looked at, so that an error of the pose brings in no gap."""
MOST_SAMPLES = 8
"""Along the side of a cell; more would ask for poses better than those of the crossing points."""
LEAST_PITCH_PX = 3.0
"""Between samples: the poses are good to a few tenths of a pixel."""
BLUR_PER_PITCH = 0.5
"""Gaussian before sampling, in units of the distance of the samples."""
LIMIT = 3.0
"""Robust standard deviations at which a value is cut: no dark cell decides alone."""
LEAST_LINE = 4
"""Cells in a line from which on what the line has in common is taken out too."""


@dataclass(frozen=True, eq=False)
class CellDetails:
    """Brightness inside of the cells of one frame, relative to what all modules have in common.

    Parameters
    ----------
    values : (rows, cols, ny, nx) float64
        Share of the mean brightness, less what the cells of a row and of a column have in common;
        0 in cells that the frame does not show.
    seen : (rows, cols) bool
        Cells that are wholly in view and not saturated.
    noise : (rows, cols) float64
        Variance of the camera's noise in a value of the cell.
    """

    values: Array
    seen: NDArray[np.bool_]
    noise: Array

    def turned(self, quarter_turns: int) -> CellDetails:
        """Return the same for a module turned as by `Pose.turned` of the same size."""
        values = np.rot90(np.rot90(self.values, quarter_turns, (0, 1)), quarter_turns, (2, 3))
        return CellDetails(
            values, np.rot90(self.seen, quarter_turns), np.rot90(self.noise, quarter_turns)
        )

    def shifted(self, rows: int, cols: int) -> CellDetails:
        """Return the same with every cell so many rows and columns further; others are not seen."""
        height, width = self.seen.shape
        to = (_lines(height, rows), _lines(width, cols))
        start = (_lines(height, -rows), _lines(width, -cols))
        moved = CellDetails(
            np.zeros_like(self.values), np.zeros_like(self.seen), np.zeros_like(self.noise)
        )
        moved.values[to], moved.seen[to], moved.noise[to] = (
            part[start] for part in (self.values, self.seen, self.noise)
        )
        return moved


def cell_details(
    sequence: FrameSequence, calibration: Calibration, frames: list[int]
) -> list[CellDetails]:
    """Sample the cells of frames, and take out what says nothing about the module.

    Gaps, busbars and the slow fall of the light look alike on every module in front of the same
    camera. They are in the mean of a row of cells and the mean of a column of cells.

    Parameters
    ----------
    sequence : FrameSequence
    calibration : Calibration
        Poses of these frames.
    frames : list of int

    Returns
    -------
    list of CellDetails
    """
    layout = calibration.layout
    scales = [_scale_px(calibration, i) for i in frames]
    usual = float(np.median(scales))
    points = _points(layout, _samples(usual / layout.cell_aspect), _samples(usual))
    return [_details_of(sequence, calibration, i, points) for i in frames]


def _details_of(
    sequence: FrameSequence, calibration: Calibration, index: int, points: Array
) -> CellDetails:
    frame = sequence.frame(index)
    rows, ny, cols, nx, _ = points.shape
    pitch = (INNER[1] - INNER[0]) * _scale_px(calibration, index) / nx
    blur = BLUR_PER_PITCH * max(LEAST_PITCH_PX, pitch)
    image, weight = _smoothed(frame.image, frame.valid, blur)
    homography = calibration.homographies[index]
    pixels = calibration.camera.project(homography, points).astype(np.float32)
    shape = (rows, cols, ny, nx)
    values, support = (_sampled(a, pixels) for a in (image, weight))
    seen = np.asarray((support > 0.5).all(axis=(2, 3)))
    if not seen.any():
        return CellDetails(np.zeros(shape), seen, np.zeros(shape[:2]))
    mean = max(float(np.median(values[seen])), 1e-6)
    added = frame.added_variance
    more = None if added is None else _sampled(added, pixels).mean(axis=(2, 3))
    sigma = sequence.noise.sigma(values.mean(axis=(2, 3)), more)
    # White noise after a Gaussian: sigma^2 / (4 pi s^2).
    noise = np.where(seen, np.square(sigma / mean) / (4 * np.pi * blur**2), 0.0)
    # Medians first: dark cells would move the mean of all others.
    details = _peculiar(values / mean - 1.0, seen, robust=True)
    limit = LIMIT * MAD_TO_SIGMA * float(np.median(np.abs(details[seen])))
    details = _peculiar(np.clip(details, -limit, limit), seen)
    return CellDetails(details, seen, noise)


def _lines(n: int, by: int) -> slice:
    """Which of n lines have something in them after they were moved."""
    return slice(max(by, 0), n + min(by, 0))


def degrees_of_freedom(rows: int, cols: int) -> int:
    """Return the number of independent cells that are left when lines have lost their mean."""
    across, along = (n - 1 if n >= LEAST_LINE else n for n in (rows, cols))
    return across * along if across < rows or along < cols else rows * cols - 1


def noise_spectrum(ny: int, nx: int) -> Array:
    """Return how the smoothing spreads the noise over the DCT of a cell: (ny, nx), mean 1."""
    sigma = BLUR_PER_PITCH
    y, x = (np.exp(-np.square(np.pi * np.arange(n) * sigma / n)) for n in (ny, nx))
    return np.asarray(np.outer(y / y.mean(), x / x.mean()))


def _samples(cell_px: float) -> int:
    inner = (INNER[1] - INNER[0]) * cell_px
    return int(np.clip(inner / LEAST_PITCH_PX, 2, MOST_SAMPLES))


def _points(layout: ModuleLayout, ny: int, nx: int) -> Array:
    """Module points (rows, ny, cols, nx, 2) of all samples."""

    def inside(n: int) -> Array:
        return np.asarray(INNER[0] + (INNER[1] - INNER[0]) * (np.arange(n) + 0.5) / n)

    x, y = np.meshgrid(*layout.places_in_cells(inside(nx), inside(ny)))
    return np.stack([x, y], axis=-1).reshape(layout.rows, ny, layout.cols, nx, 2)


def _smoothed(
    image: NDArray[np.float32], valid: NDArray[np.bool_], sigma: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Local mean of the valid pixels, and the share of them."""
    weight = cv2.GaussianBlur(valid.astype(np.float32), (0, 0), sigma)
    total = cv2.GaussianBlur(np.where(valid, image, np.float32(0)), (0, 0), sigma)
    return np.asarray(total / np.maximum(weight, 1e-6), np.float32), np.asarray(weight, np.float32)


def _sampled(image: NDArray[np.float32], pixels: NDArray[np.float32]) -> Array:
    """Bilinear values at (rows, ny, cols, nx, 2) pixels as (rows, cols, ny, nx); 0 outside."""
    rows, ny, cols, nx, _ = pixels.shape
    places = np.nan_to_num(pixels, nan=-1e4).reshape(rows * ny, cols * nx, 2)
    x, y = np.ascontiguousarray(places[..., 0]), np.ascontiguousarray(places[..., 1])
    found = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    return np.asarray(found, np.float64).reshape(rows, ny, cols, nx).transpose(0, 2, 1, 3)


def _peculiar(values: Array, seen: NDArray[np.bool_], *, robust: bool = False) -> Array:
    """Take out the mean (or median) cell of every row and of every column, or of all."""
    axes = [axis for axis, line in enumerate(seen.shape) if line >= LEAST_LINE]
    values = np.where(seen[..., None, None], values, np.nan)
    # Means of whole lines are exact in one round.
    for _ in range(1 if seen.all() and not robust else 4):
        values = values - _middle(values, (0, 1), robust)
        for axis in axes:
            values = values - _middle(values, (axis,), robust)
    return np.nan_to_num(values)


def _middle(values: Array, axes: tuple[int, ...], robust: bool) -> Array:
    """Mean or median of what is not NaN; 0 in lines without any."""
    known = np.isfinite(values).any(axis=axes, keepdims=True)
    filled = np.where(known, values, 0.0)
    middle = np.nanmedian if robust else np.nanmean
    return np.asarray(middle(filled, axis=axes, keepdims=True))


def _scale_px(calibration: Calibration, index: int) -> float:
    return Pose(calibration.camera, calibration.homographies[index]).scale_px(
        calibration.layout.size
    )
