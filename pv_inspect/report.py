"""One self-contained HTML page about one module, for a person to read, print and keep."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from datetime import date
from typing import Any

import cv2
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from numpy.typing import NDArray

from pv_inspect.calibration import focal_length_source
from pv_inspect.cracks import CLASS_RULE, CellFeatures, CrackMap, crack_marks
from pv_inspect.cracks.wording import CLASS_WORDS, EARNED_RULE, length_text, tooltip
from pv_inspect.errors import InspectionError
from pv_inspect.layout import HrGrid
from pv_inspect.pipeline import Inspection
from pv_inspect.settings import Settings
from pv_inspect.versions import versions

__all__ = ["render_report"]

_FOCAL_LENGTH = {
    "given": "given",
    "identified": "found from the frames",
    "convention": "by convention: the frames do not tell it, and nothing depends on it",
}
# Longest sides, pixels: a 4x module fits into a page of some hundred kilobytes.
_MODULE_PX = 1600
_SUPPORT_PX = 480
_CLOSE_UP_PX = 280
_N_CLOSE_UPS = 12
# Vermilion of the Okabe-Ito palette (RGB): seen on grey by colour-blind readers too.
_CRACK_RGB = (213, 94, 0)


@dataclass(frozen=True)
class _Box:
    """A cell on the module picture, in its pixels."""

    cell: CellFeatures
    x: float
    y: float
    width: float
    height: float


def render_report(inspection: Inspection) -> str:
    """Render the report of one module.

    Parameters
    ----------
    inspection : Inspection
        Complete.

    Returns
    -------
    str
        HTML with everything in it: pictures, style and the script that sorts the table.

    Raises
    ------
    InspectionError
        If the inspection is not complete.
    """
    if not inspection.complete:
        raise InspectionError(
            "This inspection is not complete, so that no report can be written: run it to its end."
        )
    environment = Environment(
        loader=PackageLoader("pv_inspect"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("report.html.j2").render(**_content(inspection))


def _content(inspection: Inspection) -> dict[str, Any]:
    registration, reconstruction = inspection.registration, inspection.reconstruction
    cracks, tiles = inspection.cracks, inspection.tiles
    assert registration is not None
    assert reconstruction is not None
    assert cracks is not None
    assert tiles is not None
    grid, layout = reconstruction.grid, inspection.layout
    low, high = _contrast(reconstruction.image, grid)
    picture = _grey(_shrunk(reconstruction.image, _MODULE_PX), low, high)
    worst = sorted(
        cracks.cells,
        key=lambda cell: (-cell.crack_length_cells, -cell.crack_score, cell.row, cell.col),
    )
    suspected = [cell for cell in worst if cell.crack_suspected]
    marks = _marks(cracks, grid)
    close_ups = []
    for cell in suspected[:_N_CLOSE_UPS]:
        where = grid.cell_slices(cell.row, cell.col)
        crop = _shrunk(reconstruction.image[where], _CLOSE_UP_PX)
        close_ups.append(
            {
                "cell": cell,
                "image": _jpeg(_grey(crop, low, high)),
                "overlay": _overlay(cracks.probability[where], marks[where], _CLOSE_UP_PX),
            }
        )
    seconds = inspection.seconds
    rms = np.asarray(reconstruction.residual_rms, np.float64)[registration.used]
    return {
        "title": inspection.sequence.source.resolve().name,
        "source": str(inspection.sequence.source),
        "layout": layout,
        "grid": grid,
        "n_frames": len(inspection.sequence),
        "n_used": int(registration.used.sum()),
        "rms_median": float(np.median(rms)) if rms.size else float("nan"),
        "suspected": suspected,
        "dark": [cell for cell in cracks.cells if cell.dark],
        "unsure": [cell for cell in cracks.cells if cell.crack_class == "unsure"],
        "in_mm": inspection.settings.cell_width_mm is not None,
        "length_text": length_text,
        "tooltip": tooltip,
        "class_order": {name: k for k, name in enumerate(reversed(CLASS_WORDS))},
        "class_rule": CLASS_RULE,
        "earned_rule": EARNED_RULE,
        "date": date.today().isoformat(),
        "cells": worst,
        "close_ups": close_ups,
        "module": _jpeg(picture),
        "overlay": _overlay(cracks.probability, marks, _MODULE_PX),
        "boxes": _boxes(cracks.cells, grid, picture.shape[1] / grid.shape[1]),
        "picture_size": picture.shape[1::-1],
        "consistency": _jpeg(_grey(_shrunk(reconstruction.consistency, _SUPPORT_PX), 0.5, 3.0)),
        "support": _jpeg(_grey(_shrunk(reconstruction.support, _SUPPORT_PX), 0.0, 1.0)),
        "frames": _frame_rows(inspection),
        "camera": registration.camera,
        "focal_length": _FOCAL_LENGTH[
            focal_length_source(registration.camera, inspection.sequence.shape, inspection.settings)
        ],
        "psf_sigma": reconstruction.psf_sigma_lr_px,
        "prior_weight": reconstruction.prior_weight,
        "lambda_plot": _lambda_plot(reconstruction.lambda_curve, reconstruction.prior_weight),
        "cracks": cracks,
        "settings": _setting_rows(inspection),
        "seconds": seconds,
        "total_seconds": sum(seconds.values()),
        "versions": versions(),
        "warnings": inspection.warnings,
    }


def _lambda_plot(curve: tuple[tuple[float, float], ...], chosen: float) -> dict[str, Any] | None:
    """Points of the held-out curve in a box of 300 x 110; None if there is no curve."""
    if len(curve) < 2:
        return None
    weights, errors = np.log(np.array(curve)).T
    span_x, span_y = np.ptp(weights), max(float(np.ptp(errors)), 1e-9)
    x = 20 + 260 * (weights - weights.min()) / span_x
    y = 90 - 75 * (errors - errors.min()) / span_y
    at = 20 + 260 * (np.log(chosen) - weights.min()) / span_x
    return {
        "points": " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True)),
        "chosen": float(np.clip(at, 20, 280)),
        "low": curve[0][0],
        "high": curve[-1][0],
    }


def _frame_rows(inspection: Inspection) -> list[dict[str, Any]]:
    registration, reconstruction = inspection.registration, inspection.reconstruction
    assert registration is not None
    assert reconstruction is not None
    rms = np.where(registration.used, reconstruction.residual_rms, np.nan).astype(np.float64)
    longest = float(np.nanmax(rms)) if np.isfinite(rms).any() else 1.0
    return [
        {
            "file": name,
            "used": bool(registration.used[i]),
            "why": registration.why[i],
            "rms": float(rms[i]),
            "bar": 100 * float(rms[i]) / longest if np.isfinite(rms[i]) and longest > 0 else 0.0,
            "gain": float(registration.gain[i]),
            "offset": float(registration.offset[i]),
            "motion": reconstruction.motion[i],
        }
        for i, name in enumerate(inspection.sequence.names)
    ]


def _setting_rows(inspection: Inspection) -> list[dict[str, str]]:
    """Every setting with the value that was used; what the user left open was found otherwise."""
    registration, reconstruction = inspection.registration, inspection.reconstruction
    assert registration is not None
    assert reconstruction is not None
    layout, camera = inspection.layout, registration.camera
    found = {
        "rows": f"{layout.rows}, from module.json",
        "cols": f"{layout.cols}, from module.json",
        "cell_aspect": f"{layout.cell_aspect:g}",
        "dark_frame": "none",
        "flat_frame": "none",
        "kappa": f"{camera.kappa:+.4f}, fitted",
        "focal_length_px": f"{camera.K[0, 0]:.0f}",
        "psf_sigma_lr_px": f"{reconstruction.psf_sigma_lr_px:.2f}, estimated",
    }
    rows = []
    for name, about in Settings.model_fields.items():
        value = getattr(inspection.settings, name)
        unit = Settings.unit_of(name)
        rows.append(
            {
                "name": name,
                "value": found.get(name, "not given")
                if value is None
                else f"{value}, given"
                if name in found
                else str(value),
                "unit": "" if unit in ("1", "file") else unit,
                "description": about.description or "",
            }
        )
    return rows


def _boxes(cells: tuple[CellFeatures, ...], grid: HrGrid, scale: float) -> list[_Box]:
    found = []
    for cell in cells:
        y, x = grid.cell_slices(cell.row, cell.col)
        width, height = scale * (x.stop - x.start), scale * (y.stop - y.start)
        inset = 0.015 * min(width, height)  # frames of neighbours stay apart
        left, top = scale * x.start + inset, scale * y.start + inset
        found.append(_Box(cell, left, top, width - 2 * inset, height - 2 * inset))
    return found


def _marks(cracks: CrackMap, grid: HrGrid) -> NDArray[np.float32]:
    """1 where a mark counts as suspected crack."""
    marks = np.zeros(grid.shape, np.float32)
    for cell in cracks.cells:
        where = grid.cell_slices(cell.row, cell.col)
        if cell.crack_suspected:
            found = crack_marks(
                cracks.probability[where],
                cracks.threshold,
                grid.pixels_per_unit,
                cracks.least_extent_cells,
            )
            for mark in found:
                marks[where][mark] = 1.0
    return marks


def _contrast(image: NDArray[np.float32], grid: HrGrid) -> tuple[float, float]:
    """Black and white of the pictures: the range of the module, without its extreme pixels."""
    first, last = (
        grid.cell_slices(0, 0),
        grid.cell_slices(grid.layout.rows - 1, grid.layout.cols - 1),
    )
    inside = image[first[0].start : last[0].stop, first[1].start : last[1].stop]
    low, high = np.percentile(inside[np.isfinite(inside)], [0.5, 99.5])
    return float(low), float(max(high, low + 1e-6))


def _shrunk(image: NDArray[np.float32], longest: int) -> NDArray[np.float32]:
    scale = longest / max(image.shape)
    if scale >= 1:
        return image
    size = (max(round(image.shape[1] * scale), 1), max(round(image.shape[0] * scale), 1))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)


def _peaks(probability: NDArray[np.float32], longest: int) -> NDArray[np.float32]:
    """Shrunk with the maximum of what falls together: a crack must not fade away."""
    size = int(np.ceil(max(probability.shape) / longest)) | 1
    return _shrunk(np.asarray(cv2.dilate(probability, np.ones((size, size))), np.float32), longest)


def _grey(image: NDArray[np.float32], low: float, high: float) -> NDArray[np.uint8]:
    share = np.clip((np.nan_to_num(image) - low) / (high - low), 0, 1)
    return np.asarray(np.round(255 * share), np.uint8)


def _overlay(probability: NDArray[np.float32], marks: NDArray[np.float32], longest: int) -> str:
    """Marks in colour, what else the detector answers to faintly; transparent elsewhere."""
    p = np.nan_to_num(_peaks(probability, longest))
    alpha = np.where(_peaks(marks, longest) > 0.5, 60 + 160 * p, 90 * p * (p > 0.25))
    bgra = np.empty((*p.shape, 4), np.uint8)
    bgra[..., :3] = _CRACK_RGB[::-1]
    bgra[..., 3] = np.clip(alpha, 0, 255)
    return _data_url("image/png", cv2.imencode(".png", bgra, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1])


def _jpeg(picture: NDArray[np.uint8]) -> str:
    return _data_url("image/jpeg", cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 88])[1])


def _data_url(kind: str, data: NDArray[np.uint8]) -> str:
    return f"data:{kind};base64,{base64.b64encode(data.tobytes()).decode()}"
