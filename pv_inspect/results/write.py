"""The result folder: written whole or not at all, and read back for the viewer."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from pv_inspect._version import __version__
from pv_inspect.cells import CellTiles
from pv_inspect.common.csv_tables import csv_text
from pv_inspect.cracks import CellFeatures, CrackMap
from pv_inspect.cracks.features import FEATURES, texts
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.reports.module_report import render_report
from pv_inspect.results.folder import (
    CELLS_FOLDER,
    RESULT_JSON,
    check_writable,
    reserve_result,
    tile_name,
)
from pv_inspect.results.geometry_record import GEOMETRY_JSON, geometry_record, source_record
from pv_inspect.results.record import plain_types, result_record
from pv_inspect.results.sensor_correction import (
    COLUMN_SUMS_TIF,
    COLUMNS_TIF,
    RESPONSE_TIF,
    packed_sums,
)
from pv_inspect.storage.folders import Reservation

__all__ = ["check_writable", "tile_name", "write_result"]


def write_result(inspection: Inspection, out: Path, reservation: Reservation | None = None) -> None:
    """Write the result folder (contract in the design), all or nothing.

    Everything is written into a folder beside ``out`` and moved into place when it is whole. An
    earlier result is replaced; files in it that this program did not write are kept.

    Parameters
    ----------
    inspection : Inspection
        Complete.
    out : Path
    reservation : Reservation, optional
        Of ``out``, from `reserve_result`; without one it is reserved now.

    Raises
    ------
    InspectionError
        If the inspection is not complete or has no frames, or the folder can't be written; then an
        earlier result is as it was.
    """
    _ = inspection.frames  # a result says where they are
    if not inspection.complete:
        raise InspectionError(
            "This inspection is not complete, so that no result can be written: run it to its end."
        )
    with nullcontext(reservation) if reservation else reserve_result(out, patient=True) as place:
        place.fill(_files(inspection, place.out))


def _files(inspection: Inspection, out: Path) -> Iterator[tuple[str, bytes]]:
    """Name and content of every file of the result in ``out``, ``result.json`` last."""
    reconstruction, cracks = inspection.need(Reconstruction), inspection.need(CrackMap)
    tiles = inspection.need(CellTiles)
    grid = reconstruction.grid
    yield "module_hr.tif", _tiff(reconstruction.image, grid, "rectified module, full scale = 1")
    yield "support.tif", _tiff(reconstruction.support, grid, "support by the frames, 0 to 1", True)
    what = "residual of the frames in units of the noise"
    yield "consistency.tif", _tiff(reconstruction.consistency, grid, what, True)
    if (photometry := reconstruction.photometry) is not None:
        what = "what a pixel of the camera makes of the light, about 1"
        yield RESPONSE_TIF, _packed(photometry.response, what)
        what = "what the columns add to every frame, full scale = 1; one row per frame"
        yield COLUMNS_TIF, _packed(photometry.offsets, what)
        if photometry.column_sums is not None:
            what = "what two halves of the frames say of the columns, for pv-inspect calibrate"
            yield COLUMN_SUMS_TIF, _packed(packed_sums(photometry.column_sums), what)
    yield "cracks.tif", _tiff(cracks.probability, grid, "crack probability, 0 to 1", True)
    for row, col in tiles.places:
        what = f"cell in row {row + 1}, column {col + 1}, full scale = 1"
        yield f"{CELLS_FOLDER}/{tile_name(row, col)}", _tiff(tiles.tile(row, col), grid, what)
    yield "cells.csv", _csv(cracks.cells).encode()
    yield "report.html", render_report(inspection).encode()
    yield GEOMETRY_JSON, _json(geometry_record(inspection))
    record = {"source": source_record(inspection.frames, out), **result_record(inspection)}
    yield RESULT_JSON, _json(record)


def _json(record: dict[str, Any]) -> bytes:
    return json.dumps(plain_types(record), indent=1, allow_nan=False).encode()


def _tiff(image: NDArray[np.float32], grid: HrGrid, what: str, pack: bool = False) -> bytes:
    px, py = grid.pixels_per_cell
    about = f"{what}; {px:g} x {py:g} pixels per cell; resolution: pixels per cell width"
    # No physical cell size is known: the resolution is stated in pixels per cell width.
    pitch = (grid.pixels_per_unit, grid.pixels_per_unit)
    return _encoded(image, about, pack, resolution=pitch, resolutionunit="NONE")


def _packed(image: NDArray[np.float32], what: str) -> bytes:
    return _encoded(image, what, pack=True)


def _encoded(image: NDArray[np.float32], about: str, pack: bool, **tags: Any) -> bytes:
    buffer = io.BytesIO()
    tifffile.imwrite(
        buffer,
        np.ascontiguousarray(image, np.float32),
        photometric="minisblack",
        compression="zlib" if pack else None,
        # Noise hardly shrinks: higher levels take longer for one percent.
        compressionargs={"level": 1} if pack else None,
        description=about,
        software=f"pv-inspect {__version__}",
        metadata=None,
        **tags,
    )
    return buffer.getvalue()


def _csv(cells: tuple[CellFeatures, ...]) -> str:
    rows: list[list[object]] = [["row", "col", "tile", *FEATURES, "crack_class", "marked_class"]]
    for cell in cells:
        tile = f"{CELLS_FOLDER}/{tile_name(cell.row, cell.col)}"
        classes = cell.crack_class, cell.marked_class
        rows.append([cell.row + 1, cell.col + 1, tile, *texts(cell), *classes])
    return csv_text(rows)
