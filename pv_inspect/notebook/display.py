"""How an inspection and a result folder show themselves in a notebook: one piece of HTML."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pv_inspect.cracks import CellCounts, CellFeatures, CrackMap
from pv_inspect.errors import printable
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.inspection.figures import REGISTRATION_RESIDUAL, RESIDUAL, median_text
from pv_inspect.reports.pictures import (
    blended,
    contrast_of,
    crack_mask,
    crack_overlay,
    grey,
    jpeg_url,
    shrunk,
)
from pv_inspect.reports.templates import rendered

if TYPE_CHECKING:
    from pv_inspect.inspection.inspection import Inspection
    from pv_inspect.results.record import Result

__all__ = ["inspection_html", "result_html"]

# Longer side of the module picture: a saved notebook stays small.
_MODULE_PX = 800

_Row = tuple[str, str]


def inspection_html(inspection: Inspection) -> str:
    """Render what an inspection knows so far.

    Parameters
    ----------
    inspection : Inspection
        Complete or not.

    Returns
    -------
    str
        Picture of the module with the cracks, numbers, stages that have not run, warnings.
    """
    registration, reconstruction = inspection.registration, inspection.reconstruction
    poses, cracks = registration or inspection.calibration, inspection.cracks
    n_frames = len(inspection.sequence)
    rows = [] if cracks is None else [_cells_row(cracks.cells)]
    rows.append(_layout_row(inspection.layout, inspection.layout_guessed))
    picture = None
    if poses is not None:
        rows.append(("frames used", f"{int(poses.used.sum())} of {n_frames}"))
        kappa = "kappa" if registration is not None else "kappa, preliminary"
        rows.append((kappa, f"{poses.camera.kappa:+.4f}"))
    elif inspection.crossings is not None:
        good = sum(not frame.why for frame in inspection.crossings.frames)
        rows.append(("module found in", f"{good} of {n_frames} frames"))
    if inspection.calibration is not None:
        px = median_text(inspection.calibration.rms_px[inspection.calibration.used])
        rows.append(("crossing points from the grid", f"{px} LR px"))
    if reconstruction is not None:
        rows += _image_rows(
            median_text(reconstruction.residual_rms),
            reconstruction.psf_sigma_lr_px,
            reconstruction.prior_weight,
            reconstruction.grid,
        )
        picture = _picture(reconstruction.image, reconstruction.grid, cracks)
    elif registration is not None:
        rows.append(_residual_row(REGISTRATION_RESIDUAL, median_text(registration.rms)))
    stale = inspection.stale(inspection.settings)
    missing = [stage.value for stage in sorted(stale, key=lambda stage: stage.index)]
    return _html(
        printable(inspection.sequence.source.resolve().name),
        picture,
        rows,
        missing,
        inspection.doubts,
        inspection.warnings,
    )


def result_html(result: Result) -> str:
    """Render a result folder that was read.

    Parameters
    ----------
    result : Result

    Returns
    -------
    str
        Picture of the module with the cracks, numbers, warnings.
    """
    used = sum(frame.used for frame in result.frames)
    residual = median_text(frame.residual for frame in result.frames)
    rows = [
        _cells_row(result.cells),
        _layout_row(result.grid.layout),
        ("frames used", f"{used} of {len(result.frames)}"),
        ("kappa", f"{result.camera.kappa:+.4f}"),
        *_image_rows(residual, result.psf_sigma_lr_px, result.prior_weight, result.grid),
    ]
    picture = _picture(result.image, result.grid, result.crack_map)
    return _html(printable(result.folder.name), picture, rows, [], result.doubts, result.warnings)


def _html(
    title: str,
    picture: str | None,
    rows: list[_Row],
    missing: list[str],
    doubts: tuple[str, ...],
    warnings: tuple[str, ...],
) -> str:
    return rendered(
        "inspection.html.j2",
        title=title,
        picture=picture,
        rows=rows,
        missing=missing,
        doubts=doubts,
        warnings=warnings,
    )


def _picture(image: NDArray[np.float32], grid: HrGrid, cracks: CrackMap | None) -> str:
    picture = grey(shrunk(image, _MODULE_PX), *contrast_of(image, grid))
    if cracks is not None:
        overlay = crack_overlay(cracks.probability, crack_mask(cracks, grid), _MODULE_PX)
        picture = blended(picture, overlay)
    return jpeg_url(picture)


def _layout_row(layout: ModuleLayout, guessed: bool = False) -> _Row:
    aspect = "" if layout.cell_aspect == 1 else f" of aspect {layout.cell_aspect:g}"
    how = ", guessed" if guessed else ""
    return "module", f"{layout.rows} x {layout.cols} cells{aspect}{how}"


def _image_rows(residual: str, psf_sigma: float, prior_weight: float, grid: HrGrid) -> list[_Row]:
    height, width = grid.shape
    return [
        ("image", f"{width} x {height} pixels, {grid.magnification:.2f} x the frames"),
        _residual_row(RESIDUAL, residual),
        ("PSF sigma", f"{psf_sigma:.2f} LR px"),
        ("lambda", f"{prior_weight:.3g}"),
    ]


def _residual_row(name: str, text: str) -> _Row:
    return name, f"{text} x noise"


def _cells_row(cells: tuple[CellFeatures, ...]) -> _Row:
    return "cells", CellCounts.of(cells).text
