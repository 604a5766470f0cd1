"""The observation model W_i of Eq. 1: blur, motion m_i^-1 and sampling, with its exact adjoint.

W_i = S_i B. One blur B on the HR grid carries what the footprints of all LR pixels have in
common; S_i places 3 x 3 taps at the position of every LR pixel whose first and second moments make
up the rest, so that the varying scale and tilt of the module are respected. All frames together
enter the normal equations as B (sum_i S_i' V_i^-1 S_i) B, whose middle part is one small stencil
per HR pixel: its size does not depend on the number of frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from pv_inspect.camera import Camera
from pv_inspect.layout import HrGrid
from pv_inspect.psf import Blur, footprint_variance_lr_px2, kernel_of_variance
from pv_inspect.stencil import Stencil

__all__ = ["FrameOperator", "NormalEquations", "ObservationModel", "SensorRays"]

Array = NDArray[np.float64]
Image = NDArray[np.floating]

# Second moment per axis that is left to the taps on average, HR px^2. Three taps at a position d
# off the middle one are non-negative for moments from |d| - d^2 <= 1/4 up to 1 - d^2.
_TAP_VARIANCE = 0.25
# Limits of the taps' second moment: outside, they would sharpen or leave a hole.
_TAP_VARIANCE_RANGE = (-0.15, 0.75)
# LR rows that one thread works through; the bands between are another phase, so that the taps of
# bands of the same phase never meet.
_BAND_ROWS = 16


@dataclass(frozen=True, eq=False)
class SensorRays:
    """Undistorted normalised coordinates of all LR pixels; the same for all frames.

    Parameters
    ----------
    xy : (height, width, 2) float64
        Rays, NaN beyond the fold.
    per_px : (height, width, 2, 2) float64
        d ray / d pixel.
    """

    xy: Array
    per_px: Array

    @classmethod
    def of(cls, camera: Camera, shape: tuple[int, int]) -> SensorRays:
        """Trace the pixels of a sensor of shape (height, width).

        Notes
        -----
        d ray / d pixel = (K_2 A)^-1 with A = (1 + kappa u^T u) I + 2 kappa u u^T, the derivative of
        Eqs. 4 and 5.
        """
        y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
        u = camera.undistort(camera.to_normalised(np.stack([x, y], axis=-1)))
        a = (1.0 + camera.kappa * (u**2).sum(-1))[..., None, None] * np.eye(2)
        a += 2.0 * camera.kappa * u[..., :, None] * u[..., None, :]
        lens = np.empty_like(a)
        determinant = a[..., 0, 0] * a[..., 1, 1] - a[..., 0, 1] * a[..., 1, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            lens[..., 0, 0], lens[..., 1, 1] = a[..., 1, 1], a[..., 0, 0]
            lens[..., 0, 1], lens[..., 1, 0] = -a[..., 0, 1], -a[..., 1, 0]
            lens /= determinant[..., None, None]
        per_px: Array = lens @ np.linalg.inv(camera.K[:2, :2])
        traced = np.asarray(np.isfinite(per_px).all((-2, -1)))
        xy = np.where(traced[..., None], u, np.nan)
        return cls(xy, per_px)

    def cut(self, window: tuple[slice, slice]) -> SensorRays:
        """Rays of a part of the sensor, given as [row, col] slices."""
        return SensorRays(
            np.ascontiguousarray(self.xy[window]), np.ascontiguousarray(self.per_px[window])
        )


@dataclass(frozen=True, eq=False)
class ObservationModel:
    """What all W_i of a sequence share: camera, HR grid and PSF.

    Parameters
    ----------
    rays : SensorRays
    grid : HrGrid
    psf_sigma_lr_px : float
        Optical Gaussian, LR px.
    blur : Blur
        The common part B of all footprints.
    """

    rays: SensorRays
    grid: HrGrid
    psf_sigma_lr_px: float
    blur: Blur

    @classmethod
    def build(
        cls,
        rays: SensorRays,
        camera: Camera,
        homographies: Array,
        grid: HrGrid,
        psf_sigma_lr_px: float,
    ) -> ObservationModel:
        """Split the mean footprint over cells and frames into blur and taps.

        Parameters
        ----------
        rays : SensorRays
        camera : Camera
        homographies : (n, 3, 3) float64
            Module plane to normalised coordinates of the frames to be used.
        grid : HrGrid
        psf_sigma_lr_px : float
        """
        variance = footprint_variance_lr_px2(psf_sigma_lr_px)
        # d HR / d LR at the cell centres of all frames.
        layout = grid.layout
        i, j = np.mgrid[: layout.rows, : layout.cols] + 0.5
        centres = np.column_stack([j.ravel(), i.ravel() / layout.cell_aspect])
        every = np.concatenate([camera.jacobian(H, centres) for H in homographies])
        per_unit = every[np.isfinite(every).all((1, 2))]
        footprints = grid.pixels_per_unit * np.linalg.inv(per_unit)
        extent2 = (footprints**2).sum(2).mean(0)
        # The value of an HR pixel is the scene's mean over its area: 1/12 is in it already.
        common = extent2 * variance - 1.0 / 12.0 - _TAP_VARIANCE
        kernels = [kernel_of_variance(v, np.sqrt(w)) for v, w in zip(common, extent2, strict=True)]
        return cls(rays, grid, psf_sigma_lr_px, Blur(kernels[0], kernels[1]))

    def frame(self, H: Array) -> FrameOperator:
        """Return W_i of a frame with the homography H."""
        return FrameOperator(self, np.asarray(H, dtype=np.float64))

    @property
    def moments(self) -> Array:
        """(4,) LR variance of the footprint, variances of the blur along x and y, rim in HR px."""
        variance = footprint_variance_lr_px2(self.psf_sigma_lr_px)
        return np.array([variance, *self.blur.variances, self.blur.radius + 1.0])

    def to_hr(self, H: Array) -> Array:
        """Return the 3 x 3 homography from rays of a frame to HR pixels."""
        to_rays = np.asarray(H, dtype=np.float64) @ self.grid.matrix
        return np.asarray(np.linalg.inv(to_rays), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class FrameOperator:
    """System matrix W_i = S_i B of one frame.

    Notes
    -----
    ``g_l = sum_t c_{l,t} (B f)[p_l + t]``, t in {-1, 0, 1}^2 around the HR pixel p_l nearest to
    m_i^-1(x_l). With the offset (d_x, d_y) from p_l and the second moments (v_x, v_y, v_xy) left to
    the taps, ``c = a(d_x, v_x) a(d_y, v_y) + v_xy (t_x t_y) / 4``,
    ``a = ((v + d^2 - d) / 2, 1 - v - d^2, (v + d^2 + d) / 2)``.
    """

    model: ObservationModel
    H: Array

    def forward(self, f: Image) -> Image:
        """Image the HR image f (height, width): the LR frame, 0 where `inside` is False."""
        return self.sample(self.model.blur.apply(f))

    def sample(self, blurred: Image) -> Image:
        """S_i alone, on an image that is blurred already."""
        rays = self.model.rays
        out = np.zeros(rays.xy.shape[:2], blurred.dtype)
        _forward(self._to_hr, rays.xy, rays.per_px, self.model.moments, blurred, out)
        return out

    def adjoint(self, g: Image) -> Image:
        """W_i' of an LR frame g: an HR image."""
        rays, shape = self.model.rays, self.model.grid.shape
        out = np.zeros(shape, g.dtype)
        _adjoint(self._to_hr, rays.xy, rays.per_px, self.model.moments, g, out)
        return self.model.blur.apply(out)

    @property
    def inside(self) -> NDArray[np.bool_]:
        """LR pixels that see the HR grid, away from its rim."""
        return np.asarray(self.sample(np.ones(self.model.grid.shape)) != 0)

    def positions(self) -> Array:
        """m_i^-1 of all LR pixels: (height, width, 2) HR pixel coordinates (x, y), NaN outside."""
        rays = self.model.rays.xy
        homogeneous = rays @ self._to_hr[:, :2].T + self._to_hr[:, 2]
        w = np.where(homogeneous[..., 2] > 0, homogeneous[..., 2], np.nan)
        out: Array = homogeneous[..., :2] / w[..., None]
        return out

    @property
    def _to_hr(self) -> Array:
        return self.model.to_hr(self.H)


