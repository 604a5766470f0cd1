"""One self-contained HTML page about one module, for a person to read, print and keep."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import date
from html import escape
from typing import Any

import numpy as np

from pv_inspect.calibration.focal_length import focal_length_source
from pv_inspect.common.gap_text import gap_text
from pv_inspect.common.versions import versions
from pv_inspect.cracks import CLASS_RULE, CellFeatures, CellState, CrackMap, look_at_first, state_of
from pv_inspect.cracks.wording import (
    CLASS_WORDS,
    SUPPORT_RULE,
    class_text,
    finger_text,
    length_text,
    tooltip,
    unseen_because,
)
from pv_inspect.errors import InspectionError, printable
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.inspection.figures import median_text
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.reconstruction.in_use import values_in_use
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.reconstruction.sampling import sampling_of
from pv_inspect.registration.registration import Registration
from pv_inspect.reports.pictures import contrast_of, crack_mask, grey, jpeg_url, overlay_url, shrunk
from pv_inspect.reports.templates import rendered
from pv_inspect.settings import Settings

__all__ = ["render_report", "with_review_state"]

_REVIEW_STATE = re.compile(rb'(<span id="review-state">)[^<]*')
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
        If the inspection is not complete, or without its frames.
    """
    _ = inspection.frames
    if not inspection.complete:
        raise InspectionError(
            "This inspection is not complete, so that no report can be written: run it to its end."
        )
    return rendered("report.html.j2", **_content(inspection))


def with_review_state(page: bytes, state: str) -> bytes:
    """Return a report that says how far the review is.

    Parameters
    ----------
    page : bytes
        As written by this or an earlier version; what has no place for it stays as it is.
    state : str
        A part of a sentence.
    """
    said = escape(f"{state}.").encode()
    return _REVIEW_STATE.sub(lambda found: found[1] + said, page, 1)


