"""Simulated modules and sequences, with complete truth, for the sample and the tests.

A procedural module (``scene``) is exposed numerically (``exposure``) and written with its truth
(``files``). Nothing here uses the observation or camera model of the inspection: a test against
these frames is no inverse crime.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.work import Progress, forwarded, result_of
from pv_inspect.simulate.exposure import (
    Exposer,
    Pose,
    Sensor,
    camera_matrix,
    choose_poses,
    project_points,
)
from pv_inspect.simulate.files import check_target, reserve_sequence, write_sequence
from pv_inspect.simulate.mixture import (
    SimulatedMixture,
    mirrored,
    modules_of_one_make,
    simulate_mixture,
    upside_down,
)
from pv_inspect.simulate.scene import CellTruth, Scene, render_scene
from pv_inspect.simulate.settings import SimulationSettings

__all__ = [
    "CellTruth",
    "Pose",
    "Scene",
    "SimulatedMixture",
    "SimulatedSequence",
    "SimulationSettings",
    "check_target",
    "mirrored",
    "modules_of_one_make",
    "reserve_sequence",
    "simulate",
    "simulate_mixture",
    "simulated",
    "upside_down",
    "write_sequence",
]


@dataclass(frozen=True)
class SimulatedSequence:
    """Frames and everything that is known about them.

    Parameters
    ----------
    settings : SimulationSettings
    scene : Scene
    poses : tuple of Pose
        One per frame.
    frames : (n_frames, height, width) uint16
        Digital numbers.
    """

    settings: SimulationSettings
    scene: Scene
    poses: tuple[Pose, ...]
    frames: NDArray[np.uint16]

    @property
    def camera_matrix(self) -> NDArray[np.float64]:
        """K, (3, 3)."""
        return camera_matrix(self.settings)

    @property
    def frame_names(self) -> tuple[str, ...]:
        """File name of each frame."""
        digits = max(3, len(str(len(self.poses) - 1)))
        return tuple(f"frame_{i:0{digits}d}.tif" for i in range(len(self.poses)))

    def crossings_px(self, frame: int) -> NDArray[np.float64]:
        """Return the true positions of all crossings in a frame, (n_crossings, 2), row-major."""
        points = self.scene.layout.crossings()
        return project_points(self.camera_matrix, self.settings.kappa, self.poses[frame].H, points)


def simulate(
    settings: SimulationSettings, scene: Scene | None = None
) -> Generator[Progress, None, SimulatedSequence]:
    """Simulate a sequence.

    Parameters
    ----------
    settings : SimulationSettings
    scene : Scene, optional
        Photograph this scene (of the settings' layout) instead of a procedural module.

    Yields
    ------
    Progress

    Raises
    ------
    InspectionError
        If the distortion folds the module over.
    """
    # Separate streams: more frames, or another sensor, leave the module as it is.
    module_rng, pose_rng, pattern_rng, noise_rng = np.random.default_rng(settings.seed).spawn(4)
    poses = choose_poses(settings, pose_rng)
    share = 0.2
    if scene is None:
        scene = yield from forwarded(
            render_scene(settings, module_rng),
            lambda done: Progress(share * done, "drawing the cells"),
        )
    exposer = Exposer(settings, scene)
    sensor = Sensor(settings, pattern_rng)
    frames = np.empty((len(poses), settings.height, settings.width), np.uint16)
    for i, pose in enumerate(poses):
        frames[i] = sensor.digitise(exposer.expose(pose), pose.gain, noise_rng)
        yield Progress(share + (1 - share) * (i + 1) / len(poses), "exposing the frames")
    return SimulatedSequence(settings, scene, poses, frames)


def simulated(settings: SimulationSettings, scene: Scene | None = None) -> SimulatedSequence:
    """Simulate a sequence without looking at the progress; see `simulate`."""
    return result_of(simulate(settings, scene))
