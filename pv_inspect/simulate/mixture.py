"""One camera that photographs several modules: sequences that must not be fused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.work import result_of
from pv_inspect.simulate.exposure import Exposer, Pose, Sensor, choose_poses
from pv_inspect.simulate.scene import Scene, render_scene
from pv_inspect.simulate.settings import SimulationSettings

__all__ = [
    "SimulatedMixture",
    "mirrored",
    "modules_of_one_make",
    "simulate_mixture",
    "upside_down",
]


@dataclass(frozen=True, eq=False)
class SimulatedMixture:
    """Frames of several modules by one camera.

    Parameters
    ----------
    settings : SimulationSettings
    shown : tuple of int
        Which module every frame shows.
    poses : tuple of Pose
        One per frame.
    frames : (n_frames, height, width) uint16
        Digital numbers.
    """

    settings: SimulationSettings
    shown: tuple[int, ...]
    poses: tuple[Pose, ...]
    frames: NDArray[np.uint16]


def modules_of_one_make(settings: SimulationSettings, count: int) -> tuple[Scene, ...]:
    """Render modules that differ in their cells only: silicon, brightness, cracks.

    Parameters
    ----------
    settings : SimulationSettings
    count : int
    """
    streams = np.random.default_rng([settings.seed, count]).spawn(count)
    return tuple(result_of(render_scene(settings, stream)) for stream in streams)


def simulate_mixture(
    settings: SimulationSettings, modules: Sequence[Scene], shown: Sequence[int]
) -> SimulatedMixture:
    """Simulate a sequence in which not every frame shows the same module.

    Parameters
    ----------
    settings : SimulationSettings
        Camera, light and movement; ``n_frames`` becomes the number of frames in ``shown``.
    modules : sequence of Scene
    shown : sequence of int
        Which of the modules every frame shows.
    """
    settings = SimulationSettings(**{**asdict(settings), "n_frames": len(shown)})
    pose_rng, pattern_rng, noise_rng = np.random.default_rng(settings.seed).spawn(4)[1:]
    poses = choose_poses(settings, pose_rng)
    sensor = Sensor(settings, pattern_rng)
    camera = Exposer(settings, modules[0])
    frames = np.array(
        [
            sensor.digitise(camera.of(modules[k]).expose(pose), pose.gain, noise_rng)
            for k, pose in zip(shown, poses, strict=True)
        ]
    )
    return SimulatedMixture(settings, tuple(shown), poses, frames)


def mirrored(scene: Scene) -> Scene:
    """Return another module: the mirror image, which no camera can take of the first."""
    return replace(
        scene,
        radiance=np.ascontiguousarray(scene.radiance[:, ::-1]),
        cracks=np.ascontiguousarray(scene.cracks[:, ::-1]),
        cells=(),
    )


def upside_down(scene: Scene) -> Scene:
    """Return the same module as the camera sees it upside down."""
    return replace(
        scene,
        radiance=np.ascontiguousarray(scene.radiance[::-1, ::-1]),
        cracks=np.ascontiguousarray(scene.cracks[::-1, ::-1]),
        cells=(),
    )
