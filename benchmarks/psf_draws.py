"""Simulated cameras of wide variety, to choose and to judge the estimate of the blur on.

The ranges hold what the eight development sequences have (their truth.json) and some more on either
side. Nothing is drawn to suit an estimator: the scene's own blur and the spread of light in the
cells vary as well.
"""

from __future__ import annotations

import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from pv_inspect.simulate import SimulationSettings, reserve_sequence, simulated, write_sequence

__all__ = ["drawn", "drawn_folder"]

# (rows, cols, cell width / cell height): about 50 LR px per cell, as in sequences of 640 x 512 px.
LAYOUTS = ((4, 6, 1.0), (4, 5, 1.0), (3, 5, 1.0), (8, 5, 2.0), (4, 7, 1.0))

SOFTEST = 0.0055
"""Largest blur of a scene, cell widths: 0.3 LR px."""


def drawn(seed: int) -> SimulationSettings:
    """Draw a camera, a module and a flight.

    Parameters
    ----------
    seed : int
    """
    rng = np.random.default_rng([seed, 15])
    rows, cols, aspect = LAYOUTS[rng.integers(len(LAYOUTS))]
    width = 320
    values: dict[str, Any] = {
        "seed": seed,
        "rows": rows,
        "cols": cols,
        "cell_aspect": aspect,
        "wafer": str(rng.choice(["multi", "mono"])),
        "busbars": int(rng.integers(2, 6)),
        "busbar_style": str(rng.choice(["solid", "dashed"])),
        "wafer_gap": rng.uniform(0.014, 0.022),
        "light_spread": rng.uniform(0.0, 0.006),
        # Up to 0.07 LR px: sharp against the pixel.
        "scene_blur": rng.uniform(0.0, 0.0014),
        "pixels_per_unit": 480,
        "n_frames": 12,
        "width": width,
        "height": 256,
        "focal_length_px": width * rng.uniform(1.0, 1.7),
        "kappa": rng.uniform(-0.3, 0.12),
        "tilt_deg": rng.uniform(3.0, 20.0),
        "tilt_axis_deg": rng.uniform(0.0, 360.0),
        "roll_deg": rng.uniform(-8.0, 8.0),
        "fill": rng.uniform(0.86, 0.95),
        "psf_sigma_px": rng.uniform(0.25, 0.8),
        "psf_shape": "disc" if rng.random() < 0.35 else "gaussian",
        # One of three moves by pixels, the others hardly.
        "motion_blur_px": rng.uniform(2.0, 4.5) if rng.random() < 0.33 else rng.uniform(0.0, 0.6),
        "supersampling": 8,
        "exposure": rng.uniform(0.3, 0.62),
        "full_well_e": float(np.exp(rng.uniform(np.log(1500.0), np.log(45000.0)))),
        "read_noise_e": rng.uniform(20.0, 40.0),
        "ambient": rng.uniform(0.01, 0.04),
        "vignetting": rng.uniform(0.1, 0.3),
        "flicker": rng.uniform(0.01, 0.07),
        "column_gain": float(np.exp(rng.uniform(np.log(0.001), np.log(0.008)))),
    }
    # Half of the scenes are soft, as the photographs of cells are that scenes are made from. A
    # generator of its own: the others stay what they were without soft ones.
    soft = np.random.default_rng([seed, 16])
    if soft.random() < 0.5:
        values["scene_blur"] = soft.uniform(0.0, SOFTEST)
    # A full well of few electrons comes with a small pattern.
    values["column_offset_e"] = values["full_well_e"] * rng.uniform(0.001, 0.007)
    return SimulationSettings(**values)


def drawn_folder(seed: int, cache: Path) -> Path:
    """Return the folder of a drawn sequence; it is simulated if the cache lacks it."""
    folder = cache / f"S{seed:02d}"
    settings = drawn(seed)
    says = folder / "settings.txt"
    if not says.is_file() or says.read_text() != str(asdict(settings)):
        shutil.rmtree(folder, ignore_errors=True)
        with reserve_sequence(folder):
            write_sequence(simulated(settings), folder)
        says.write_text(str(asdict(settings)))
    return folder
