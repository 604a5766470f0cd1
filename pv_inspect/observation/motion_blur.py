"""Linear motion blur: what one frame sees while the shutter is open.

A frame that moved has its own S_i: the mean over samples along a straight path through the pose.
It can't enter the shared stencil, whose reach is 5 x 5 HR pixels; it is kept as positions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.compiling import compiled, read_only
from pv_inspect.observation.taps import fill_taps, locate

__all__ = ["STILL", "MovingFrame", "detail_left", "length_and_angle", "motion_of", "samples_of"]

Array = NDArray[np.float64]
Image = NDArray[np.floating]

STILL = np.zeros(2)
"""Motion of a frame that did not move."""
STILL.setflags(write=False)

# A sample stands for so long a piece of the path, whose variance its taps still carry, and no
# longer than this in LR px: further apart, the samples would show as ripple.
_STEP_HR_PX, _STEP_LR_PX = 4.6, 1.15
# LR rows that one thread works through; the bands between are another phase. Motions must stay
# shorter.
_BAND_ROWS = 16


def motion_of(length_px: float, angle_deg: float) -> Array:
    """Path (x, y) of the image on the sensor during the exposure, (2,), LR px."""
    angle = np.deg2rad(angle_deg)
    return length_px * np.array([np.cos(angle), np.sin(angle)])


def length_and_angle(motion: Array) -> tuple[float, float]:
    """Length [LR px] and angle [deg, 0..180, from x to y] of a motion; 0, 0 for a still frame."""
    x, y = float(motion[0]), float(motion[1])
    return float(np.hypot(x, y)), float(np.rad2deg(np.arctan2(y, x)) % 180.0)


def detail_left(motions: Array) -> float:
    """Return the share of detail at 0.5 cycles / LR px that motions, (n, 2) LR px, leave.

    The mean of the squared transfer function ``sinc(f . m)^2`` over directions and frames: 1 if
    all frames are still.
    """
    angles = np.linspace(0.0, np.pi, 24, endpoint=False)
    f = 0.5 * np.column_stack([np.cos(angles), np.sin(angles)])
    return float((np.sinc(motions @ f.T) ** 2).mean())


def samples_of(motion: Array, magnification: float) -> int:
    """Return how many samples along a motion [LR px] are needed at HR px per LR px."""
    step = min(_STEP_HR_PX / magnification, _STEP_LR_PX)
    return max(int(np.ceil(float(np.hypot(motion[0], motion[1])) / step)), 1)


@dataclass(frozen=True, eq=False)
class MovingFrame:
    """S_i of a frame with motion blur: mean over ``count`` samples along the path.

    Parameters
    ----------
    pixels : (n,) int64
        LR pixels (row * width + col) whose footprint lies on the HR grid.
    places : (n, 7) float32 or float64
        See `pv_inspect.observation.taps.locate`.
    bands : (n_bands + 1,) int64
        Where the pixels of the bands of LR rows begin.
    count : int
        Samples per LR pixel.

    Notes
    -----
    ``g_l = (1/K) sum_k sum_t c_{l,k,t} (B f)[p_{l,k} + t]``, p_{l,k} = m_i^-1(x_l) + (k - (K-1)/2)
    s_l with the path s_l between samples, to first order in the motion. Each sample stands for a
    box of the length |s_l|: its second moment s_l s_l' / 12 is part of that of the taps.
    """

    pixels: NDArray[np.int64]
    places: Image
    bands: NDArray[np.int64]
    count: int

    @classmethod
    def build(
        cls,
        to_hr: Array,
        rays: Array,
        per_px: Array,
        moments: Array,
        motion: Array,
        count: int,
        shape: tuple[int, int],
        wanted: NDArray[np.bool_] | None = None,
        dtype: np.dtype[np.floating] | type[np.floating] = np.float64,
    ) -> MovingFrame:
        """Place the LR pixels of a frame on an HR grid of a shape (height, width).

        Parameters
        ----------
        to_hr : (3, 3) float64
            Rays to HR pixels.
        rays, per_px : (height, width, 2) and (height, width, 2, 2) float64
            See `pv_inspect.geometry.rays.SensorRays`.
        moments : (4,) float64
            See `pv_inspect.observation.model.ObservationModel.moments`.
        motion : (2,) float64
            See `motion_of`.
        count : int
        shape : tuple of int
        wanted : (height, width) bool, optional
            LR pixels that are needed; all if not given.
        dtype : dtype
            Of the places.
        """
        if wanted is None:
            wanted = np.ones(rays.shape[:2], bool)
        path = np.append(motion, float(count))
        inputs = read_only(to_hr, rays, per_px, moments, path)
        ends = np.zeros(rays.shape[0] + 1, np.int64)
        pixels, places = np.empty(0, np.int64), np.empty((0, 7), dtype)
        _place_rows(*inputs, shape, wanted, ends, pixels, places)
        ends = np.cumsum(ends)
        if ends[-1]:
            pixels, places = np.empty(ends[-1], np.int64), np.empty((ends[-1], 7), dtype)
            _place_rows(*inputs, shape, wanted, ends, pixels, places)
        bands = np.append(ends[:-1:_BAND_ROWS], ends[-1])
        return cls(pixels, places, bands, count)

    def sample(self, blurred: Image) -> Image:
        """S_i of a blurred HR image: (n,) values of the pixels."""
        out = np.empty(len(self.pixels), blurred.dtype)
        _sample(self.places, self.count, blurred, out)
        return out

    def scatter(self, values: Image, out: Image) -> None:
        """Add S_i' of (n,) values to an HR image."""
        _scatter(self.places, self.bands, self.count, values, out)

    def add_normal(self, weights: Image, blurred: Image, out: Image) -> None:
        """Add ``S_i' diag(weights) S_i`` of a blurred HR image to another."""
        _normal(
            self.places,
            self.bands,
            self.count,
            weights,
            blurred.reshape(-1),
            blurred.shape[1],
            out.reshape(-1),
        )


