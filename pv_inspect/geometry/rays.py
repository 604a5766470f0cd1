"""The rays of the sensor: where every pixel looks, lens distortion taken out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pv_inspect.geometry.camera import Camera

__all__ = ["SensorRays"]

Array = NDArray[np.float64]
Image = NDArray[np.floating]


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
