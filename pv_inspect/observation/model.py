"""The observation model W_i of Eq. 1: blur, motion m_i^-1 and sampling, with its exact adjoint.

W_i = S_i B. One blur B on the HR grid carries what the footprints of all LR pixels have in
common; S_i places 3 x 3 taps at the position of every LR pixel whose first and second moments make
up the rest, so that the varying scale and tilt of the module are respected. All frames together
enter the normal equations as B (sum_i S_i' V_i^-1 S_i) B, whose middle part is one small stencil
per HR pixel: its size does not depend on the number of frames. Frames with motion blur longer than
the taps reach enter one by one, see `pv_inspect.observation.motion_blur`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numba
import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.compiling import compiled
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.layout import HrGrid
from pv_inspect.observation.motion_blur import STILL, MovingFrame, samples_of
from pv_inspect.observation.psf import Blur, footprint_variance_lr_px2, kernel_of_variance
from pv_inspect.observation.stencil import Stencil
from pv_inspect.observation.taps import TAP_VARIANCE, fill_taps, locate

__all__ = ["FrameOperator", "NormalEquations", "ObservationModel", "SensorRays"]

Array = NDArray[np.float64]
Image = NDArray[np.floating]

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
    def of(
        cls, camera: Camera, shape: tuple[int, int], window: tuple[slice, slice] | None = None
    ) -> SensorRays:
        """Trace the pixels of a sensor.

        Parameters
        ----------
        camera : Camera
        shape : (height, width)
        window : [row, col] slices, optional
            The part of the sensor that is wanted.

        Notes
        -----
        d ray / d pixel = (K_2 A)^-1 with A = (1 + kappa u^T u) I + 2 kappa u u^T, the derivative of
        Eqs. 4 and 5. A is symmetric, and K_2^-1 has no entry below its diagonal.
        """
        window = window or (slice(None), slice(None))
        rows, cols = (np.arange(n, dtype=np.float64)[s] for n, s in zip(shape, window, strict=True))
        px = np.empty((len(rows), len(cols), 2))
        px[..., 0], px[..., 1] = cols, rows[:, None]
        xy = camera.undistort(camera.to_normalised(px))
        u, v = xy[..., 0], xy[..., 1]
        kappa = camera.kappa
        across, uu, vv = 2.0 * kappa * u * v, kappa * u * u, kappa * v * v
        a, d = 1.0 + 3.0 * uu + vv, 1.0 + uu + 3.0 * vv
        (k00, k01), (_, k11) = np.linalg.inv(camera.K[:2, :2])
        per_px = np.empty((*u.shape, 2, 2))
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1.0 / (a * d - across * across)
            per_px[..., 0, 0] = scale * d * k00
            per_px[..., 0, 1] = scale * (d * k01 - across * k11)
            per_px[..., 1, 0] = -scale * across * k00
            per_px[..., 1, 1] = scale * (a * k11 - across * k01)
        xy[~np.isfinite(scale)] = np.nan
        return cls(xy, per_px)

    def cut(self, window: tuple[slice, slice]) -> SensorRays:
        """Rays of a part of the sensor, given as [row, col] slices: a view, nothing is copied."""
        return SensorRays(self.xy[window], self.per_px[window])

    def contiguous(self) -> SensorRays:
        """Return the same rays side by side in memory, as compiled code wants them."""
        return SensorRays(np.ascontiguousarray(self.xy), np.ascontiguousarray(self.per_px))


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
        common = extent2 * variance - 1.0 / 12.0 - TAP_VARIANCE
        kernels = [kernel_of_variance(v, np.sqrt(w)) for v, w in zip(common, extent2, strict=True)]
        return cls(rays, grid, psf_sigma_lr_px, Blur(kernels[0], kernels[1]))

    def frame(self, H: Array, motion: Array = STILL) -> FrameOperator:
        """Return W_i of a frame with the homography H and a motion (see `motion_of`)."""
        return FrameOperator(self, np.asarray(H, dtype=np.float64), motion)

    def samples(self, motion: Array) -> int:
        """Samples along the path of a motion; one means that the taps alone carry it."""
        return samples_of(motion, self.grid.magnification)

    def moving(
        self,
        H: Array,
        motion: Array,
        wanted: NDArray[np.bool_] | None = None,
        dtype: np.dtype[np.floating] | type[np.floating] = np.float64,
    ) -> MovingFrame:
        """Return S_i of a frame with motion blur as positions."""
        rays = self.rays.contiguous()
        return MovingFrame.build(
            self.to_hr(H),
            rays.xy,
            rays.per_px,
            self.moments,
            motion,
            self.samples(motion),
            self.grid.shape,
            wanted,
            dtype,
        )

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
    m_i^-1(x_l); the taps c are those of `pv_inspect.observation.taps.fill_taps`. With
    motion blur it is the mean of several such sums, see
    `pv_inspect.observation.motion_blur.MovingFrame`.
    """

    model: ObservationModel
    H: Array
    motion: Array = field(default_factory=lambda: STILL)

    def forward(self, f: Image) -> Image:
        """Image the HR image f (height, width): the LR frame, 0 where `inside` is False."""
        return self.sample(self.model.blur.apply(f))

    def sample(self, blurred: Image) -> Image:
        """S_i alone, on an image that is blurred already."""
        moving = self._moving
        out = np.zeros(self.model.rays.xy.shape[:2], blurred.dtype)
        out.reshape(-1)[moving.pixels] = moving.sample(blurred)
        return out

    def adjoint(self, g: Image) -> Image:
        """W_i' of an LR frame g: an HR image."""
        moving = self._moving
        out = np.zeros(self.model.grid.shape, g.dtype)
        moving.scatter(g.reshape(-1)[moving.pixels], out)
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

    @property
    def _moving(self) -> MovingFrame:
        return self.model.moving(self.H, self.motion)


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
    n_still : int
        Frames in the stencil.
    moving : list of (MovingFrame, (n,) float32, float)
        Frames whose motion is longer than the taps of the stencil reach: their samples, weights,
        and peak of their PSF relative to that of a still frame.
    """

    model: ObservationModel
    stencil: Stencil
    back_projection: Image
    energy: float = 0.0
    n_pixels: int = 0
    n_still: int = 0
    moving: list[tuple[MovingFrame, Image, float]] = field(default_factory=list)

    @classmethod
    def empty(
        cls, model: ObservationModel, dtype: type[np.floating] = np.float32
    ) -> NormalEquations:
        """Return the equations of no frame at all."""
        shape = model.grid.shape
        return cls(model, Stencil.zeros(shape, dtype), np.zeros(shape, dtype))

    def add(
        self,
        H: Array,
        g: Image,
        weights: Image,
        motion: Array = STILL,
        rays: SensorRays | None = None,
    ) -> None:
        """Add one frame.

        Parameters
        ----------
        H : (3, 3) float64
        g : (height, width) float32
            Frame, mapped to the module's intensities.
        weights : (height, width) float32
            1 / variance per LR pixel; 0 where it must not count.
        motion : (2,) float64
            See `pv_inspect.observation.motion_blur.motion_of`.
        rays : SensorRays, optional
            Rays of g if it is only a part of the frame; default: those of the model.
        """
        model = self.model if rays is None else replace(self.model, rays=rays)
        rays = model.rays.contiguous()
        if model.samples(motion) > 1:
            self._add_moving(model, H, g, weights, motion)
            return
        self.n_still += 1
        energy, n = _accumulate(
            model.to_hr(H),
            rays.xy,
            rays.per_px,
            model.moments,
            np.append(motion, 1.0),
            g,
            weights,
            self.stencil.planes,
            self.back_projection,
        )
        self.energy += float(energy)
        self.n_pixels += int(n)

    def _add_moving(
        self, model: ObservationModel, H: Array, g: Image, weights: Image, motion: Array
    ) -> None:
        kind = self.back_projection.dtype
        frame = model.moving(H, motion, weights > 0, kind)
        values = g.reshape(-1)[frame.pixels].astype(kind)
        w = weights.reshape(-1)[frame.pixels].astype(kind)
        frame.scatter(w * values, self.back_projection)
        still = footprint_variance_lr_px2(model.psf_sigma_lr_px)
        spread = np.sqrt(still / (still + (motion[0] ** 2 + motion[1] ** 2) / 12.0))
        self.moving.append((frame, w, float(spread)))
        self.energy += float(np.sum(w * values.astype(np.float64) ** 2))
        self.n_pixels += len(w)

    def apply(self, f: Image) -> Image:
        """Apply ``B (sum_i S_i' V_i^-1 S_i) B`` to an HR image."""
        blur = self.model.blur
        blurred = blur.apply(f)
        out = self.stencil.apply(blurred) if self.n_still else np.zeros_like(blurred)
        for frame, weights, _ in self.moving:
            frame.add_normal(weights, blurred, out)
        return blur.apply(out)

    @property
    def right_hand_side(self) -> Image:
        """``sum_i W_i' V_i^-1 g_i``."""
        return self.model.blur.apply(self.back_projection)

    @property
    def coverage(self) -> Image:
        """``sum_i S_i' V_i^-1 1``: the weight of the LR pixels around every HR pixel."""
        out = self._still_coverage
        for frame, weights, _ in self.moving:
            frame.scatter(weights, out)
        return out

    @property
    def diagonal(self) -> Image:
        """Positive approximation of the operator's diagonal, for preconditioning.

        The stencil is lumped to its row sums; where taps of either sign cancel, its own diagonal
        stands in. The row sums of frames that moved are lowered by what the motion widens the PSF.
        """
        lumped = np.maximum(self._still_coverage, self.stencil.diagonal)
        for frame, weights, spread in self.moving:
            frame.scatter(weights * lumped.dtype.type(spread), lumped)
        # At the end of a module's coverage single taps may be negative.
        return self.model.blur.apply_squared(np.maximum(lumped, 0))

    @property
    def _still_coverage(self) -> Image:
        ones = np.ones(self.back_projection.shape, self.back_projection.dtype)
        return self.stencil.apply(ones) if self.n_still else np.zeros_like(ones)


@compiled(parallel=True)
def _accumulate(  # type: ignore[no-untyped-def]
    M, rays, per_px, moments, motion, g, weights, planes, back
):
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
            place = np.empty(7)
            taps = np.empty(9)
            weighted = np.empty(9, planes.dtype)
            narrow = np.empty(9, planes.dtype)
            for row in range(band * _BAND_ROWS, min(height, (band + 1) * _BAND_ROWS)):
                for col in range(rays.shape[1]):
                    weight = weights[row, col]
                    if not weight > 0.0:
                        continue
                    if not locate(
                        M, rays[row, col], per_px[row, col], moments, motion, back.shape, place
                    ):
                        continue
                    iy, ix = fill_taps(place[0], place[1], place[4], place[5], place[6], taps)
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
