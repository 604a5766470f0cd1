"""Where the module of one frame lies in another frame that shows only a part of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.detection.outline import OutlineError
from pv_inspect.geometry.pose import Pose

__all__ = ["found_beside", "nearest", "poses_in_other_frame"]

Array = NDArray[np.float64]
Image = NDArray[np.float32]
T = TypeVar("T")

NEIGHBOURS = 3
"""Frames in which the module was found that are compared with one in which it was not."""
REDUCED_SIDE_PX = 320
"""Frames are compared with about so many pixels on their shorter side."""
FINE_BAND_PX, COARSE_BAND_PX = (1.0, 8.0), (2.5, 12.0)
"""What is compared is neither finer nor coarser, reduced pixels: cells look alike in the large. The
coarse band stands a rotation by some degrees, the fine one tells the place exactly."""
PEAKS = 8
"""Shifts that are tried: between the cells of a grid there are as many good ones as cells."""
APART_PX = 9
LEAST_OVERLAP = 0.15
LEAST_CORRELATION, CLEAR_CORRELATION = 0.3, 0.6
"""Of the two frames where they overlap, after the fit: with less a place is not tried, with more
it is tried before others are looked at."""
ROUNDS, CONVERGED = 60, 1e-4


def nearest(found: Iterable[int], index: int) -> list[int]:
    """Return the frames in which the module was found that are compared with another frame."""
    return sorted(found, key=lambda other: abs(other - index))[:NEIGHBOURS]


def found_beside(
    image: Image, others: Iterable[tuple[Image, Pose]], look: Callable[[Pose], T]
) -> T:
    """Find the module in a frame that shows a part of it, from frames in which it was found.

    Parameters
    ----------
    image : (height, width) float32
    others : iterable of ((height, width) float32, Pose)
        Frames, and the pose of the module in each, the likeliest first.
    look : callable
        Finds the module from a pose that is right to a few pixels; raises OutlineError else.

    Returns
    -------
    T
        What `look` found first.

    Raises
    ------
    OutlineError
        If it found nothing.
    """
    reason: OutlineError | None = None
    for reference, pose in others:
        try:
            for start in poses_in_other_frame(reference, image, pose):
                try:
                    return look(start)
                except OutlineError as error:
                    reason = reason or error
        except OutlineError as error:
            reason = reason or error
    raise reason or OutlineError("no other frame shows the module")


def poses_in_other_frame(reference: Image, image: Image, pose: Pose) -> Iterator[Pose]:
    """Find the pose of a module in a frame from its pose in another frame of the same module.

    Shifts come from the cross-correlation of both frames, which may overlap in part. Around each
    an affine map and then a homography are fitted by the enhanced correlation coefficient
    (Evangelidis and Psarakis 2008).

    Parameters
    ----------
    reference : (height, width) float32
        Frame in which the module was found.
    image : (height, width) float32
        Frame of the same size.
    pose : Pose
        Of the module in the reference.

    Yields
    ------
    Pose
        Right to a few pixels; the one of the best agreement first.

    Raises
    ------
    OutlineError
        If the frames do not look alike anywhere.
    """
    scale = min(1.0, REDUCED_SIDE_PX / min(image.shape))
    pair = _Pair(*(_details(frame, scale) for frame in (reference, image)))
    # Pixel centres are whole numbers in both sizes.
    reduce = np.array([[scale, 0, (scale - 1) / 2], [0, scale, (scale - 1) / 2], [0, 0, 1]])
    best = 0.0
    less_clear: list[tuple[float, Array]] = []
    for shift in _shifts(pair):
        correlation, matrix = _fitted(pair, shift)
        best = max(best, correlation)
        if correlation >= CLEAR_CORRELATION:
            yield _carried(pose, np.linalg.inv(reduce) @ matrix @ reduce, image.shape)
        elif correlation >= LEAST_CORRELATION:
            less_clear.append((correlation, matrix))
    if best < LEAST_CORRELATION:
        raise OutlineError(f"it does not look like its neighbours (correlation {best:.2f})")
    for _, matrix in sorted(less_clear, key=lambda fit: -fit[0]):
        yield _carried(pose, np.linalg.inv(reduce) @ matrix @ reduce, image.shape)


class _Pair(NamedTuple):
    """Coarse and fine details of both frames."""

    first: tuple[Image, Image]
    second: tuple[Image, Image]


def _details(frame: Image, scale: float) -> tuple[Image, Image]:
    """Reduce a frame and keep what tells places apart, in units of its usual contrast."""
    smooth = cv2.GaussianBlur(frame, (0, 0), 0.5 / scale) if scale < 1 else frame
    size = (round(frame.shape[1] * scale), round(frame.shape[0] * scale))
    small = cv2.resize(smooth, size, interpolation=cv2.INTER_AREA)
    grey = np.asarray(small, np.float32)
    coarse, fine = (_band(grey, *limits) for limits in (COARSE_BAND_PX, FINE_BAND_PX))
    return coarse, fine


def _band(small: Image, finest: float, coarsest: float) -> Image:
    band = cv2.GaussianBlur(small, (0, 0), finest) - cv2.GaussianBlur(small, (0, 0), coarsest)
    spread = cv2.GaussianBlur(band * band, (0, 0), coarsest)
    limit = np.sqrt(np.percentile(spread, 90)) + 1e-9
    return np.asarray(np.clip(band / limit, -2, 2), np.float32)


def _shifts(pair: _Pair) -> list[tuple[float, float]]:
    """Shifts (x, y) by which details of the first frame are found in the second, best first."""
    first, second = pair.first[0], pair.second[0]
    height, width = first.shape
    shape = (2 * height, 2 * width)
    spectrum = np.conj(np.fft.rfft2(first, shape)) * np.fft.rfft2(second, shape)
    correlation = np.fft.fftshift(np.fft.irfft2(spectrum, shape))
    y, x = np.mgrid[-height:height, -width:width]
    overlap = np.clip(height - np.abs(y), 0, None) * np.clip(width - np.abs(x), 0, None)
    overlap = overlap / (height * width)
    # Small overlaps agree by chance more easily.
    score = np.where(overlap >= LEAST_OVERLAP, correlation / np.sqrt(np.maximum(overlap, 0.01)), 0)
    found = []
    for _ in range(PEAKS):
        row, col = np.unravel_index(int(score.argmax()), score.shape)
        found.append((float(x[row, col]), float(y[row, col])))
        top, left = max(row - APART_PX, 0), max(col - APART_PX, 0)
        score[top : row + APART_PX + 1, left : col + APART_PX + 1] = 0
    return found


def _fitted(pair: _Pair, shift: tuple[float, float]) -> tuple[float, Array]:
    """Correlation after the fit, and the homography from the first frame to the second."""
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, ROUNDS, CONVERGED)
    affine = np.array([[1, 0, shift[0]], [0, 1, shift[1]]], np.float32)
    everywhere = np.full(pair.first[0].shape, 255, np.uint8)
    try:
        _, affine = cv2.findTransformECC(  # type: ignore[assignment]
            pair.first[0], pair.second[0], affine, cv2.MOTION_AFFINE, criteria, everywhere, 3
        )
        full = np.vstack([affine, [0, 0, 1]]).astype(np.float32)
        value, full = cv2.findTransformECC(  # type: ignore[assignment]
            pair.first[1], pair.second[1], full, cv2.MOTION_HOMOGRAPHY, criteria, everywhere, 1
        )
    except cv2.error:  # it does not converge
        return 0.0, np.eye(3)
    return float(value), np.asarray(full, np.float64)


def _carried(pose: Pose, to_other: Array, shape: tuple[int, ...]) -> Pose:
    """Pose of the module in the other frame, under the same camera."""
    height, width = shape
    places = np.stack(np.meshgrid([0.2, 0.5, 0.8], [0.2, 0.5, 0.8]), axis=-1).reshape(-1, 2)
    there = places * [width - 1, height - 1]
    homogeneous = np.column_stack([there, np.ones(len(there))]) @ np.linalg.inv(to_other).T
    module = pose.unproject(homogeneous[:, :2] / homogeneous[:, 2:])
    rays = pose.camera.undistort(pose.camera.to_normalised(there))
    known = np.isfinite(module).all(axis=1) & np.isfinite(rays).all(axis=1)
    matrix = cv2.findHomography(module[known], rays[known], 0)[0] if known.sum() >= 4 else None
    if matrix is None:
        raise OutlineError("where its part of the module lies can't be told")
    return Pose(pose.camera, np.asarray(matrix, np.float64))