def _content(inspection: Inspection) -> dict[str, Any]:
    registration, reconstruction = inspection.need(Registration), inspection.need(Reconstruction)
    cracks, sequence = inspection.need(CrackMap), inspection.frames
    grid, layout = reconstruction.grid, inspection.layout
    low, high = contrast_of(reconstruction.image, grid)
    picture = grey(shrunk(reconstruction.image, _MODULE_PX), low, high)
    worst = look_at_first(cracks.cells)
    marked = [cell for cell in worst if cell.has_marks and not cell.dark]
    marks = crack_mask(cracks, grid)
    close_ups = []
    for cell in marked[:_N_CLOSE_UPS]:
        where = grid.cell_slices(cell.row, cell.col)
        crop = shrunk(reconstruction.image[where], _CLOSE_UP_PX)
        close_ups.append(
            {
                "cell": cell,
                "image": jpeg_url(grey(crop, low, high)),
                "overlay": overlay_url(cracks.probability[where], marks[where], _CLOSE_UP_PX),
            }
        )
    seconds = inspection.seconds
    return {
        "title": printable(sequence.source.resolve().name),
        "source": printable(str(sequence.source)),
        "layout": layout,
        "grid": grid,
        "n_frames": len(sequence),
        "n_used": int(registration.used.sum()),
        "residual": median_text(reconstruction.residual_rms),
        "counts": cracks.counts,
        "fingers": finger_text(cracks.cells),
        "states": CellState,
        "state_of": state_of,
        "longest": worst[0] if worst and worst[0].crack_suspected else None,
        "n_marked": len(marked),
        "dark": [cell for cell in cracks.cells if cell.dark],
        "in_mm": inspection.settings.cell_width_mm is not None,
        "length_text": length_text,
        "class_text": class_text,
        "tooltip": tooltip,
        "class_order": {name: k for k, name in enumerate(reversed(CLASS_WORDS))},
        "class_rule": CLASS_RULE,
        "support_rule": SUPPORT_RULE,
        "unseen_because": unseen_because,
        "date": date.today().isoformat(),
        "cells": worst,
        "close_ups": close_ups,
        "module": jpeg_url(picture),
        "overlay": overlay_url(cracks.probability, marks, _MODULE_PX),
        "boxes": _boxes(cracks.cells, grid, picture.shape[1] / grid.shape[1]),
        "picture_size": picture.shape[1::-1],
        "consistency": jpeg_url(grey(shrunk(reconstruction.consistency, _SUPPORT_PX), 0.5, 3.0)),
        "support": jpeg_url(grey(shrunk(reconstruction.support, _SUPPORT_PX), 0.0, 1.0)),
        "frames": _frame_rows(inspection),
        "camera": registration.camera,
        "focal_length": _FOCAL_LENGTH[
            focal_length_source(registration.camera, sequence.shape, inspection.settings)
        ],
        "psf_sigma": reconstruction.psf_sigma_lr_px,
        "psf_known": "" if reconstruction.psf is None else reconstruction.psf.words,
        "prior_weight": f"{reconstruction.prior_weight:.3g}",
        "lambda_plot": _lambda_plot(reconstruction.lambda_curve, reconstruction.prior_weight),
        "cracks": cracks,
        "settings": _setting_rows(inspection),
        "seconds": seconds,
        "total_seconds": sum(seconds.values()),
        "versions": versions(),
        "warnings": inspection.warnings,
        "doubts": inspection.doubts,
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
    registration, reconstruction = inspection.need(Registration), inspection.need(Reconstruction)
    residual = np.where(registration.used, reconstruction.residual_rms, np.nan)
    longest = float(np.nanmax(residual)) if np.isfinite(residual).any() else 1.0
    return [
        {
            "file": name,
            "used": bool(registration.used[i]),
            "why": registration.why[i],
            "residual": float(residual[i]),
            "bar": 100 * float(residual[i]) / longest
            if np.isfinite(residual[i]) and longest > 0
            else 0.0,
            "gain": float(registration.gain[i]),
            "offset": float(registration.offset[i]),
            "motion": reconstruction.motion[i],
        }
        for i, name in enumerate(inspection.names)
    ]


def _setting_rows(inspection: Inspection) -> list[dict[str, str]]:
    """Every setting with the value that was used; what the user left open was found otherwise."""
    registration, reconstruction = inspection.need(Registration), inspection.need(Reconstruction)
    layout, camera = inspection.layout, registration.camera
    used = values_in_use(inspection.settings, registration, reconstruction)
    sampling = sampling_of(registration, inspection.frames.shape)
    hint = inspection.frames.layout_hint
    source = {
        name: "guessed from the frames"
        if inspection.layout_guessed
        else ("from module.json" if name in hint else "by default")
        for name in ("rows", "cols", "cell_aspect")
    }
    seen = "seen in the frames" if inspection.gaps_found else "by default"
    gaps = f", {'from module.json' if hint.keys() & {'row_gaps', 'col_gaps', 'cell_gap'} else seen}"
    told = hint.keys() & {"row_heights", "col_widths"}
    sizes = f", {'from module.json' if told else 'by default'}"
    found = {
        "rows": f"{layout.rows}, {source['rows']}",
        "cols": f"{layout.cols}, {source['cols']}",
        "cell_aspect": f"{layout.cell_aspect:g}, {source['cell_aspect']}",
        "row_gaps": gap_text(layout.row_gaps) + gaps,
        "col_gaps": gap_text(layout.col_gaps) + gaps,
        "cell_gap": f"{layout.cell_gap[0]:.3g}{gaps}",
        "row_heights": gap_text(layout.row_heights) + sizes,
        "col_widths": gap_text(layout.col_widths) + sizes,
        "dark_frame": "none",
        "lock_in": "no, nothing was switched"
        if inspection.frames.lock_in is None
        else "yes, found in the frames",
        "flat_frame": "none",
        "kappa": f"{used.kappa:+.4f}, fitted",
        "focal_length_px": f"{camera.K[0, 0]:.0f}",
        "psf_sigma_lr_px": f"{used.psf_sigma_lr_px:.2f}{_psf_found(reconstruction, sampling)}",
        "prior_weight": f"{used.prior_weight:.3g}, {_found(sampling, 'chosen')}",
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


def _psf_found(reconstruction: Reconstruction, sampling: float) -> str:
    """Say where the blur is from, to follow the number."""
    psf = reconstruction.psf
    if psf is None or psf.evidence == "pixels":
        return f", {_found(sampling, 'estimated')}"
    return psf.words


def _found(sampling: float, word: str) -> str:
    """Say where a value is from that the frames determine with this sampling."""
    if sampling >= 1.0:
        return word
    return "partly the usual value" if sampling else "the usual value"


def _boxes(cells: tuple[CellFeatures, ...], grid: HrGrid, scale: float) -> list[_Box]:
    found = []
    for cell in cells:
        y, x = grid.cell_slices(cell.row, cell.col)
        width, height = scale * (x.stop - x.start), scale * (y.stop - y.start)
        inset = 0.015 * min(width, height)  # frames of neighbours stay apart
        left, top = scale * x.start + inset, scale * y.start + inset
        found.append(_Box(cell, left, top, width - 2 * inset, height - 2 * inset))
    return found
