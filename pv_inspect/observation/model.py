"""The observation model W_i of Eq. 1: blur, motion m_i^-1 and sampling, with its exact adjoint.

W_i = S_i B. One blur B on the HR grid carries what the footprints of all LR pixels have in
common; S_i places 3 x 3 taps at the position of every LR pixel whose first and second moments make
up the rest, so that the varying scale and tilt of the module are respected. All frames together
enter the normal equations as B (sum_i S_i' V_i^-1 S_i) B, whose middle part is one small stencil
per HR pixel: its size does not depend on the number of frames. Frames with motion blur longer than
the taps reach enter one by one, see `pv_inspect.observation.motion_blur`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.rays import SensorRays
from pv_inspect.observation.motion_blur import STILL, MovingFrame, samples_of
from pv_inspect.observation.psf import Blur, footprint_variance_lr_px2, kernel_of_variance
from pv_inspect.observation.taps import TAP_VARIANCE

__all__ = ["FrameOperator", "ObservationModel"]

Array = NDArray[np.float64]
Image = NDArray[np.floating]


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
        centres = grid.layout.cell_centres()
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