@dataclass(eq=False)
class NormalEquations:
    """Sum over frames of W_i' V_i^-1 W_i and W_i' V_i^-1 g_i; frames are added one by one.

    Parameters
    ----------
    model : ObservationModel
    stencil : Stencil
        ``sum_i S_i' V_i^-1 S_i``.
    back_projection : (height, width) float32
        ``sum_i S_i' V_i^-1 g_i``, not yet blurred.
    energy : float
        ``sum_i g_i' V_i^-1 g_i``.
    n_pixels : int
        LR pixels that have entered.
    """

    model: ObservationModel
    stencil: Stencil
    back_projection: Image
    energy: float = 0.0
    n_pixels: int = 0

    @classmethod
    def empty(
        cls, model: ObservationModel, dtype: type[np.floating] = np.float32
    ) -> NormalEquations:
        """Return the equations of no frame at all."""
        shape = model.grid.shape
        return cls(model, Stencil.zeros(shape, dtype), np.zeros(shape, dtype))

    def add(self, H: Array, g: Image, weights: Image) -> None:
        """Add one frame.

        Parameters
        ----------
        H : (3, 3) float64
        g : (height, width) float32
            Frame, mapped to the module's intensities.
        weights : (height, width) float32
            1 / variance per LR pixel; 0 where it must not count.
        """
        model = self.model
        rays = model.rays
        energy, n = _accumulate(
            model.to_hr(H),
            rays.xy,
            rays.per_px,
            model.moments,
            g,
            weights,
            self.stencil.planes,
            self.back_projection,
        )
        self.energy += float(energy)
        self.n_pixels += int(n)

    def apply(self, f: Image) -> Image:
        """Apply ``B (sum_i S_i' V_i^-1 S_i) B`` to an HR image."""
        blur = self.model.blur
        return blur.apply(self.stencil.apply(blur.apply(f)))

    @property
    def right_hand_side(self) -> Image:
        """``sum_i W_i' V_i^-1 g_i``."""
        return self.model.blur.apply(self.back_projection)

    @property
    def coverage(self) -> Image:
        """``sum_i S_i' V_i^-1 1``: the weight of the LR pixels around every HR pixel."""
        return self.stencil.apply(np.ones(self.back_projection.shape, self.back_projection.dtype))

    @property
    def diagonal(self) -> Image:
        """Positive approximation of the operator's diagonal, for preconditioning.

        The stencil is lumped to its row sums; where taps of either sign cancel, its own diagonal
        stands in.
        """
        return self.model.blur.apply_squared(np.maximum(self.coverage, self.stencil.diagonal))


