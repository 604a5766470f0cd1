"""What results of one camera say of it, pooled into a camera profile."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pv_inspect.calibration.camera_profile import (
    CameraProfile,
    LensProfile,
    PsfProfile,
    VignettingProfile,
    conventional_kappa,
)
from pv_inspect.calibration.focal_length import conventional_focal_length
from pv_inspect.calibration.pooling import Pooled, pooled
from pv_inspect.common.records import checked, json_from, read_text
from pv_inspect.errors import InspectionError
from pv_inspect.reconstruction.psf_combination import combined_over_sequences
from pv_inspect.reconstruction.psf_estimate import PsfEstimate
from pv_inspect.results.folder import RESULT_JSON
from pv_inspect.results.records import ResultRecord, settings_of
from pv_inspect.results.sensor_evidence import pooled_pattern, pooled_pixels
from pv_inspect.settings import Settings
from pv_inspect.storage.folders import recovered

__all__ = ["pooled_profile"]

SHARED_PSF_ERROR = 0.02
"""Relative error of the blur that all sequences have in common and their scatter does not show: the
bar that the pooled blur has to keep. `benchmarks/camera_profile.py` prints what it is."""
SURE_SHAPE = 2.0 / 3.0


@dataclass(frozen=True)
class _Evidence:
    """One result."""

    name: str
    shape: tuple[int, int]
    record: ResultRecord
    settings: Settings


def pooled_profile(folders: Sequence[Path]) -> CameraProfile:
    """Pool results of one camera.

    Parameters
    ----------
    folders : sequence of Path
        Result folders, in the order of the pictures if a drift is to be told.

    Raises
    ------
    InspectionError
        If a folder is no result, or can't serve as evidence, or was made with another camera.
    """
    found = [_evidence(folder) for folder in folders]
    _check(folders, found)
    shape = found[0].shape
    notes: list[str] = []
    lens = _lens(found, shape, notes)
    psf, vignetting = _psf(found, notes), _vignetting(found, notes)
    columns = pooled_pattern([recovered(folder) for folder in folders], shape[1], notes)
    if lens is None and psf is None and vignetting is None and columns is None:
        raise InspectionError(
            "None of the results tells anything of the camera: kappa and blur were given, or could "
            "not be estimated. Give results of runs without these settings."
        )
    return CameraProfile(
        width=shape[1],
        height=shape[0],
        results=len(found),
        notes=tuple(notes),
        lens=lens,
        psf=psf,
        vignetting=vignetting,
        columns=columns,
        defective_pixels=pooled_pixels([one.record for one in found]),
    )


def _evidence(folder: Path) -> _Evidence:
    path = recovered(folder) / RESULT_JSON
    try:
        record = checked(ResultRecord, json_from(read_text(path)))
        settings = settings_of(record.settings, record.format)
    except (OSError, ValueError, InspectionError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InspectionError(
            f"{path} can't be read ({reason}): give result folders of pv-inspect run."
        ) from None
    if record.frame_px is None:
        raise InspectionError(
            f"{folder} was written by an earlier version, which did not say how well it knows the "
            "camera: run it again."
        )
    if settings.camera_profile is not None:
        raise InspectionError(
            f"{folder} was made with a camera profile and is no evidence of its own: leave it out, "
            "or run it again without --camera."
        )
    return _Evidence(str(folder), (record.frame_px[1], record.frame_px[0]), record, settings)


def _check(folders: Sequence[Path], found: Sequence[_Evidence]) -> None:
    twice = [path for path, n in Counter(folder.resolve() for folder in folders).items() if n > 1]
    if twice:
        raise InspectionError(f"{twice[0]} is given twice: give every result once.")
    for one in found:
        if one.shape != found[0].shape:
            raise InspectionError(
                f"The frames of {one.name} have {one.shape[1]} x {one.shape[0]} px, those of "
                f"{found[0].name} {found[0].shape[1]} x {found[0].shape[0]}: give results of one "
                "camera."
            )


def _pool(
    what: str,
    found: Sequence[_Evidence],
    says: Callable[[_Evidence], tuple[float, float] | None],
    notes: list[str],
    shared: float = 0.0,
) -> Pooled | None:
    """Pool one number; adds what is conspicuous to the notes. None if nobody tells it."""
    told = [(one.name, value) for one in found if (value := says(one)) is not None and value[1] > 0]
    if not told:
        return None
    values, errors = np.array([value for _, value in told]).T
    result = pooled(values, errors, shared)
    notes.extend(
        f"{what} of {told[k][0]} is {values[k]:.4g}, of the others {result.value:.4g}: left out"
        for k in result.outliers
    )
    if result.drift:
        notes.append(
            f"{what} drifts by {result.drift:+.2g} from the first result to the last: the camera "
            "may have changed"
        )
    return result


def _lens(
    found: Sequence[_Evidence], shape: tuple[int, int], notes: list[str]
) -> LensProfile | None:
    # The error of crossing points alone leaves out what they have in common: in 4 of 20 simulated
    # sequences kappa was 5 to 9 such errors off. It counts where no result has straight lines.
    by_lines = any(one.record.camera.errors is not None for one in found)

    def kappa(one: _Evidence) -> tuple[float, float] | None:
        camera = one.record.camera
        fixed = one.settings.kappa is not None or one.settings.calibration_file is not None
        if fixed or camera.kappa_error is None or (by_lines and camera.errors is None):
            return None
        known = conventional_kappa(camera.kappa, camera.kappa_error, camera.K[0][0], shape)
        return known.value, known.error

    def centre(axis: int) -> Callable[[_Evidence], tuple[float, float] | None]:
        def says(one: _Evidence) -> tuple[float, float] | None:
            error = one.record.camera.principal_point_error_px
            fixed = one.settings.calibration_file is not None
            return None if fixed or error is None else (one.record.camera.K[axis][2], error)

        return says

    pool = _pool("kappa", found, kappa, notes)
    if pool is None:
        return None
    x, y = (_pool(f"the principal point's {'xy'[k]}", found, centre(k), notes) for k in (0, 1))
    known = x is not None and y is not None
    return LensProfile(
        focal_length_px=conventional_focal_length(shape),
        kappa=pool.value,
        kappa_error=pool.error,
        principal_point_px=(x.value, y.value) if x and y else None,
        principal_point_error_px=max(x.error, y.error) if known and x and y else None,
    )


def _psf(found: Sequence[_Evidence], notes: list[str]) -> PsfProfile | None:
    told: dict[str, tuple[PsfEstimate, float]] = {}
    for one in found:
        value, says = one.record.psf_sigma_lr_px, one.record.psf
        if value and says and says.error_lr_px > 0 and says.evidence not in ("given", "typical"):
            per_unit = one.record.pixels_per_cell[0] / one.record.magnification
            told[one.name] = says.estimate(value), per_unit

    def sigma(one: _Evidence) -> tuple[float, float] | None:
        return (told[one.name][0].sigma, told[one.name][0].error) if one.name in told else None

    pool = _pool("the blur [LR px]", found, sigma, notes)
    if pool is None:
        return None
    values = list(told.values())
    likely, error = combined_over_sequences(
        [values[k] for k in range(len(values)) if k not in pool.outliers]
    )
    shapes = Counter(
        one.record.psf.shape
        for one in found
        if one.record.psf is not None and one.record.psf.shape != "unknown"
    )
    most = shapes.most_common(1)
    sure = bool(most) and most[0][1] >= SURE_SHAPE * shapes.total()
    return PsfProfile(
        sigma_lr_px=likely,
        error_lr_px=float(np.hypot(error, SHARED_PSF_ERROR * likely)),
        shape=most[0][0] if sure else "unknown",
    )


def _vignetting(found: Sequence[_Evidence], notes: list[str]) -> VignettingProfile | None:
    """Pool those with the same number of terms, of which most results have."""
    told = [
        one.record.vignetting
        for one in found
        if one.record.vignetting is not None and one.record.vignetting.coefficients
    ]
    if not told:
        return None
    terms = Counter(len(one.coefficients) for one in told).most_common(1)[0][0]
    values, errors = [], []
    for k in range(terms):

        def says(one: _Evidence, k: int = k) -> tuple[float, float] | None:
            fall = one.record.vignetting
            if fall is None or len(fall.coefficients) != terms:
                return None
            return fall.coefficients[k], fall.deviations[k]

        pool = _pool(f"coefficient {k + 1} of the vignetting", found, says, notes)
        if pool is None:
            return None
        values.append(pool.value)
        errors.append(pool.error)
    return VignettingProfile(coefficients=tuple(values), deviations=tuple(errors))
