"""What a run has found out about the sensor, so that a later look uses it too."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.records import checked
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.camera import Camera
from pv_inspect.image_files.stored import stored_floats, stored_shape
from pv_inspect.photometry.photometry import Photometry
from pv_inspect.photometry.vignetting import Vignetting
from pv_inspect.results.records import VignettingRecord

__all__ = [
    "COLUMNS_TIF",
    "COLUMN_SUMS_TIF",
    "RESPONSE_TIF",
    "packed_sums",
    "read_column_sums",
    "read_photometry",
]

RESPONSE_TIF = "sensor_response.tif"
COLUMNS_TIF = "sensor_columns.tif"
COLUMN_SUMS_TIF = "sensor_column_sums.tif"
# Count, light, its square, misfit and product, of each half of the frames.
_SUMS = (2, 5)


def read_photometry(
    folder: Path, record: dict[str, object], camera: Camera, n_frames: int, shape: tuple[int, int]
) -> Photometry | None:
    """Read the sensor's part in the intensities of all frames, as the run has estimated it.

    Parameters
    ----------
    folder : Path
        Result folder.
    record : dict
        Content of its ``result.json``.
    camera : Camera
        That of the result.
    n_frames : int
    shape : tuple of int
        (height, width) of a frame.

    Returns
    -------
    Photometry or None
        None if the folder has none: it was written by an earlier version.

    Raises
    ------
    InspectionError
        If a file is damaged, or of other frames.
    """
    stored = record.get("vignetting")
    if stored is None:
        return None
    found = checked(VignettingRecord, stored)
    vignetting = Vignetting(tuple(found.coefficients), tuple(found.deviations))
    response = _floats(folder / RESPONSE_TIF, shape)
    offsets = _floats(folder / COLUMNS_TIF, (n_frames, shape[1]))
    return Photometry(
        response,
        offsets,
        vignetting,
        vignetting.illumination(camera, shape),
        column_sums=read_column_sums(folder, shape[1]),
    )


def read_column_sums(folder: Path, width: int) -> NDArray[np.float32] | None:
    """Read what the frames say of the columns, `Photometry.column_sums`; None if there is nothing.

    Raises
    ------
    InspectionError
        If the file is damaged, or of other frames.
    """
    path = folder / COLUMN_SUMS_TIF
    if not path.is_file():
        return None
    return _floats(path, (_SUMS[0] * _SUMS[1], width)).reshape(*_SUMS, width)


def packed_sums(sums: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return (2, 5, width) sums as the rows of a picture."""
    return sums.reshape(-1, sums.shape[-1])


def _floats(path: Path, shape: tuple[int, int]) -> NDArray[np.float32]:
    try:
        if stored_shape(path) != shape:
            raise ValueError("it is of other frames")
        values = stored_floats(path)
        if not np.isfinite(values).all():
            raise ValueError("it has pixels that are no numbers")
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise InspectionError(
            f"{path} is damaged or missing ({reason}): run the inspection again."
        ) from None
    return values