@numba.njit(cache=True, inline="always")
def _place(M, ray, per_px, moments, shape, taps):  # type: ignore[no-untyped-def]
    """Nine taps of one LR pixel; returns the middle HR pixel (iy, ix), (-1, -1) if outside."""
    u, v = ray[0], ray[1]
    w = M[2, 0] * u + M[2, 1] * v + M[2, 2]
    if not w > 0.0:
        return -1, -1
    x = (M[0, 0] * u + M[0, 1] * v + M[0, 2]) / w
    y = (M[1, 0] * u + M[1, 1] * v + M[1, 2]) / w
    rim = moments[3]
    if not (rim <= x <= shape[1] - 1 - rim and rim <= y <= shape[0] - 1 - rim):
        return -1, -1
    a00, a01 = (M[0, 0] - x * M[2, 0]) / w, (M[0, 1] - x * M[2, 1]) / w
    a10, a11 = (M[1, 0] - y * M[2, 0]) / w, (M[1, 1] - y * M[2, 1]) / w
    j00 = a00 * per_px[0, 0] + a01 * per_px[1, 0]
    j01 = a00 * per_px[0, 1] + a01 * per_px[1, 1]
    j10 = a10 * per_px[0, 0] + a11 * per_px[1, 0]
    j11 = a10 * per_px[0, 1] + a11 * per_px[1, 1]
    low, high = _TAP_VARIANCE_RANGE
    vx = min(max(moments[0] * (j00 * j00 + j01 * j01) - 1.0 / 12.0 - moments[1], low), high)
    vy = min(max(moments[0] * (j10 * j10 + j11 * j11) - 1.0 / 12.0 - moments[2], low), high)
    vxy = min(max(moments[0] * (j00 * j10 + j01 * j11), -high), high) / 4.0
    ix, iy = int(np.floor(x + 0.5)), int(np.floor(y + 0.5))
    dx, dy = x - ix, y - iy
    mx, my = vx + dx * dx, vy + dy * dy
    ax0, ax1, ax2 = (mx - dx) / 2.0, 1.0 - mx, (mx + dx) / 2.0
    ay0, ay1, ay2 = (my - dy) / 2.0, 1.0 - my, (my + dy) / 2.0
    taps[0], taps[1], taps[2] = ay0 * ax0 + vxy, ay0 * ax1, ay0 * ax2 - vxy
    taps[3], taps[4], taps[5] = ay1 * ax0, ay1 * ax1, ay1 * ax2
    taps[6], taps[7], taps[8] = ay2 * ax0 - vxy, ay2 * ax1, ay2 * ax2 + vxy
    return iy, ix


