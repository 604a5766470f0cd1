"""Reading a result folder, with everything in it checked."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pv_inspect.cells import cut_cells
from pv_inspect.common.csv_tables import csv_lines
from pv_inspect.common.records import checked, json_from, read_text
from pv_inspect.cracks import CellFeatures, CrackMap
from pv_inspect.cracks.features import from_texts
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.image_files.stored import stored_floats, stored_shape
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.inspection.stored import StoredResult
from pv_inspect.reconstruction.cell_sight import CellSight
from pv_inspect.reconstruction.psf_estimate import PsfEstimate
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.registration.registration import Registration
from pv_inspect.results.folder import RESULT_JSON
from pv_inspect.results.records import FrameRecord, ResultRecord, settings_of
from pv_inspect.storage.folders import read_steadily, recovered

__all__ = ["check_unchanged", "read_result"]


def read_result(folder: Path) -> Inspection:
    """Read a result folder: what can be looked at without the frames.

    Crossing points, calibration and what was found out about the sensor are of use only together
    with the frames: `pv_inspect.results.resume.resume` brings them.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    Inspection
        Without a sequence; ``stored`` says where it was read.

    Raises
    ------
    InspectionError
        If the folder is no result, or a file of it is missing or damaged.
    """
    folder = recovered(folder)
    return read_steadily(folder, lambda: _read_result(folder))


def _read_result(folder: Path) -> Inspection:
    path = folder / RESULT_JSON
    try:
        there = path.is_file()
    except OSError as error:  # no permission, or a name that is too long
        raise InspectionError(
            f"{folder} can't be read ({error.strerror}): give the folder that `pv-inspect run "
            "--out` wrote."
        ) from None
    if not there:
        raise InspectionError(
            f"{folder} is no result folder ({RESULT_JSON} is missing): give the folder that "
            "`pv-inspect run --out` wrote."
        )
    with _damaged(path):
        content, record = _record_in(path)
        layout = ModuleLayout(**record.layout.model_dump())
        camera = Camera(np.array(record.camera.K, np.float64), record.camera.kappa)
        settings = settings_of(record.settings, record.format)
    grid = HrGrid(
        layout,
        record.pixels_per_cell[0],
        record.origin_px,
        _shape_of(folder / "module_hr.tif"),
        record.magnification,
    )
    with _damaged(path):
        _check_place(grid)
    probability = _read_image(folder / "cracks.tif", grid.shape)
    with _damaged(folder / "cells.csv"):
        cells = _cells_from(read_text(folder / "cells.csv"), layout)
    reconstruction = Reconstruction(
        _read_image(folder / "module_hr.tif", grid.shape),
        _read_image(folder / "support.tif", grid.shape, gaps=True),
        grid,
        _known(record.prior_weight),
        _known(record.psf_sigma_lr_px),
        tuple(map(_known, record.solver.objective)),
        record.solver.converged,
        _read_image(folder / "consistency.tif", grid.shape, gaps=True),
        tuple(_known(frame.residual) for frame in record.frames),
        tuple(frame.motion_px_deg or (0.0, 0.0) for frame in record.frames),
        record.solver.iterations,
        tuple((_known(weight), _known(error)) for weight, error in record.lambda_curve),
        prior=settings.prior,
        sight=_sight(cells, layout),
        psf=_psf(record),
    )
    other = record.runner_up
    return Inspection(
        None,
        settings,
        layout,
        registration=replace(
            _registration(layout, camera, record.frames), camera_errors=record.camera.errors
        ),
        reconstruction=reconstruction,
        tiles=cut_cells(reconstruction),
        cracks=CrackMap(
            probability,
            record.crack_threshold,
            record.crack_detector,
            cells,
            record.crack_least_extent_cells,
        ),
        seconds={stage: t for stage, t in record.seconds.items() if stage != "total"},
        warnings=tuple(record.warnings),
        layout_guessed=record.layout_guessed,
        runner_up=None if other is None else ModuleLayout(**other.model_dump()),
        gaps_found=record.gaps_found,
        doubts=tuple(record.doubts),
        # With what an earlier version did not say.
        stored=StoredResult(folder, content),
    )


def _psf(record: ResultRecord) -> PsfEstimate | None:
    sigma, says = record.psf_sigma_lr_px, record.psf
    if says is None or sigma is None:
        return None
    return says.estimate(sigma)


def _registration(layout: ModuleLayout, camera: Camera, frames: list[FrameRecord]) -> Registration:
    def values(name: str, otherwise: float) -> NDArray[np.float64]:
        found = (getattr(frame, name) for frame in frames)
        return np.array([otherwise if value is None else value for value in found], np.float64)

    nowhere = np.full((3, 3), np.nan)
    return Registration(
        layout,
        camera,
        np.array([nowhere if f.H is None else f.H for f in frames], np.float64),
        np.array([f.used for f in frames]),
        tuple(f.why for f in frames),
        values("gain", 1.0),
        values("offset", 0.0),
        values("rms", np.nan),
    )


def _known(value: float | None) -> float:
    return float("nan") if value is None else float(value)


def _record_in(path: Path) -> tuple[dict[str, Any], ResultRecord]:
    """All that ``result.json`` says, with what an earlier version did not; and what is checked."""
    content = json_from(read_text(path))
    record = checked(ResultRecord, content)
    return {**content, **record.model_dump(mode="json")}, record


def check_unchanged(stored: StoredResult) -> None:
    """Check that a result folder still holds the result that was read from it.

    Parameters
    ----------
    stored : StoredResult

    Raises
    ------
    InspectionError
        If another run has replaced it.
    """
    path = stored.folder / RESULT_JSON
    with _damaged(path):
        now, _ = _record_in(path)
    if now != stored.record:
        raise InspectionError(
            f"{stored.folder} holds another result than the one that was opened: open it again."
        )


def _shape_of(path: Path) -> tuple[int, int]:
    """Size of a stored image, without reading its pixels."""
    with _damaged(path):
        return stored_shape(path)


def _read_image(path: Path, shape: tuple[int, int], gaps: bool = False) -> NDArray[np.float32]:
    """Read an image of a known size; ``gaps``: it may have pixels that are not known."""
    with _damaged(path):
        if stored_shape(path) != shape:
            raise ValueError("it is of another size than the module image or its grid")
        image = stored_floats(path)
        if np.isinf(image).any() or (not gaps and np.isnan(image).any()):
            raise ValueError("it has pixels that are no numbers")
    return image


def _check_place(grid: HrGrid) -> None:
    """Refuse a grid whose cells do not lie on its image."""
    rows, cols = grid.layout.rows, grid.layout.cols
    corners = [grid.cell_slices(0, 0), grid.cell_slices(rows - 1, cols - 1)]
    (first_y, first_x), (last_y, last_x) = corners
    height, width = grid.shape
    if min(first_y.start, first_x.start) < 0 or last_y.stop > height or last_x.stop > width:
        raise ValueError(
            f"origin_px and pixels_per_cell put {rows} x {cols} cells beyond the image of {width} "
            f"x {height} px"
        )


def _cells_from(text: str, layout: ModuleLayout) -> tuple[CellFeatures, ...]:
    cells = tuple(
        from_texts(int(line["row"]) - 1, int(line["col"]) - 1, line) for line in csv_lines(text)
    )
    if [(cell.row, cell.col) for cell in cells] != list(np.ndindex(layout.rows, layout.cols)):
        raise ValueError(
            f"it has not one line for each of {layout.rows} x {layout.cols} cells, row by row"
        )
    for cell in cells:
        for name in ("crack_length_cells", "crack_score", "dark_area_share", "mean_intensity"):
            if not abs(getattr(cell, name)) < 1e9:
                raise ValueError(f"row {cell.row + 1}, column {cell.col + 1}: {name} is no number")
    return cells


def _sight(cells: tuple[CellFeatures, ...], layout: ModuleLayout) -> CellSight | None:
    """How well the cells were seen; None if an earlier version did not say."""
    seen = np.array([(cell.crack_detail, cell.edge_blur) for cell in cells], np.float32)
    detail, blur = seen.reshape(layout.rows, layout.cols, 2).transpose(2, 0, 1)
    return None if np.isnan(detail).all() else CellSight(detail, blur)


@contextmanager
def _damaged(path: Path) -> Iterator[None]:
    """Turn whatever a damaged file raises into one sentence."""
    try:
        yield
    except FileNotFoundError:
        raise InspectionError(
            f"{path} is missing, so that the result is not whole: run the inspection again."
        ) from None
    except Exception as error:  # what the decoders of damaged files raise is not documented
        detail = f"no entry {error}" if isinstance(error, KeyError) else str(error)
        raise InspectionError(
            f"{path} is damaged or of another version ({detail}): run the inspection again."
        ) from None
