"""What results of one camera say of its columns and defective pixels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pv_inspect.calibration.camera_profile import ColumnsProfile
from pv_inspect.photometry.pooled_columns import column_outliers, pooled_columns
from pv_inspect.results.records import ResultRecord
from pv_inspect.results.sensor_correction import read_column_sums

__all__ = ["pooled_pattern", "pooled_pixels"]

# A good pixel that is left out costs next to nothing; one that single results took for defective
# may have been dirt.
_SHARE_OF_RESULTS = 0.5
# Error that all results have in common, as a share of the pattern: the first image of a module
# takes some of it over. 8 % of the level and 16 % of the gain were missing in 10 sequences of a
# simulated camera (`benchmarks/camera_profile.py --first 43`): their scatter does not show it.
_SHARED_ERROR = 0.15
# Digits that a pattern is written with: its errors are percents.
_DIGITS = 5


def pooled_pattern(folders: Sequence[Path], width: int, notes: list[str]) -> ColumnsProfile | None:
    """Pool the column patterns; names results that do not show that of the others.

    Parameters
    ----------
    folders : sequence of Path
        Result folders, of frames of this width.
    width : int
        Of a frame, LR px.
    notes : list of str
        Gets what is conspicuous.

    Raises
    ------
    InspectionError
        If a file is damaged.
    """
    read = {folder: read_column_sums(folder, width) for folder in folders}
    told = {folder: sums for folder, sums in read.items() if sums is not None}
    each, names = list(told.values()), list(told)
    out = column_outliers(each)
    notes.extend(
        f"the columns of {names[k]} do not show the pattern of the others: left out" for k in out
    )
    pattern = pooled_columns([sums for k, sums in enumerate(each) if k not in out])
    if pattern is None:
        return None
    return ColumnsProfile(
        light=_rounded(pattern.light),
        level=_rounded(pattern.level),
        level_error=_rounded(_with_shared(pattern.level_error, pattern.level)),
        gain=_rounded(pattern.gain),
        gain_error=_rounded(_with_shared(pattern.gain_error, pattern.gain)),
    )


def pooled_pixels(records: Sequence[ResultRecord]) -> tuple[tuple[int, int], ...]:
    """Return the pixels, (row, column), that half of the results found defective."""
    told = [one.defective_pixels for one in records if one.defective_pixels is not None]
    found = Counter(pixel for pixels in told for pixel in set(pixels))
    return tuple(sorted(p for p, n in found.items() if n >= _SHARE_OF_RESULTS * len(told)))


def _with_shared(error: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.hypot(error, _SHARED_ERROR * np.sqrt(np.mean(values**2))))


def _rounded(values: NDArray[np.float64]) -> tuple[float, ...]:
    return tuple(float(f"{value:.{_DIGITS}g}") for value in values)
