"""A pose: one camera and one homography, where the module plane is seen in one frame."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.geometry.camera import Camera

__all__ = ["Pose"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Pose:
    """One camera and one homography: where the module plane is seen in one frame."""

    camera: Camera
    homography: Array

    def project(self, module_points: Array) -> Array:
        """Module points (n, 2) to pixels (n, 2)."""
        return self.camera.project(self.homography, module_points)

    def unproject(self, pixels: Array) -> Array:
        """Pixels (n, 2) to module points (n, 2)."""
        return self.camera.unproject(self.homography, pixels)

    def shows(
        self, module_points: Array, shape: tuple[int, ...], beyond_px: float = 0.0
    ) -> NDArray[np.bool_]:
        """Whether module points lie in the frame.

        Parameters
        ----------
        module_points : (n, 2) float64
        shape : tuple of int
            (height, width) of the frame.
        beyond_px : float, optional
            They may lie so far outside.

        Returns
        -------
        (n,) bool
        """
        end = np.array([shape[1], shape[0]]) - 1 + beyond_px
        pixels = np.nan_to_num(self.project(module_points), nan=-np.inf)
        return np.asarray(np.all((pixels >= -beyond_px) & (pixels <= end), axis=1))

    def turned(
        self, size: tuple[float, float], new_size: tuple[float, float], quarter_turns: int
    ) -> Pose:
        """Put another rectangle, or the same one turned, onto the same place of the image.

        Parameters
        ----------
        size, new_size : tuple of float
            Width and height of the module of this pose, and of the returned one.
        quarter_turns : int
            Which corner of this module becomes the top left one, counted clockwise.

        Returns
        -------
        Pose
        """
        turn = np.linalg.matrix_power(np.array([[0.0, -1, 1], [1, 0, 0], [0, 0, 1]]), quarter_turns)
        scale, new_scale = np.diag([*size, 1.0]), np.diag([*new_size, 1.0])
        return Pose(self.camera, self.homography @ scale @ turn @ np.linalg.inv(new_scale))

    def under(self, camera: Camera, points: Array, appears: Array | None = None) -> Pose | None:
        """Return the pose under another camera that leaves points where they are seen.

        Parameters
        ----------
        camera : Camera
            With another kappa, say.
        points : (n, 2) float64
            Module points.
        appears : (n, 2) float64, optional
            What this pose shows where they belong: module points whose pixels they get; they
            themselves if not given.

        Returns
        -------
        Pose or None
            Least squares, with the sign of this one; None if the camera sees too few of the
            points. What no homography takes up is the bend between the two cameras.
        """
        rays = camera.undistort(
            camera.to_normalised(self.project(points if appears is None else appears))
        )
        seen = np.isfinite(rays).all(axis=1)
        found = cv2.findHomography(points[seen], rays[seen], 0)[0] if seen.sum() >= 4 else None
        if found is None:
            return None
        new, scale = np.asarray(found, np.float64), self.homography[2, 2]
        return Pose(camera, new * np.sign(new[2, 2] * scale) if scale else new)

    def scale_px(self, size: tuple[float, float]) -> float:
        """LR pixels per module unit in the middle of a module of this size.

        NaN where the pose has it beyond the fold of the lens.

        Parameters
        ----------
        size : tuple of float
            Width and height, module units.
        """
        jacobian = self.camera.jacobian(self.homography, np.array([size]) / 2)[0]
        with np.errstate(invalid="ignore"):
            return float(np.sqrt(np.abs(np.linalg.det(jacobian))))

    def jacobian_amid(self, shape: tuple[int, ...]) -> Array:
        """Derivatives of pixels by module points in the middle of a frame.

        The module itself may lie beyond the fold of the lens where the frame shows a part of it.

        Parameters
        ----------
        shape : tuple of int
            (height, width) of the frame.

        Returns
        -------
        (2, 2) float64
        """
        middle = self.unproject(np.array([[(shape[1] - 1) / 2, (shape[0] - 1) / 2]]))
        return np.asarray(self.camera.jacobian(self.homography, middle)[0])

    @property
    def aspect(self) -> float:
        """Length of the module's unit along x / along y, in truth, from the perspective.

        The columns of K^-1 H of a plane are r1 and r2 of the rotation, times its units. It is as
        good as the focal length is known; without tilt that does not matter.
        """
        across, down = np.linalg.norm(self.homography[:, :2], axis=0)
        return float(across / down)
