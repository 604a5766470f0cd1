"""Compiled kernels of the photometric registration: render the module image, align a frame to it.

Both directions use the same Catmull-Rom interpolation with pixel centres at integers.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.compiling import compiled, read_only

__all__ = ["N_PARAMETERS", "accumulate_frame", "normal_equations"]

N_PARAMETERS = 10
"""Eight of the homography, then gain and offset."""


@compiled(inline="always")
def _cubic(t, weights):  # type: ignore[no-untyped-def]
    """Catmull-Rom weights of the samples at -1, 0, 1, 2 for a place t in [0, 1)."""
    weights[0] = ((-0.5 * t + 1.0) * t - 0.5) * t
    weights[1] = (1.5 * t - 2.5) * t * t + 1.0
    weights[2] = ((-1.5 * t + 2.0) * t + 0.5) * t
    weights[3] = (0.5 * t - 0.5) * t * t


@compiled(inline="always")
def _cubic_slope(t, weights):  # type: ignore[no-untyped-def]
    """Derivatives of `_cubic` with respect to t."""
    weights[0] = (-1.5 * t + 2.0) * t - 0.5
    weights[1] = (4.5 * t - 5.0) * t
    weights[2] = (-4.5 * t + 4.0) * t + 0.5
    weights[3] = (1.5 * t - 1.0) * t


def accumulate_frame(
    total: NDArray[np.float32],
    weight: NDArray[np.float32],
    image: NDArray[np.float32],
    valid: NDArray[np.bool_],
    to_normalised: NDArray[np.float64],
    K: NDArray[np.float64],
    kappa: float,
    gain: float,
    offset: float,
) -> None:
    """Add one frame, warped onto the module grid, to a running sum.

    Parameters
    ----------
    total, weight : (H, W) float32
        Sum of (image - offset) / gain and number of frames per pixel; changed in place.
    image, valid : (height, width)
        The frame; a pixel is used where all of its nearest four samples are valid.
    to_normalised : (3, 3) float64
        HR pixel to normalised image coordinates: H_i times `HrGrid.matrix`.
    K, kappa, gain, offset
        Camera and photometry of the frame.
    """
    numbers = (float(kappa), float(gain), float(offset))
    _add_frame(total, weight, *read_only(image, valid, to_normalised, K), numbers)


@compiled(parallel=True)
def _add_frame(total, weight, image, valid, to_normalised, K, numbers):  # type: ignore[no-untyped-def]
    for row in numba.prange(total.shape[0]):
        # One type for the row: parallel loops also count with unsigned numbers.
        _add_to_row(np.int64(row), total[row], weight[row], image, valid, to_normalised, K, numbers)


@compiled()
def _add_to_row(row, total, weight, image, valid, to_normalised, K, numbers):  # type: ignore[no-untyped-def]
    kappa, gain, offset = numbers
    height, width = image.shape
    limit = np.inf if kappa >= 0 else -1.0 / (3.0 * kappa)
    wx = np.empty(4)
    wy = np.empty(4)
    for col in range(total.shape[0]):
        w = to_normalised[2, 0] * col + to_normalised[2, 1] * row + to_normalised[2, 2]
        if w <= 0:
            continue
        u = (to_normalised[0, 0] * col + to_normalised[0, 1] * row + to_normalised[0, 2]) / w
        v = (to_normalised[1, 0] * col + to_normalised[1, 1] * row + to_normalised[1, 2]) / w
        r2 = u * u + v * v
        if r2 >= limit:
            continue
        stretch = 1.0 + kappa * r2
        x = K[0, 0] * u * stretch + K[0, 1] * v * stretch + K[0, 2]
        y = K[1, 1] * v * stretch + K[1, 2]
        if not (x >= 1.0 and y >= 1.0 and x < width - 2.0 and y < height - 2.0):
            continue
        x0 = int(x)
        y0 = int(y)
        if not (
            valid[y0, x0] and valid[y0, x0 + 1] and valid[y0 + 1, x0] and valid[y0 + 1, x0 + 1]
        ):
            continue
        _cubic(x - x0, wx)
        _cubic(y - y0, wy)
        value = 0.0
        for j in range(4):
            line = 0.0
            for i in range(4):
                line += wx[i] * image[y0 - 1 + j, x0 - 1 + i]
            value += wy[j] * line
        total[col] += (value - offset) / gain
        weight[col] += 1.0


def normal_equations(
    image: NDArray[np.float32],
    precision: NDArray[np.float32],
    rays: NDArray[np.float64],
    module: NDArray[np.float32],
    covered: NDArray[np.bool_],
    to_grid: NDArray[np.float64],
    size: float,
    gain: float,
    offset: float,
    huber: float,
    stride: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64], float, float]:
    """Gauss-Newton equations of Eq. 6 for one frame, robustly weighted.

    Parameters
    ----------
    image : (height, width) float32
        The frame g_i.
    precision : (height, width) float32
        1 / variance of the noise, 0 where a pixel must not be used.
    rays : (height, width, 2) float64
        Undistorted normalised coordinates of the LR pixels.
    module : (H, W) float32
        Module image f.
    covered : (H, W) bool
        Where f is known.
    to_grid : (3, 3) float64
        Normalised image coordinates to HR pixels.
    size : float
        Length by which centred HR coordinates are divided so that all parameters are of one
        order.
    gain, offset : float
        Present photometry, g_i = gain * tau(f) + offset.
    huber : float
        Residuals above this many standard deviations count linearly.
    stride : int
        Use every stride-th pixel in x and y.

    Returns
    -------
    A : (10, 10) float64
        J^T W J.
    b : (10,) float64
        J^T W r.
    chi2 : float
        Weighted sum of squared residuals.
    count : float
        Number of pixels used.

    Notes
    -----
    The increment acts in the module plane: z -> (I + D) z with
    D = [[p0, p1, p2], [p3, p4, p5], [p6, p7, 0]] on centred, scaled HR coordinates z.
    """
    rows = -(-image.shape[0] // stride)
    A = np.zeros((rows, N_PARAMETERS, N_PARAMETERS))
    b = np.zeros((rows, N_PARAMETERS))
    sums = np.zeros((rows, 2))
    arrays = (image, precision, rays, module, covered, to_grid)
    _add_rows(*read_only(*arrays), (size, gain, offset, huber), stride, A, b, sums)
    chi2, count = sums.sum(axis=0)
    return A.sum(axis=0), b.sum(axis=0), float(chi2), float(count)


@compiled(parallel=True)
def _add_rows(  # type: ignore[no-untyped-def]
    image, precision, rays, module, covered, to_grid, numbers, stride, A, b, sums
):
    for k in numba.prange(A.shape[0]):
        row = k * stride
        _add_row(
            image[row], precision[row], rays[row], module, covered, to_grid, numbers, stride,
            A[k], b[k], sums[k]
        )  # fmt: skip


@compiled()
def _add_row(  # type: ignore[no-untyped-def]
    image, precision, rays, module, covered, to_grid, numbers, stride, A, b, sums
):
    size, gain, offset, huber = numbers
    width = image.shape[0]
    H, W = module.shape
    centre_x = 0.5 * (W - 1)
    centre_y = 0.5 * (H - 1)
    n = N_PARAMETERS
    wx = np.empty(4)
    wy = np.empty(4)
    sx = np.empty(4)
    sy = np.empty(4)
    # The Jacobian and its weighted copy; one matrix product per image row is far faster than
    # adding every pixel's outer product.
    columns = (width + stride - 1) // stride
    J = np.empty((columns, n))
    weighted = np.empty((columns, n))
    residual = np.empty(columns)
    m = 0
    for col in range(0, width, stride):
        p = precision[col]
        if p <= 0:
            continue
        u = rays[col, 0]
        v = rays[col, 1]
        w = to_grid[2, 0] * u + to_grid[2, 1] * v + to_grid[2, 2]
        if not w > 0:
            continue
        x = (to_grid[0, 0] * u + to_grid[0, 1] * v + to_grid[0, 2]) / w
        y = (to_grid[1, 0] * u + to_grid[1, 1] * v + to_grid[1, 2]) / w
        if not (x >= 1.0 and y >= 1.0 and x < W - 2.0 and y < H - 2.0):
            continue
        x0 = int(x)
        y0 = int(y)
        if not (covered[y0, x0] and covered[y0 + 1, x0 + 1]):
            continue
        _cubic(x - x0, wx)
        _cubic(y - y0, wy)
        _cubic_slope(x - x0, sx)
        _cubic_slope(y - y0, sy)
        f = 0.0
        fx = 0.0
        fy = 0.0
        for j in range(4):
            line = 0.0
            slope = 0.0
            for i in range(4):
                value = module[y0 - 1 + j, x0 - 1 + i]
                line += wx[i] * value
                slope += sx[i] * value
            f += wy[j] * line
            fx += wy[j] * slope
            fy += sy[j] * line
        r = image[col] - (gain * f + offset)
        normalised = abs(r) * np.sqrt(p)
        if normalised > huber:
            p *= huber / normalised
        zx = (x - centre_x) / size
        zy = (y - centre_y) / size
        gx = gain * fx * size
        gy = gain * fy * size
        along = -(gx * zx + gy * zy)
        J[m, 0] = gx * zx
        J[m, 1] = gx * zy
        J[m, 2] = gx
        J[m, 3] = gy * zx
        J[m, 4] = gy * zy
        J[m, 5] = gy
        J[m, 6] = along * zx
        J[m, 7] = along * zy
        J[m, 8] = f
        J[m, 9] = 1.0
        for a in range(n):
            weighted[m, a] = p * J[m, a]
        residual[m] = r
        sums[0] += p * r * r
        m += 1
    sums[1] = m
    if m > 0:
        np.dot(weighted[:m].T, J[:m], A)
        np.dot(weighted[:m].T, residual[:m], b)
