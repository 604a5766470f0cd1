"""What a sequence with a known scene says of its cells; read after all images are made.

The truth of a sequence is the folder ``truth/`` that `pv-inspect simulate` writes: ``truth.json``
with the place of the scene on the module plane, ``hr.png`` and ``cracks.png``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from pv_inspect.common.records import Record, checked, json_from, read_text
from pv_inspect.errors import InspectionError
from pv_inspect.evaluation.grid_record import GridRecord

__all__ = ["Truth", "read_truth"]

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
_TRUTH_BYTES = 2**26


class _Scene(Record):
    file: str
    px_per_unit: Positive
    origin_px: tuple[float, float]
    value_scale: Positive
    cracks: str | None = None


class _TruthRecord(Record):
    rows: int
    cols: int
    hr: _Scene


@dataclass(frozen=True, eq=False)
class Truth:
    """The scene of a sequence on the module plane, turned as a result is.

    Parameters
    ----------
    radiance : (h, w) float64
    cracks : (h, w) bool or None
        None if nobody has marked them.
    px_per_unit : float
    origin_px : (x, y)
        Its pixel at the origin of the module plane.
    """

    radiance: NDArray[np.float64]
    cracks: Mask | None
    px_per_unit: float
    origin_px: tuple[float, float]

    def turned(self, quarter_turns: int, size: tuple[float, float]) -> Truth:
        """Return the truth of the module turned by quarter turns, counterclockwise.

        Parameters
        ----------
        quarter_turns : int
        size : (width, height)
            Of the module before the turn, module units.
        """
        if quarter_turns % 4 == 0:
            return self
        width = self.radiance.shape[1]
        # The corner that becomes the origin is the one at the right end of the upper side.
        x = width - 1 - (self.origin_px[0] + self.px_per_unit * size[0])
        once = Truth(
            np.rot90(self.radiance),
            None if self.cracks is None else np.rot90(self.cracks),
            self.px_per_unit,
            (self.origin_px[1], x),
        )
        return once.turned(quarter_turns - 1, (size[1], size[0]))

    def on(self, grid: GridRecord, window: tuple[slice, slice]) -> Image:
        """Means of the radiance over the pixels of a part of a grid."""
        return np.asarray(self._means(self.radiance, grid, window), np.float32)

    def cracks_on(self, grid: GridRecord, window: tuple[slice, slice]) -> Mask | None:
        """Pixels of a part of a grid of which half or more is marked as a crack."""
        if self.cracks is None:
            return None
        return np.asarray(self._means(self.cracks.astype(np.float64), grid, window) >= 0.5)

    def _means(
        self, values: NDArray[np.float64], grid: GridRecord, window: tuple[slice, slice]
    ) -> NDArray[np.float64]:
        step = self.px_per_unit / grid.pixels_per_unit
        found = values
        for axis in (0, 1):
            pixels = np.arange(window[axis].start, window[axis].stop)
            centres = self.origin_px[1 - axis] + step * (pixels - grid.origin_px[1 - axis])
            found = _box_means(found, centres, step, axis)
        return found


def _box_means(
    values: NDArray[np.float64], centres: NDArray[np.float64], width: float, axis: int
) -> NDArray[np.float64]:
    """Exact means of a piecewise constant signal over boxes, along an axis."""
    moved = np.moveaxis(values, axis, 0)
    count = moved.shape[0]
    total = np.zeros((count + 1, *moved.shape[1:]))
    np.cumsum(moved, axis=0, out=total[1:])

    def upto(ends: NDArray[np.float64]) -> NDArray[np.float64]:
        ends = np.clip(ends, 0, count)
        low = np.minimum(ends.astype(int), count - 1)
        share = (ends - low)[:, None]
        return np.asarray(total[low] * (1 - share) + total[low + 1] * share)

    means = (upto(centres + 0.5 + width / 2) - upto(centres + 0.5 - width / 2)) / width
    return np.moveaxis(means, 0, axis)


def read_truth(folder: Path) -> tuple[Truth, tuple[int, int]] | None:
    """Read the truth of a sequence.

    Parameters
    ----------
    folder : Path
        Of the sequence.

    Returns
    -------
    tuple of Truth and (rows, cols), or None
        None if the sequence has no folder ``truth``.

    Raises
    ------
    InspectionError
        If it is damaged.
    """
    place = folder / "truth"
    if not place.is_dir():
        return None
    try:
        content: Any = json_from(read_text(place / "truth.json", _TRUTH_BYTES))
        record = checked(_TruthRecord, content)
    except (OSError, ValueError) as error:
        raise InspectionError(
            f"{place / 'truth.json'} is no truth of a sequence ({error}): compare without it "
            "(--no-truth), or copy it again."
        ) from None
    scene = record.hr
    values = _picture(place / scene.file).astype(np.float64) * scene.value_scale
    cracks = None if scene.cracks is None else _picture(place / scene.cracks) > 0
    if cracks is not None and cracks.shape != values.shape:
        raise InspectionError(
            f"{scene.cracks} and {scene.file} in {place} differ in size: copy them again."
        )
    return Truth(values, cracks, scene.px_per_unit, scene.origin_px), (record.rows, record.cols)


def _picture(path: Path) -> NDArray[Any]:
    found = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if path.is_file() else None
    if found is None or found.ndim != 2:
        raise InspectionError(
            f"{path} is missing or no grey picture: compare without truth (--no-truth), or copy it "
            "again."
        )
    return np.asarray(found)
