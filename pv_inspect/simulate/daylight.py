"""Frames by daylight: the module reflects the sky and glows while the current is on."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.work import result_of
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.simulate.exposure import (
    Exposer,
    Pose,
    Sensor,
    camera_matrix,
    choose_poses,
    project_points,
)
from pv_inspect.simulate.scene import MEAN_RADIANCE, Scene, render_scene
from pv_inspect.simulate.settings import SimulationSettings

__all__ = ["Daylight", "SimulatedDaylight", "simulate_daylight"]

# Ground and sky around the module that the frames may show, module units.
_AROUND = 3.0
_PPU = 64
# Widths of the lines of the module by daylight, module units.
_GAP, _BUSBAR, _FRAME = 0.02, 0.012, 0.05


@dataclass(frozen=True)
class Daylight:
    """The light of the day, and when the current is on.

    Parameters
    ----------
    current : tuple of float
        Current of every frame: 1 on, 0 off, or a share of it.
    el_share : float
        EL of an average cell over the daylight that the module reflects.
    level : float
        Radiance of the module by daylight.
    contrast : float
        Spread of the surroundings (ground, sky, other things) around that level, as a share.
    glare : float
        Slow unevenness of the light on the sensor that does not move with the module, as a share.
    drift : float
        Change of the daylight from the first frame to the last, as a share.
    clouds : float
        Spread of the daylight from frame to frame, as a share.
    auto_gain : float
        0: the camera keeps its gain; 1: it keeps the mean of every frame constant.
    """

    current: tuple[float, ...]
    el_share: float = 0.1
    level: float = 0.5
    contrast: float = 0.4
    glare: float = 0.1
    drift: float = 0.05
    clouds: float = 0.0
    auto_gain: float = 0.0


@dataclass(frozen=True, eq=False)
class SimulatedDaylight:
    """Frames by daylight and what is known about them.

    Parameters
    ----------
    settings : SimulationSettings
    daylight : Daylight
    scene : Scene
        EL of the module.
    poses : tuple of Pose
    frames : (n_frames, height, width) uint16
        Digital numbers.
    night : (n_frames, height, width) uint16
        What the same camera would take of the EL alone, without daylight.
    """

    settings: SimulationSettings
    daylight: Daylight
    scene: Scene
    poses: tuple[Pose, ...]
    frames: NDArray[np.uint16]
    night: NDArray[np.uint16]

    def crossings_px(self, frame: int) -> NDArray[np.float64]:
        """Return the true positions of all crossings in a frame, (n_crossings, 2), row-major."""
        points = self.scene.layout.crossings()
        K = camera_matrix(self.settings)
        return project_points(K, self.settings.kappa, self.poses[frame].H, points)


def simulate_daylight(settings: SimulationSettings, daylight: Daylight) -> SimulatedDaylight:
    """Simulate a sequence by daylight with the current switched on and off.

    Parameters
    ----------
    settings : SimulationSettings
        Module, camera and movement; ``n_frames`` becomes the number of currents.
    daylight : Daylight

    Raises
    ------
    InspectionError
        If the distortion folds the module over.
    """
    settings = SimulationSettings(**{**asdict(settings), "n_frames": len(daylight.current)})
    streams = np.random.default_rng(settings.seed).spawn(6)
    module_rng, pose_rng, pattern_rng, noise_rng, day_rng, light_rng = streams
    scene = result_of(render_scene(settings, module_rng))
    poses = choose_poses(settings, pose_rng)
    glowing = Exposer(settings, scene)
    lit = glowing.of(_by_daylight(scene.layout, settings.busbars, daylight, day_rng))
    sensor = Sensor(settings, pattern_rng)
    glare = _glare((settings.height, settings.width), daylight.glare, light_rng)
    times = np.linspace(-0.5, 0.5, len(poses)) if len(poses) > 1 else np.zeros(1)
    lights = 1.0 + daylight.drift * times + daylight.clouds * light_rng.standard_normal(len(poses))
    el_radiance = daylight.el_share * daylight.level / MEAN_RADIANCE
    usual: float | None = None
    frames, night = [], []
    for pose, light, current in zip(poses, lights, daylight.current, strict=True):
        glow = current * el_radiance * glowing.expose(pose)
        day = np.float32(light) * glare * lit.expose(pose)
        total = (day + glow).astype(np.float32)
        mean = float(total.mean())
        usual = mean if usual is None else usual
        gain = pose.gain * (usual / mean) ** daylight.auto_gain
        frames.append(sensor.digitise(total, gain, noise_rng))
        night.append(sensor.digitise(glow.astype(np.float32), pose.gain, noise_rng))
    return SimulatedDaylight(settings, daylight, scene, poses, np.array(frames), np.array(night))


def _by_daylight(
    layout: ModuleLayout, busbars: int, daylight: Daylight, rng: np.random.Generator
) -> Scene:
    """Draw the module as the sun shows it (dark cells, bright metal) before its surroundings."""
    width, height = layout.size
    shape = tuple(int(np.ceil((side + 2 * _AROUND) * _PPU)) for side in (height, width))
    origin = _AROUND * _PPU - 0.5
    picture = daylight.level * (1.0 + daylight.contrast * _texture((shape[0], shape[1]), rng))
    y = (np.arange(shape[0]) - origin)[:, None] / _PPU
    x = (np.arange(shape[1]) - origin)[None, :] / _PPU
    beyond = np.maximum(np.maximum(-x, x - width), np.maximum(-y, y - height))
    picture = np.where(beyond < 0.15, daylight.level * 1.5, picture)
    picture = np.where(beyond < 0.15 - _FRAME, daylight.level * 1.2, picture)
    cells = daylight.level * (0.9 + 0.05 * _texture((shape[0], shape[1]), rng))
    upright = layout.cell_aspect > 1
    along, lines = (x, layout.col_starts) if upright else (y, layout.row_starts)
    for start, pitch in zip(lines, layout.widths if upright else layout.heights, strict=True):
        for k in range(busbars):
            at = start + pitch * (k + 0.5) / busbars
            cells = np.where(np.abs(along - at) < _BUSBAR, daylight.level * 1.4, cells)
    for axis, edges in ((x, layout.col_lines), (y, layout.row_lines)):
        for at in edges:
            cells = np.where(np.abs(axis - at) < _GAP / 2, daylight.level * 1.3, cells)
    picture = np.where(beyond < 0, cells, picture)
    smooth = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 0.01 * _PPU)
    radiance = np.maximum(smooth, 0.02 * daylight.level).astype(np.float32)
    return Scene(layout, _PPU, (origin, origin), radiance, np.zeros(shape, bool))


def _texture(shape: tuple[int, int], rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a random picture of mean 0 and spread 1: soft at all scales, with hard edges."""
    height, width = shape
    total = np.zeros(shape)
    for side in (4, 12, 40):
        cells = (max(2, side * height // width), side)
        coarse = rng.standard_normal(cells).astype(np.float32)
        total += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC) / np.sqrt(side)
    for _ in range(12):
        at = rng.uniform(0, [width, height])
        half = rng.uniform(0.02, 0.12, 2) * width
        top, left = np.maximum((at - half)[::-1].astype(int), 0)
        bottom, right = np.maximum((at + half)[::-1].astype(int), 0)
        total[top:bottom, left:right] += 0.5 * rng.standard_normal()
    even: NDArray[np.float64] = (total - total.mean()) / total.std()
    return even


def _glare(shape: tuple[int, int], share: float, rng: np.random.Generator) -> NDArray[np.float32]:
    coarse = rng.standard_normal((3, 4)).astype(np.float32)
    slow = cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)
    uneven: NDArray[np.float32] = np.clip(1.0 + share * slow, 0.2, None).astype(np.float32)
    return uneven