@compiled(parallel=True)
def _place_rows(  # type: ignore[no-untyped-def]
    M, rays, per_px, moments, motion, shape, wanted, ends, pixels, places
):
    """Pixels and places of the rows, which begin at the ``ends`` of those before.

    Without room for places the pixels are only counted, into ``ends``.
    """
    count_only = places.shape[0] == 0
    for row in numba.prange(rays.shape[0]):
        place = np.empty(7)
        at = 0 if count_only else ends[row]
        for col in range(rays.shape[1]):
            if wanted[row, col] and locate(
                M, rays[row, col], per_px[row, col], moments, motion, shape, place
            ):
                if not count_only:
                    pixels[at] = row * rays.shape[1] + col
                    for k in range(7):
                        places[at, k] = place[k]
                at += 1
        if count_only:
            ends[row + 1] = at


@compiled(parallel=True, fastmath={"contract", "reassoc"})
def _sample(places, count, f, out):  # type: ignore[no-untyped-def]
    n = places.shape[0]
    chunk = 4096
    for part in numba.prange((n + chunk - 1) // chunk):
        taps = np.empty(9, f.dtype)
        for p in range(part * chunk, min(n, (part + 1) * chunk)):
            q = places[p]
            s = f.dtype.type(0)
            for k in range(count):
                t = np.float32(k - 0.5 * (count - 1))
                iy, ix = fill_taps(q[0] + t * q[2], q[1] + t * q[3], q[4], q[5], q[6], taps)
                for a in range(3):
                    line = f[iy + a - 1]
                    for b in range(3):
                        s += taps[3 * a + b] * line[ix + b - 1]
            out[p] = s / count


@compiled(parallel=True, fastmath={"contract", "reassoc"})
def _scatter(places, bands, count, values, out):  # type: ignore[no-untyped-def]
    """Bands of one phase lie a band apart, so that their taps never meet."""
    n_bands = len(bands) - 1
    for phase in range(2):
        for half in numba.prange((n_bands - phase + 1) // 2):
            band = 2 * half + phase
            taps = np.empty(9, out.dtype)
            for p in range(bands[band], bands[band + 1]):
                q = places[p]
                value = out.dtype.type(values[p]) / count
                for k in range(count):
                    t = np.float32(k - 0.5 * (count - 1))
                    iy, ix = fill_taps(q[0] + t * q[2], q[1] + t * q[3], q[4], q[5], q[6], taps)
                    for a in range(3):
                        line = out[iy + a - 1]
                        for b in range(3):
                            line[ix + b - 1] += value * taps[3 * a + b]


@compiled(parallel=True, fastmath={"contract", "reassoc"})
def _normal(places, bands, count, weights, f, width, out):  # type: ignore[no-untyped-def]
    """As `_sample` and `_scatter`, with the taps made once; f and out are flat.

    This is where a reconstruction with motion blur spends its time: the taps are kept as factors,
    and unsigned indices spare the test for negative ones.
    """
    n_bands = len(bands) - 1
    one, two, half_px = f.dtype.type(1), f.dtype.type(2), f.dtype.type(0.5)
    w, w2 = np.uintp(width), np.uintp(2 * width)
    i1, i2 = np.uintp(1), np.uintp(2)
    for phase in range(2):
        for half in numba.prange((n_bands - phase + 1) // 2):
            band = 2 * half + phase
            taps = np.empty((count, 6), f.dtype)
            corners = np.empty(count, np.uintp)
            for p in range(bands[band], bands[band + 1]):
                q = places[p]
                vx, vy, c = q[4], q[5], q[6] / (two + two)
                s = f.dtype.type(0)
                for k in range(count):
                    t = np.float32(k - 0.5 * (count - 1))
                    x, y = q[0] + t * q[2], q[1] + t * q[3]
                    fx, fy = np.floor(x + half_px), np.floor(y + half_px)
                    dx, dy = x - fx, y - fy
                    mx, my = vx + dx * dx, vy + dy * dy
                    a0, a1, a2 = (mx - dx) / two, one - mx, (mx + dx) / two
                    b0, b1, b2 = (my - dy) / two, one - my, (my + dy) / two
                    o = np.uintp((np.int64(fy) - 1) * width + np.int64(fx) - 1)
                    u, v = o + w, o + w2
                    s += b0 * (a0 * f[o] + a1 * f[o + i1] + a2 * f[o + i2])
                    s += b1 * (a0 * f[u] + a1 * f[u + i1] + a2 * f[u + i2])
                    s += b2 * (a0 * f[v] + a1 * f[v + i1] + a2 * f[v + i2])
                    s += c * ((f[o] - f[o + i2]) - (f[v] - f[v + i2]))
                    at = taps[k]
                    at[0], at[1], at[2], at[3], at[4], at[5] = a0, a1, a2, b0, b1, b2
                    corners[k] = o
                s *= weights[p] / f.dtype.type(count * count)
                c *= s
                for k in range(count):
                    at = taps[k]
                    o = corners[k]
                    u, v = o + w, o + w2
                    a0, a1, a2 = at[0], at[1], at[2]
                    b0, b1, b2 = s * at[3], s * at[4], s * at[5]
                    out[o] += b0 * a0 + c
                    out[o + i1] += b0 * a1
                    out[o + i2] += b0 * a2 - c
                    out[u] += b1 * a0
                    out[u + i1] += b1 * a1
                    out[u + i2] += b1 * a2
                    out[v] += b2 * a0 - c
                    out[v + i1] += b2 * a1
                    out[v + i2] += b2 * a2 + c