@numba.njit(cache=True, parallel=True)
def _forward(M, rays, per_px, moments, f, out):  # type: ignore[no-untyped-def]
    for row in numba.prange(rays.shape[0]):
        taps = np.empty(9)
        for col in range(rays.shape[1]):
            iy, ix = _place(M, rays[row, col], per_px[row, col], moments, f.shape, taps)
            if iy >= 0:
                s = 0.0
                for t in range(9):
                    s += taps[t] * f[iy + t // 3 - 1, ix + t % 3 - 1]
                out[row, col] = s


@numba.njit(cache=True)
def _adjoint(M, rays, per_px, moments, g, out):  # type: ignore[no-untyped-def]
    taps = np.empty(9)
    for row in range(rays.shape[0]):
        for col in range(rays.shape[1]):
            iy, ix = _place(M, rays[row, col], per_px[row, col], moments, out.shape, taps)
            if iy >= 0:
                for t in range(9):
                    out[iy + t // 3 - 1, ix + t % 3 - 1] += taps[t] * g[row, col]


@numba.njit(cache=True, parallel=True)
def _accumulate(M, rays, per_px, moments, g, weights, planes, back):  # type: ignore[no-untyped-def]
    """Add S' V^-1 S and S' V^-1 g of one frame; returns g' V^-1 g and the number of pixels.

    Bands of LR rows run in two phases: the bands of one phase lie a band apart, and so do their
    taps on the HR grid. The sums do not depend on the number of threads.
    """
    height = rays.shape[0]
    n_bands = (height + _BAND_ROWS - 1) // _BAND_ROWS
    energy = np.zeros(n_bands)
    count = np.zeros(n_bands, np.int64)
    for phase in range(2):
        for half in numba.prange((n_bands - phase + 1) // 2):
            band = 2 * half + phase
            taps = np.empty(9)
            weighted = np.empty(9, planes.dtype)
            narrow = np.empty(9, planes.dtype)
            for row in range(band * _BAND_ROWS, min(height, (band + 1) * _BAND_ROWS)):
                for col in range(rays.shape[1]):
                    weight = weights[row, col]
                    if not weight > 0.0:
                        continue
                    iy, ix = _place(M, rays[row, col], per_px[row, col], moments, back.shape, taps)
                    if iy < 0:
                        continue
                    value = np.float64(g[row, col])
                    energy[band] += weight * value * value
                    count[band] += 1
                    for t in range(9):
                        weighted[t] = weight * taps[t]
                        narrow[t] = taps[t]
                    for ay in range(3):
                        y = iy + ay - 1
                        for ax in range(3):
                            x = ix + ax - 1
                            c = weighted[3 * ay + ax]
                            back[y, x] += c * value
                            for bx in range(ax, 3):
                                planes[bx - ax, y, x] += c * narrow[3 * ay + bx]
                            for by in range(ay + 1, 3):
                                for bx in range(3):
                                    k = 5 * (by - ay) + bx - ax
                                    planes[k, y, x] += c * narrow[3 * by + bx]
    return energy.sum(), count.sum()
