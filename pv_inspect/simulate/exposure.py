"""A numerical exposure: the scene through the lens onto the sensor, and the sensor's electronics.

This file has its own camera model on purpose. The inspection must not be tested against frames
that were made with its own code.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.simulate.scene import Scene
from pv_inspect.simulate.settings import SimulationSettings

__all__ = [
    "Exposer",
    "Pose",
    "Sensor",
    "camera_matrix",
    "choose_poses",
    "project_points",
    "undistorted_radius",
]

Points = NDArray[np.float64]
Image = NDArray[np.float32]


@dataclass(frozen=True)
class Pose:
    """One frame's view.

    Parameters
    ----------
    H : (3, 3) float64
        Module plane to normalised image coordinates.
    gain : float
        Brightness of this frame relative to the mean.
    motion_px : float
        Length of the motion during the exposure, LR pixels; its middle is at ``H``.
    motion_deg : float
        Direction of the motion in the image, from x towards y.
    """

    H: Points
    gain: float
    motion_px: float
    motion_deg: float


def camera_matrix(settings: SimulationSettings) -> Points:
    """K, with a principal point some pixels off the centre of the image."""
    f = settings.focal_px
    cx = (settings.width - 1) / 2 - round(0.01 * settings.width) / 2
    cy = (settings.height - 1) / 2 + round(0.01 * settings.height)
    return np.array([[f, 0.0, cx], [0.0, f, cy], [0.0, 0.0, 1.0]])


def undistorted_radius(radius: Points, kappa: float) -> Points:
    """Solve r + kappa r^3 = r_d for r on the branch that holds r = 0.

    Parameters
    ----------
    radius : (...) float64
        Distorted radii r_d >= 0, normalised coordinates.
    kappa : float

    Returns
    -------
    (...) float64
        NaN at and beyond the fold r_d^2 = -4 / (27 kappa) of a negative kappa: no ray gets there.

    Notes
    -----
    Newton's method from r = r_d. The cubic is concave (kappa < 0) or convex (kappa > 0) for r > 0,
    and r_d lies on the side from which the steps approach the root monotonically.
    """
    target = np.asarray(radius, np.float64)
    r = target.copy()
    if kappa < 0:
        r[target**2 >= -4.0 / (27.0 * kappa)] = np.nan
    for _ in range(80):
        slope = 1.0 + 3.0 * kappa * r * r
        step = (r + kappa * r**3 - target) / slope
        r -= step
        if not np.any(np.abs(step) > 1e-14 * r):  # the step has squared the error already
            break
    return r


def project_points(K: Points, kappa: float, H: Points, points: Points) -> Points:
    """x_px = K d(H [x, y, 1]): module points (n, 2) to pixels (n, 2), NaN beyond the fold."""
    q = np.column_stack([points, np.ones(len(points))]) @ H.T
    xy = q[:, :2] / np.where(q[:, 2:] > 0, q[:, 2:], np.nan)
    r2 = np.sum(xy**2, axis=1, keepdims=True)
    xy = np.where(1.0 + 3.0 * kappa * r2 > 0, xy * (1.0 + kappa * r2), np.nan)
    return np.asarray(xy * [K[0, 0], K[1, 1]] + K[:2, 2], np.float64)


def _rotation(axis_angle: Points) -> Points:
    return np.asarray(cv2.Rodrigues(np.asarray(axis_angle, np.float64))[0])


def _plane_to_camera(rotation: Points, translation: Points, layout: ModuleLayout) -> Points:
    """H of a module whose middle lies at ``translation`` in the camera."""
    middle = np.array(layout.size) / 2
    R = rotation[:, :2]
    return np.column_stack([R, translation - R @ middle])


def choose_poses(settings: SimulationSettings, rng: np.random.Generator) -> tuple[Pose, ...]:
    """Poses of all frames, scattered about one view that fills the frame as wanted.

    Raises
    ------
    InspectionError
        If the distortion folds the module over in this view.
    """
    K, layout = camera_matrix(settings), settings.layout
    axis = np.radians(settings.tilt_axis_deg)
    tilt = np.radians(settings.tilt_deg) * np.array([np.cos(axis), np.sin(axis), 0.0])
    rotation = _rotation(np.array([0, 0, np.radians(settings.roll_deg)])) @ _rotation(tilt)
    base = _framing(settings, K, rotation)
    poses = []
    for _ in range(settings.n_frames):
        turn = np.radians(rng.normal(0.0, settings.jitter_deg, 3))
        shift = rng.normal(0.0, settings.jitter_px, 3) * base[2] / settings.focal_px
        shift[2] *= 0.5 * settings.focal_px / settings.width
        H = _plane_to_camera(_rotation(turn) @ rotation, base + shift, layout)
        gain = 1.0 + settings.flicker * float(rng.normal())
        blur = settings.motion_blur_px * float(rng.random())
        pose = Pose(H, max(gain, 0.1), blur, 180.0 * float(rng.random()))
        if np.isnan(project_points(K, settings.kappa, H, layout.crossings())).any():
            raise _folded(settings)
        poses.append(pose)
    return tuple(poses)


def _framing(settings: SimulationSettings, K: Points, rotation: Points) -> Points:
    """Position of the module that spans ``fill`` of the frame, centred, by fixed point."""
    size = np.array([settings.width, settings.height])
    outline = np.array(settings.layout.size) * _unit_square_outline()
    position = np.array([0.0, 0.0, 4 * max(settings.layout.size) * settings.focal_px / size[0]])
    for _ in range(60):
        H = _plane_to_camera(rotation, position, settings.layout)
        pixels = project_points(K, settings.kappa, H, outline)
        if np.isnan(pixels).any():
            raise _folded(settings)
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        position[:2] -= ((low + high) / 2 - (size - 1) / 2) * position[2] / settings.focal_px
        ratio = float(np.max((high - low) / size)) / settings.fill
        position *= ratio
    return position


def _unit_square_outline() -> Points:
    t = np.linspace(0, 1, 41)
    o, i = np.zeros_like(t), np.ones_like(t)
    return np.vstack([np.c_[t, o], np.c_[t, i], np.c_[o, t], np.c_[i, t]])


def _folded(settings: SimulationSettings) -> InspectionError:
    return InspectionError(
        f"With kappa {settings.kappa:g} and a focal length of {settings.focal_px:g} px the image "
        "of the module folds over: use a weaker kappa, a longer focal length, or a smaller fill."
    )


class Exposer:
    """Exposes frames of a scene with one camera; holds the rays of the sensor samples.

    Each LR pixel is sampled ``supersampling`` x ``supersampling`` times. The optical blur and the
    motion act on these samples, then their mean over the pixel is taken: the pixel aperture.

    Parameters
    ----------
    settings : SimulationSettings
    scene : Scene
    """

    def __init__(self, settings: SimulationSettings, scene: Scene) -> None:
        self._settings = settings
        self._scene = scene
        K, ss = camera_matrix(settings), settings.supersampling
        # The blur needs light from outside of the frame.
        self._pad = int(np.ceil(4 * settings.psf_sigma_px + settings.motion_blur_px / 2)) + 1

        def centres(n: int, f: float, c: float) -> Points:
            k = np.arange((n + 2 * self._pad) * ss)
            return ((k + 0.5) / ss - 0.5 - self._pad - c) / f

        x = centres(settings.width, K[0, 0], K[0, 2])
        y = centres(settings.height, K[1, 1], K[1, 2])
        self._x = np.empty((len(y), len(x)), np.float32)
        self._y = np.empty_like(self._x)
        for part in _strips(len(y)):
            distorted = np.hypot(x[None, :], y[part, None])
            scale = undistorted_radius(distorted, settings.kappa) / np.maximum(distorted, 1e-12)
            self._x[part], self._y[part] = x * scale, y[part, None] * scale

    def of(self, scene: Scene) -> Exposer:
        """Return the same camera in front of another scene."""
        other = copy(self)
        other._scene = scene
        return other

    def expose(self, pose: Pose) -> Image:
        """Mean radiance over each pixel during the exposure.

        Returns
        -------
        (height, width) float32
        """
        samples = self._sample(pose.H)
        settings, ss = self._settings, self._settings.supersampling
        sigma = settings.psf_sigma_px * ss
        if sigma > 0 and settings.psf_shape == "disc":
            samples = np.asarray(cv2.filter2D(samples, -1, _disc_kernel(sigma)), np.float32)
        elif sigma > 0:
            radius = int(np.ceil(4 * sigma))
            blurred = cv2.GaussianBlur(samples, (2 * radius + 1, 2 * radius + 1), sigma)
            samples = np.asarray(blurred, np.float32)
        if pose.motion_px > 0:
            kernel = _line_kernel(pose.motion_px * ss, pose.motion_deg)
            samples = np.asarray(cv2.filter2D(samples, -1, kernel), np.float32)
        rows, cols = samples.shape
        pixels = samples.reshape(rows // ss, ss, cols // ss, ss).mean(axis=(1, 3))
        p = self._pad
        return np.ascontiguousarray(pixels[p : p + settings.height, p : p + settings.width])

    def _sample(self, H: Points) -> Image:
        """Radiance seen by each sensor sample; none beyond the fold or outside of the scene."""
        ppu, (ox, oy) = self._scene.pixels_per_unit, self._scene.origin_px
        to_scene = np.array([[ppu, 0, ox], [0, ppu, oy], [0, 0, 1.0]]) @ np.linalg.inv(H)
        to_scene = to_scene.astype(np.float32)
        samples = np.empty_like(self._x)
        for part in _strips(len(samples)):
            x, y = self._x[part], self._y[part]
            u, v, w = (a * x + b * y + c for a, b, c in to_scene)
            far = np.float32(-100.0)
            front = np.isfinite(w) & (w * np.sign(to_scene[2, 2]) > 0)
            w = np.where(front, w, 1)
            u, v = np.where(front, u / w, far), np.where(front, v / w, far)
            limit = np.float32(30000)
            u, v = np.clip(u, far, limit), np.clip(v, far, limit)
            samples[part] = cv2.remap(
                self._scene.radiance, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT
            )
        return samples


def _strips(n: int, rows: int = 256) -> list[slice]:
    """Row blocks: temporary arrays stay in the cache and memory small."""
    return [slice(k, min(k + rows, n)) for k in range(0, n, rows)]


def _disc_kernel(sigma: float) -> Image:
    """Disc with a standard deviation of sigma samples per axis, its rim by area."""
    radius, parts = 2.0 * sigma, 16
    half = int(np.ceil(radius + 0.5))
    at = (np.arange((2 * half + 1) * parts) + 0.5) / parts - half - 0.5
    inside = (at[:, None] ** 2 + at[None, :] ** 2 <= radius**2).astype(np.float64)
    kernel = inside.reshape(2 * half + 1, parts, 2 * half + 1, parts).mean((1, 3))
    return np.asarray(kernel / kernel.sum(), np.float32)


def _line_kernel(length: float, angle_deg: float) -> Image:
    """Uniform motion over ``length`` samples, centred, as a kernel with bilinear weights."""
    radius = int(np.ceil(length / 2)) + 1
    kernel = np.zeros((2 * radius + 1, 2 * radius + 1))
    angle = np.radians(angle_deg)
    n = max(int(8 * length), 16)
    t = ((np.arange(n) + 0.5) / n - 0.5) * length
    x, y = radius + t * np.cos(angle), radius + t * np.sin(angle)
    i, j = np.floor(y).astype(int), np.floor(x).astype(int)
    for di, dj in ((0, 0), (0, 1), (1, 0), (1, 1)):
        weight = np.abs(1 - di - (y - i)) * np.abs(1 - dj - (x - j))
        np.add.at(kernel, (i + di, j + dj), weight)
    return np.asarray(kernel / kernel.sum(), np.float32)


class Sensor:
    """Turns radiance into digital numbers; one sensor has one fixed pattern.

    Parameters
    ----------
    settings : SimulationSettings
    rng : numpy.random.Generator
        For the fixed pattern, unless the settings have a ``sensor_seed``.

    Attributes
    ----------
    column_gain : (width,) float64
        Share by which a column sees more light than the others.
    column_offset : (width,) float64
        What a column adds, full scale = 1.
    """

    def __init__(self, settings: SimulationSettings, rng: np.random.Generator) -> None:
        self._settings = settings
        if settings.sensor_seed >= 0:
            rng = np.random.default_rng(settings.sensor_seed)
        shape = (settings.height, settings.width)
        v, u = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float64)
        centre = camera_matrix(settings)[:2, 2]
        far = np.hypot(settings.width, settings.height) / 2
        radius2 = ((u - centre[0]) ** 2 + (v - centre[1]) ** 2) / far**2
        gain = 1.0 - settings.vignetting * radius2
        gain *= 1.0 + settings.prnu * rng.standard_normal(shape)
        self.column_gain = settings.column_gain * rng.standard_normal(shape[1])
        gain *= 1.0 + self.column_gain
        self._gain = np.clip(gain, 0, None)
        self._offset_e = settings.column_offset_e * rng.standard_normal(shape[1])
        self.column_offset = self._offset_e / settings.full_well_e
        lottery = rng.random(shape)
        self._dead = lottery < settings.dead_share
        self._hot = ~self._dead & (lottery < settings.dead_share + settings.hot_share)
        self._hot_e = rng.uniform(0.5, 1.5, shape) * settings.full_well_e

    @property
    def defects(self) -> NDArray[np.bool_]:
        """Hot and dead pixels, (height, width)."""
        return self._hot | self._dead

    def digitise(
        self, radiance: Image, gain: float, rng: np.random.Generator
    ) -> NDArray[np.uint16]:
        """Read one frame out.

        Parameters
        ----------
        radiance : (height, width) float32
        gain : float
            Of this frame.
        rng : numpy.random.Generator
            For the noise of this frame.

        Returns
        -------
        (height, width) uint16
            ``black_level_dn`` + signal, cut to the range of the converter; dead pixels are 0.
        """
        settings = self._settings
        light = (radiance.astype(np.float64) + settings.ambient) * gain * self._gain
        electrons = np.clip(light * settings.exposure, 0, None) * settings.full_well_e
        if settings.shot_noise:
            electrons = rng.poisson(electrons).astype(np.float64)
        electrons += self._offset_e
        electrons += settings.read_noise_e * rng.standard_normal(radiance.shape)
        electrons = np.where(self._hot, electrons + self._hot_e, electrons)
        dn = settings.black_level_dn + settings.max_dn * electrons / settings.full_well_e
        dn[self._dead] = 0
        return np.asarray(np.clip(np.rint(dn), 0, settings.max_dn), np.uint16)
