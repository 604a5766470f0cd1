"""One self-contained HTML page about one module, for a person to read, print and keep."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from numpy.typing import NDArray

from pv_inspect.calibration import focal_length_source
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
    """A cell on the module picture, in shares of its width and height."""

    row: int
    col: int
    x: float
    y: float
    width: float
    height: float
    suspected: bool


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
    worst = sorted(cracks.cells, key=lambda cell: (-cell.crack_score, cell.row, cell.col))
    suspected = [cell for cell in worst if cell.crack_instances > 0]
    close_ups = []
    for cell in suspected[:_N_CLOSE_UPS]:
        where = grid.cell_slices(cell.row, cell.col)
        crop = _shrunk(reconstruction.image[where], _CLOSE_UP_PX)
        crack = _peaks(cracks.probability[where], _CLOSE_UP_PX)
        close_ups.append(
            {
                "cell": cell,
                "image": _jpeg(_grey(crop, low, high)),
                "overlay": _overlay(crack, cracks.threshold),
            }
        )
    seconds = inspection.seconds
    rms = np.asarray(registration.rms, np.float64)[registration.used]
    return {
        "title": inspection.sequence.source.resolve().name,
        "source": str(inspection.sequence.source),
        "layout": layout,
        "grid": grid,
        "n_frames": len(inspection.sequence),
        "n_used": int(registration.used.sum()),
        "rms_median": float(np.median(rms)) if rms.size else float("nan"),
        "suspected": suspected,
        "cells": worst,
        "close_ups": close_ups,
        "module": _jpeg(picture),
        "overlay": _overlay(_peaks(cracks.probability, _MODULE_PX), cracks.threshold),
        "boxes": _boxes(grid, {(cell.row, cell.col) for cell in suspected}),
        "picture_size": picture.shape[1::-1],
        "support": _jpeg(_grey(_shrunk(reconstruction.support, _SUPPORT_PX), 0.0, 1.0)),
        "frames": _frame_rows(inspection),
        "camera": registration.camera,
        "focal_length": _FOCAL_LENGTH[
            focal_length_source(registration.camera, inspection.sequence.shape, inspection.settings)
        ],
        "psf_sigma": reconstruction.psf_sigma_lr_px,
        "prior_weight": reconstruction.prior_weight,
        "cracks": cracks,
        "settings": _setting_rows(inspection.settings),
        "seconds": seconds,
        "total_seconds": sum(seconds.values()),
        "versions": versions(),
        "warnings": inspection.warnings,
    }


def _frame_rows(inspection: Inspection) -> list[dict[str, Any]]:
    registration = inspection.registration
    assert registration is not None
    rms = np.where(registration.used, registration.rms, np.nan).astype(np.float64)
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
        }
        for i, name in enumerate(inspection.sequence.names)
    ]


def _setting_rows(settings: Settings) -> list[dict[str, str]]:
    rows = []
    for name, about in Settings.model_fields.items():
        value = getattr(settings, name)
        rows.append(
            {
                "name": name,
                "value": "not given" if value is None else str(value),
                "unit": Settings.unit_of(name),
                "description": about.description or "",
            }
        )
    return rows


def _boxes(grid: HrGrid, suspected: set[tuple[int, int]]) -> list[_Box]:
    height, width = grid.shape
    found = []
    for row, col in np.ndindex(grid.layout.rows, grid.layout.cols):
        y, x = grid.cell_slices(row, col)
        share = (x.start / width, y.start / height)
        size = ((x.stop - x.start) / width, (y.stop - y.start) / height)
        found.append(_Box(row, col, *share, *size, (row, col) in suspected))
    return found


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


def _overlay(probability: NDArray[np.float32], threshold: float) -> str:
    """Crack pixels in colour, transparent elsewhere; faint below the threshold."""
    p = np.nan_to_num(probability)
    alpha = np.where(p >= threshold, 60 + 160 * p, 110 * p * (p > 0.4 * threshold))
    bgra = np.empty((*p.shape, 4), np.uint8)
    bgra[..., :3] = _CRACK_RGB[::-1]
    bgra[..., 3] = np.clip(alpha, 0, 255)
    return _data_url("image/png", cv2.imencode(".png", bgra, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1])


def _jpeg(picture: NDArray[np.uint8]) -> str:
    return _data_url("image/jpeg", cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 88])[1])


def _data_url(kind: str, data: NDArray[np.uint8]) -> str:
    return f"data:{kind};base64,{base64.b64encode(data.tobytes()).decode()}"
