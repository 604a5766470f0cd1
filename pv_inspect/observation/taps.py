"""The 3 x 3 taps by which an LR pixel samples the blurred HR image."""

from __future__ import annotations

import numpy as np

from pv_inspect.common.compiling import compiled

__all__ = ["TAP_VARIANCE", "fill_taps", "locate"]

# Second moment per axis that is left to the taps on average, HR px^2. Three taps at a position d
# off the middle one are non-negative for moments from |d| - d^2 <= 1/4 up to 1 - d^2.
TAP_VARIANCE = 0.25
# Limits of the taps' second moment: outside, they would sharpen or leave a hole that the blur
# does not fill.
_LOW, _HIGH = -0.15, 2.0


@compiled(inline="always")
def locate(M, ray, per_px, moments, motion, shape, place):  # type: ignore[no-untyped-def]
    """Where one LR pixel lies on the HR grid; False if its footprint leaves the grid.

    ``place`` becomes x, y, the path (x, y) between neighbouring samples along the motion, and the
    second moments (xx, yy, xy) that are left to the taps, all in HR px. ``moments`` are those of
    `ObservationModel.moments`; ``motion`` is (x, y) in LR px and the number of samples.
    """
    u, v = ray[0], ray[1]
    w = M[2, 0] * u + M[2, 1] * v + M[2, 2]
    if not w > 0.0:
        return False
    x = (M[0, 0] * u + M[0, 1] * v + M[0, 2]) / w
    y = (M[1, 0] * u + M[1, 1] * v + M[1, 2]) / w
    a00, a01 = (M[0, 0] - x * M[2, 0]) / w, (M[0, 1] - x * M[2, 1]) / w
    a10, a11 = (M[1, 0] - y * M[2, 0]) / w, (M[1, 1] - y * M[2, 1]) / w
    j00 = a00 * per_px[0, 0] + a01 * per_px[1, 0]
    j01 = a00 * per_px[0, 1] + a01 * per_px[1, 1]
    j10 = a10 * per_px[0, 0] + a11 * per_px[1, 0]
    j11 = a10 * per_px[0, 1] + a11 * per_px[1, 1]
    n = motion[2]
    sx = (j00 * motion[0] + j01 * motion[1]) / n
    sy = (j10 * motion[0] + j11 * motion[1]) / n
    rim_x = moments[3] + 0.5 * (n - 1.0) * abs(sx)
    rim_y = moments[3] + 0.5 * (n - 1.0) * abs(sy)
    if not (rim_x <= x <= shape[1] - 1 - rim_x and rim_y <= y <= shape[0] - 1 - rim_y):
        return False
    vx = moments[0] * (j00 * j00 + j01 * j01) - 1.0 / 12.0 - moments[1] + sx * sx / 12.0
    vy = moments[0] * (j10 * j10 + j11 * j11) - 1.0 / 12.0 - moments[2] + sy * sy / 12.0
    vxy = moments[0] * (j00 * j10 + j01 * j11) + sx * sy / 12.0
    place[0], place[1], place[2], place[3] = x, y, sx, sy
    place[4], place[5] = min(max(vx, _LOW), _HIGH), min(max(vy, _LOW), _HIGH)
    place[6] = min(max(vxy, -_HIGH), _HIGH)
    return True


@compiled(inline="always")
def fill_taps(x, y, vx, vy, vxy, taps):  # type: ignore[no-untyped-def]
    """Nine taps with the mean (x, y) and given second moments; returns the middle (iy, ix).

    With the offset (d_x, d_y) from the middle, ``c = a(d_x, v_x) a(d_y, v_y) + v_xy (t_x t_y) / 4``
    and ``a = ((v + d^2 - d) / 2, 1 - v - d^2, (v + d^2 + d) / 2)``.
    """
    ix, iy = int(np.floor(x + 0.5)), int(np.floor(y + 0.5))
    dx, dy = x - ix, y - iy
    mx, my = vx + dx * dx, vy + dy * dy
    ax0, ax1, ax2 = (mx - dx) / 2, 1 - mx, (mx + dx) / 2
    ay0, ay1, ay2 = (my - dy) / 2, 1 - my, (my + dy) / 2
    c = vxy / 4
    taps[0], taps[1], taps[2] = ay0 * ax0 + c, ay0 * ax1, ay0 * ax2 - c
    taps[3], taps[4], taps[5] = ay1 * ax0, ay1 * ax1, ay1 * ax2
    taps[6], taps[7], taps[8] = ay2 * ax0 - c, ay2 * ax1, ay2 * ax2 + c
    return iy, ix
