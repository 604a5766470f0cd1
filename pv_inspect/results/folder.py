"""Which files make a result folder, and who may write it."""

from __future__ import annotations

import re
from contextlib import AbstractContextManager
from pathlib import Path, PurePath

from pv_inspect.errors import InspectionError
from pv_inspect.image_files.natural_order import natural_key
from pv_inspect.storage.folders import Reservation, check_replaceable, reserved

__all__ = [
    "CELLS_FOLDER",
    "RESULT_JSON",
    "check_writable",
    "is_result_file",
    "reserve_result",
    "results_in",
    "tile_name",
]

RESULT_FILES = (
    "module_hr.tif",
    "support.tif",
    "consistency.tif",
    "cracks.tif",
    "sensor_response.tif",
    "sensor_columns.tif",
    "sensor_column_sums.tif",
    "cells.csv",
    "report.html",
    "geometry.json",
)
RESULT_JSON = "result.json"
CELLS_FOLDER = "cells"
_TILE_NAME = re.compile(r"r\d+_c\d+\.tif")
# Who saves once waits so long for another one who does.
_PATIENCE_S = 5.0


def tile_name(row: int, col: int) -> str:
    """File name of the tile of a cell; rows and columns are counted from 1, as people do."""
    return f"r{row + 1:02d}_c{col + 1:02d}.tif"


def results_in(folder: Path) -> tuple[Path, ...]:
    """Return the result folders that a folder is or directly holds, in natural order.

    Raises
    ------
    InspectionError
        If there is none, or the folder can't be read.
    """
    if (folder / RESULT_JSON).is_file():
        return (folder,)
    try:
        found = [inside for inside in folder.iterdir() if (inside / RESULT_JSON).is_file()]
    except OSError as error:
        raise InspectionError(
            f"{folder} can't be read ({error.strerror}): give a result folder of pv-inspect run."
        ) from None
    if not found:
        raise InspectionError(
            f"{folder} is no result folder and holds none ({RESULT_JSON} is missing): give the "
            "folder that pv-inspect run wrote, or one that holds such folders."
        )
    return tuple(sorted(found, key=lambda inside: natural_key(inside.name)))


def check_writable(out: Path) -> None:
    """Check, before anything is computed, that `write_result` can write to ``out``.

    Parameters
    ----------
    out : Path
        The folder that shall be made or replaced.

    Raises
    ------
    InspectionError
        If ``out`` is a file, holds things but no result, is a mount point, or nothing can be
        created beside it.
    """
    check_replaceable(out, RESULT_JSON)


def reserve_result(out: Path, patient: bool = False) -> AbstractContextManager[Reservation]:
    """Check as `check_writable` does, and keep other processes from writing there in the block.

    Parameters
    ----------
    out : Path
    patient : bool
        Wait some seconds for another one who is writing.

    Raises
    ------
    InspectionError
        As `check_writable`, or if another process is writing there; the sentence says which.
    """
    return reserved(out, RESULT_JSON, is_result_file, _PATIENCE_S if patient else 0.0)


def is_result_file(path: PurePath) -> bool:
    """Whether a path inside a result folder is one that `write_result` writes."""
    name, *rest = path.parts
    if not rest:
        return name in (RESULT_JSON, *RESULT_FILES, CELLS_FOLDER)
    return name == CELLS_FOLDER and _TILE_NAME.fullmatch("/".join(rest)) is not None
