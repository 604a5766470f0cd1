"""How an inspection shows itself in a notebook: one piece of HTML."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pv_inspect.cracks import CrackMap
from pv_inspect.cracks.wording import finger_text
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
    from pv_inspect.reconstruction.reconstruction import Reconstruction

__all__ = ["inspection_html"]

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
    n_frames = len(inspection.names)
    rows = [] if cracks is None else [("cells", cracks.counts.text)]
    if cracks is not None and (fingers := finger_text(cracks.cells)):
        rows.append(("fingers", fingers))
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
        rows += _image_rows(reconstruction)
        picture = _picture(reconstruction.image, reconstruction.grid, cracks)
    elif registration is not None:
        rows.append(_residual_row(REGISTRATION_RESIDUAL, median_text(registration.rms)))
    # Without the frames nothing can be run.
    stale = inspection.stale(inspection.settings) if inspection.sequence is not None else ()
    missing = [stage.value for stage in sorted(stale, key=lambda stage: stage.index)]
    return rendered(
        "inspection.html.j2",
        title=printable(inspection.source.resolve().name),
        picture=picture,
        rows=rows,
        missing=missing,
        doubts=inspection.doubts,
        warnings=inspection.warnings,
    )


def _picture(image: NDArray[np.float32], grid: HrGrid, cracks: CrackMap | None) -> str:
    picture = grey(shrunk(image, _MODULE_PX), *contrast_of(image, grid))
    if cracks is not None:
        overlay = crack_overlay(cracks.probability, crack_mask(cracks, grid), _MODULE_PX)
        picture = blended(picture, overlay)
    return jpeg_url(picture)


def _layout_row(layout: ModuleLayout, guessed: bool) -> _Row:
    aspect = "" if layout.cell_aspect == 1 else f" of aspect {layout.cell_aspect:g}"
    how = ", guessed" if guessed else ""
    return "module", f"{layout.rows} x {layout.cols} cells{aspect}{how}"


def _image_rows(made: Reconstruction) -> list[_Row]:
    height, width = made.grid.shape
    return [
        ("image", f"{width} x {height} pixels, {made.grid.magnification:.2f} x the frames"),
        _residual_row(RESIDUAL, median_text(made.residual_rms)),
        ("PSF sigma", f"{made.psf_sigma_lr_px:.2f} LR px"),
        ("lambda", f"{made.prior_weight:.3g}"),
    ]


def _residual_row(name: str, text: str) -> _Row:
    return name, f"{text} x noise"
