"""What ``result.json`` says of an inspection."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from pv_inspect.calibration.focal_length import focal_length_source
from pv_inspect.common.versions import versions
from pv_inspect.cracks import CLASS_RULE, CrackMap
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.reconstruction.psf_estimate import PsfEstimate, PsfMeasurements
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.registration.registration import Registration
from pv_inspect.results.records import ResultRecord

__all__ = ["plain_types", "result_record"]


def result_record(inspection: Inspection) -> dict[str, Any]:
    """Return the content of ``result.json``: plain types, None for what is not a number."""
    registration, reconstruction = inspection.need(Registration), inspection.need(Reconstruction)
    cracks, layout = inspection.need(CrackMap), inspection.layout
    photometry = reconstruction.photometry
    frames = []
    for i, name in enumerate(inspection.names):
        used = bool(registration.used[i])
        frames.append(
            {
                "file": name,
                "used": used,
                "why": "" if used else registration.why[i],
                "crossings_px": registration.crossings_px(i) if used else None,
                "H": registration.homographies[i] if used else None,
                "gain": registration.gain[i] if used else None,
                "offset": registration.offset[i] if used else None,
                "rms": registration.rms[i] if used else None,
                "residual": reconstruction.residual_rms[i],
                "motion_px_deg": reconstruction.motion[i] if used else None,
                "edits": _edits(inspection, i),
            }
        )
    seconds = dict(inspection.seconds)
    psf = reconstruction.psf
    record = {
        "format": ResultRecord.newest_format,
        **reconstruction.grid.to_dict(),
        "frame_px": inspection.frames.shape[::-1],
        "rows": layout.rows,
        "cols": layout.cols,
        "layout": asdict(layout),
        "camera": {
            "K": registration.camera.K,
            "kappa": registration.camera.kappa,
            **_camera_errors(inspection),
            "focal_length": focal_length_source(
                registration.camera, inspection.frames.shape, inspection.settings
            ),
        },
        "frames": frames,
        "settings": inspection.settings.model_dump(mode="json"),
        "prior_weight": reconstruction.prior_weight,
        "psf_sigma_lr_px": reconstruction.psf_sigma_lr_px,
        "psf": None if psf is None else _psf(psf),
        "solver": {
            "objective": reconstruction.objective,
            "iterations": reconstruction.iterations,
            "converged": reconstruction.converged,
        },
        "lambda_curve": reconstruction.lambda_curve,
        "vignetting": None if photometry is None else vars(photometry.vignetting),
        "defective_pixels": np.argwhere(inspection.frames.defects),
        "layout_guessed": inspection.layout_guessed,
        "runner_up": None if inspection.runner_up is None else asdict(inspection.runner_up),
        "gaps_found": inspection.gaps_found,
        "lock_in": inspection.frames.lock_in is not None,
        "crack_detector": cracks.detector,
        "crack_threshold": cracks.threshold,
        "crack_least_extent_cells": cracks.least_extent_cells,
        "cells": [
            {**asdict(cell), "crack_class": cell.crack_class, "marked_class": cell.marked_class}
            for cell in cracks.cells
        ],
        "class_rule": CLASS_RULE.splitlines(),
        "seconds": {**seconds, "total": sum(seconds.values())},
        "doubts": list(inspection.doubts),
        "warnings": list(inspection.warnings),
        "versions": versions(),
    }
    plain: dict[str, Any] = plain_types(record)
    return plain


def _psf(psf: PsfEstimate) -> dict[str, Any]:
    measured = psf.measured or PsfMeasurements()
    return {
        "error_lr_px": psf.error,
        "evidence": psf.evidence,
        "shape": psf.shape,
        "borders_lr_px": measured.borders,
        "pixels_lr_px": measured.pixels,
    }


def _camera_errors(inspection: Inspection) -> dict[str, float]:
    """How well kappa and the principal point are known: by gaps, or else by crossing points."""
    errors, calibration = inspection.need(Registration).camera_errors, inspection.calibration
    if errors is not None:
        return {"kappa_error": errors[0], "principal_point_error_px": errors[1]}
    if calibration is not None and calibration.kappa_std > 0:
        return {"kappa_error": calibration.kappa_std}
    return {}


def _edits(inspection: Inspection, i: int) -> list[dict[str, Any]]:
    """Crossing points of frame i that a person has set, or removed: then ``px`` is None."""
    if inspection.crossings is None:
        return []
    frame, cols = inspection.crossings.frames[i], inspection.layout.cols + 1
    return [
        {
            "row": int(k) // cols,
            "col": int(k) % cols,
            "px": frame.points_px[k] if frame.measured[k] else None,
        }
        for k in np.flatnonzero(frame.by_hand)
    ]


def plain_types(value: Any) -> Any:
    """Nested value with plain Python types; NaN and infinity become None: JSON has neither."""
    if isinstance(value, dict):
        return {str(key): plain_types(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain_types(value.tolist())
    if isinstance(value, list | tuple):
        return [plain_types(item) for item in value]
    if isinstance(value, np.generic):
        return plain_types(value.item())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value
