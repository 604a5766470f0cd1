"""Modules under a drone, views of which the border of the image cuts, and what such a run gives.

What `frames_that_cut.py` and `partial_views.py` share.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.work import result_of
from pv_inspect.registration.registration import Registration
from pv_inspect.simulate import SimulatedSequence, SimulationSettings
from pv_inspect.simulate.exposure import (
    Exposer,
    Pose,
    Sensor,
    camera_matrix,
    project_points,
)
from pv_inspect.simulate.scene import render_scene

__all__ = ["drawn_module", "made", "rms_px", "shown"]

LAYOUTS = ((3, 6), (4, 6), (6, 6), (6, 10), (6, 12), (5, 9))


def drawn_module(
    seed: int, rng: np.random.Generator, n_frames: int, kappa: tuple[float, float], tilted: bool
) -> SimulationSettings:
    """Draw a module and a camera.

    Parameters
    ----------
    seed : int
    rng : numpy.random.Generator
    n_frames : int
    kappa : tuple of float
        Its range.
    tilted : bool
        Whether the settings say how the camera is held, for `choose_poses`.
    """
    rows, cols = LAYOUTS[int(rng.integers(len(LAYOUTS)))]
    module: dict[str, Any] = {
        "seed": seed, "rows": rows, "cols": cols, "n_frames": n_frames, "width": 400, "height": 320,
        "wafer": str(rng.choice(["multi", "mono"])), "busbars": int(rng.integers(2, 7)),
        "busbar_style": str(rng.choice(["solid", "dashed"])),
        "crack_share": float(rng.uniform(0, 0.5)),
        "dark_cell_share": float(rng.choice([0.0, 0.03])),
        "kappa": float(rng.uniform(*kappa)), "psf_sigma_px": float(rng.uniform(0.4, 0.7)),
        "pixels_per_unit": 150, "supersampling": 3,
    }  # fmt: skip
    if tilted:
        module |= {
            "tilt_deg": float(rng.uniform(0, 15)), "tilt_axis_deg": float(rng.uniform(0, 360)),
            "roll_deg": float(rng.uniform(-6, 6)), "fill": float(rng.uniform(0.75, 0.9)),
            "jitter_px": 3.0, "motion_blur_px": 0.3,
        }  # fmt: skip
    return SimulationSettings(**module, exposure=float(rng.choice([0.4, 0.7])))


def shown(settings: SimulationSettings, pose: Pose, beyond: float = 0.0) -> NDArray[np.bool_]:
    """Which places of the module, and of what lies beyond it by so many cells, a view shows.

    Returns
    -------
    (41, 41) bool
    """
    (width, height), end = settings.layout.size, np.array([settings.width, settings.height]) - 1
    x, y = (np.linspace(-beyond, size + beyond, 41) for size in (width, height))
    places = np.stack(np.meshgrid(x, y), axis=-1)
    seen = project_points(camera_matrix(settings), settings.kappa, pose.H, places.reshape(-1, 2))
    with np.errstate(invalid="ignore"):
        inside = np.all((seen >= 0) & (seen <= end), axis=1)
    return np.asarray(inside.reshape(places.shape[:2]))


def made(settings: SimulationSettings, poses: tuple[Pose, ...]) -> SimulatedSequence:
    """Expose the drawn views."""
    module, pattern, noise = np.random.default_rng(settings.seed).spawn(3)
    scene = result_of(render_scene(settings, module))
    exposer, sensor = Exposer(settings, scene), Sensor(settings, pattern)
    frames = [sensor.digitise(exposer.expose(pose), pose.gain, noise) for pose in poses]
    return SimulatedSequence(settings, scene, poses, np.array(frames))


def rms_px(registration: Registration, true: SimulatedSequence) -> float:
    """RMS distance of the crossing points from the truth, where frames show them."""
    ways = np.zeros(2)
    used = np.flatnonzero(registration.used)
    last = np.array([true.settings.width, true.settings.height]) - 1
    for i in used:
        wanted = true.crossings_px(int(i))
        seen = np.all((wanted >= 0) & (wanted <= last), axis=1)
        points = registration.crossings_px(int(i))
        # A module looks the same when turned by 180 degrees.
        ways += [np.square(p - wanted)[seen].sum(axis=1).mean() for p in (points, points[::-1])]
    # The other way round, points may lie where no ray comes from.
    return float(np.sqrt(np.nanmin(ways) / len(used)))
