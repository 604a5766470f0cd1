"""Result folders as far as a camera profile needs them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def written_result(folder: Path, **changes: Any) -> Path:
    """What ``result.json`` says, as far as a profile needs it and the record wants it."""
    record: dict[str, Any] = {
        "format": 2,
        "layout": {"rows": 2, "cols": 3, "cell_aspect": 1.0},
        "camera": {
            "K": [[768.0, 0, 320.0], [0, 768.0, 255.0], [0, 0, 1]],
            "kappa": -0.2,
            "kappa_error": 0.002,
            "principal_point_error_px": 0.5,
        },
        "frames": [
            {"file": "a.tif", "used": False, "why": "black", "crossings_px": None, "H": None,
             "gain": None, "offset": None, "rms": None}
        ],
        "settings": {},
        "origin_px": [0.0, 0.0],
        "pixels_per_cell": [100.0, 100.0],
        "magnification": 3.0,
        "crack_threshold": 0.5,
        "crack_detector": "network",
        "prior_weight": 1.0,
        "psf_sigma_lr_px": 0.5,
        "psf": {"error_lr_px": 0.03, "evidence": "borders and pixels", "shape": "gaussian"},
        "vignetting": {"coefficients": [-0.15], "deviations": [0.01]},
        "frame_px": [640, 512],
        "solver": {"objective": [1.0], "iterations": 3, "converged": True},
        "seconds": {},
        "warnings": [],
        "versions": {},
    }  # fmt: skip
    for name, value in changes.items():
        record[name] = {**record[name], **value} if isinstance(value, dict) else value
    folder.mkdir()
    (folder / "result.json").write_text(json.dumps(record))
    return folder
