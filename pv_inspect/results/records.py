"""What ``result.json`` and ``geometry.json`` hold, checked before anything is made of it.

Names are those of the files. What results of earlier versions do not say has a default.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from pv_inspect.common.records import (
    Flag,
    Matrix3,
    Number,
    Pair,
    Place,
    Record,
    StoredRecord,
    Text,
    Whole,
)
from pv_inspect.cracks import OperatingPoint
from pv_inspect.reconstruction.psf_estimate import PsfEstimate, PsfMeasurements, PsfShape
from pv_inspect.settings import Settings

__all__ = ["GeometryRecord", "ResultRecord", "settings_of"]

_Open = Number | None
_OpenPair = tuple[_Open, _Open]
_OpenMatrix = tuple[tuple[_Open, _Open, _Open], tuple[_Open, _Open, _Open],
                    tuple[_Open, _Open, _Open]]  # fmt: skip
_Cells = Annotated[int, Field(strict=True, ge=1, le=1000)]
_Side = Annotated[int, Field(strict=True, ge=1, le=10**6)]
_Pixel = Annotated[int, Field(strict=True, ge=0, lt=10**6)]
_Share = Annotated[float, Field(strict=True, ge=0, le=1)]
_Above0 = Annotated[float, Field(strict=True, gt=0, le=1e5)]


_GapWidth = Annotated[float, Field(strict=True, ge=0, le=10)]
_Gap = tuple[_Cells, _GapWidth]


class LayoutRecord(Record):
    """Rows and columns of cells; see `pv_inspect.geometry.layout.ModuleLayout`."""

    rows: _Cells
    cols: _Cells
    cell_aspect: Annotated[float, Field(strict=True, ge=0.1, le=10)]
    row_gaps: tuple[_Gap, ...] = ()
    col_gaps: tuple[_Gap, ...] = ()
    cell_gap: tuple[_GapWidth, _GapWidth] = (0.0, 0.0)
    row_heights: tuple[_Gap, ...] = ()
    col_widths: tuple[_Gap, ...] = ()

    @property
    def n_crossings(self) -> int:
        """Number of crossing points, outer ones included."""
        return (self.rows + 1) * (self.cols + 1)


class CameraRecord(Record):
    """Intrinsic matrix and distortion."""

    K: Matrix3
    kappa: Number
    kappa_error: Annotated[float, Field(strict=True, ge=0, le=1e4)] | None = None
    principal_point_error_px: Annotated[float, Field(strict=True, ge=0, le=1e4)] | None = None

    @property
    def errors(self) -> tuple[float, float] | None:
        """Standard deviations of kappa and of the principal point; None if they are not known."""
        if self.kappa_error is None or self.principal_point_error_px is None:
            return None
        return self.kappa_error, self.principal_point_error_px


class EditRecord(Record):
    """A crossing point that a person has set, or removed: then ``px`` is None."""

    row: Place
    col: Place
    px: Pair | None


class FrameRecord(Record):
    """What became of a frame.

    ``crossings_px`` holds the LR pixel positions of all crossing points, None beyond the fold of
    the lens; ``H`` takes the module plane to normalised image coordinates. The frame is ``gain *
    (W f) + offset``, full-scale units. ``rms`` is the registration residual, ``residual`` that
    against the module image (see `pv_inspect.inspection.figures`), both in units of the noise.
    """

    file: Text
    used: Flag
    why: Text
    crossings_px: list[_OpenPair] | None
    H: Matrix3 | None
    gain: _Open
    offset: _Open
    rms: _Open
    residual: _Open = None
    motion_px_deg: Pair | None = None
    edits: tuple[EditRecord, ...] = ()

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        if self.used and (self.H is None or self.gain is None):
            raise ValueError("is used but has no H or gain")
        if self.H is not None and not _can_be_inverted(self.H):
            raise ValueError("has an H that can't be inverted")
        return self


class SolverRecord(Record):
    """How the reconstruction went."""

    objective: list[_Open]
    iterations: Whole
    converged: Flag


class SourceRecord(Record):
    """Where the frames lie."""

    path: Text | list[Text] | None = None
    relative: Text | list[Text | None] | None = None


class VignettingRecord(Record):
    """The fall-off of the light towards the corners: `pv_inspect.photometry.vignetting`."""

    coefficients: Annotated[tuple[Number, ...], Field(max_length=20)]
    deviations: Annotated[tuple[Number, ...], Field(max_length=20)]


class PsfRecord(Record):
    """How the optical blur is known: `pv_inspect.reconstruction.psf_estimate.PsfEstimate`."""

    error_lr_px: Annotated[float, Field(strict=True, ge=0, le=100)]
    evidence: Text
    shape: PsfShape = "unknown"
    borders_lr_px: tuple[_Above0, _Above0] | None = None
    pixels_lr_px: _Above0 | None = None

    def estimate(self, sigma_lr_px: float) -> PsfEstimate:
        """Return what it stands for, with the sigma beside it."""
        known = self.borders_lr_px is not None or self.pixels_lr_px is not None
        measured = PsfMeasurements(self.borders_lr_px, self.pixels_lr_px) if known else None
        return PsfEstimate(sigma_lr_px, self.error_lr_px, self.evidence, self.shape, measured)


def settings_of(stored: dict[str, Any], file_format: int) -> Settings:
    """Return settings as a result folder keeps them.

    Parameters
    ----------
    stored : dict
    file_format : int
        Before format 2 the default prior was called ``wbtv``, and ``second_pass`` ``second_look``.

    Raises
    ------
    InspectionError
        If a name is unknown or a value is outside its range.
    """
    if file_format < 2 and stored.get("prior") == "wbtv":
        stored = {**stored, "prior": "sparse_curvature"}
    if file_format < 2 and "second_look" in stored:
        stored = {k: v for k, v in stored.items() if k != "second_look"} | {
            "second_pass": stored["second_look"]
        }
    return Settings.create(**stored)


class ResultRecord(StoredRecord):
    """``result.json``."""

    newest_format: ClassVar[int] = 2

    layout: LayoutRecord
    camera: CameraRecord
    frames: Annotated[list[FrameRecord], Field(min_length=1)]
    settings: dict[str, Any]
    origin_px: Pair
    pixels_per_cell: tuple[_Above0, _Above0]
    magnification: _Above0
    crack_threshold: _Share
    crack_detector: Text
    crack_least_extent_cells: Annotated[float, Field(strict=True, ge=0, le=10)] = (
        OperatingPoint.least_extent_cells
    )
    prior_weight: _Open
    psf_sigma_lr_px: _Open
    psf: PsfRecord | None = None
    frame_px: tuple[_Side, _Side] | None = None
    solver: SolverRecord
    lambda_curve: tuple[_OpenPair, ...] = ()
    vignetting: VignettingRecord | None = None
    defective_pixels: tuple[tuple[_Pixel, _Pixel], ...] | None = None
    layout_guessed: bool = False
    runner_up: LayoutRecord | None = None
    gaps_found: bool = False
    lock_in: bool = False
    seconds: dict[str, Number]
    warnings: list[Text]
    doubts: tuple[Text, ...] = ()
    versions: dict[str, Text]
    source: SourceRecord = SourceRecord()

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        n = self.layout.n_crossings
        for frame in self.frames:
            if frame.crossings_px is not None and len(frame.crossings_px) != n:
                raise ValueError(
                    f"has {len(frame.crossings_px)} crossings_px in {frame.file[:40]!r}, "
                    f"{self.layout.rows} x {self.layout.cols} cells have {n}"
                )
        names = [frame.file for frame in self.frames]
        if len(set(names)) < len(names):
            raise ValueError("has two frames with the same file")
        along, across = self.pixels_per_cell
        if abs(along / self.layout.cell_aspect - across) > 0.01 * across:
            raise ValueError("has pixels_per_cell that do not go with its cell_aspect")
        return self


class FrameGeometry(Record):
    """See `pv_inspect.detection.crossings.FrameCrossings`."""

    points_px: list[_OpenPair]
    sigma_px: list[Annotated[float, Field(strict=True, ge=0, le=1e15)] | None]
    measured: list[Flag]
    why: Text
    edited: list[Flag] | None = None


class FitRecord(Record):
    """See `pv_inspect.calibration.calibrate.Calibration`."""

    homographies: list[_OpenMatrix]
    used: list[Flag]
    why: list[Text]
    rms_px: list[_Open]
    focal_convention: Flag
    kappa_std: _Open
    crossing_sigma_px: list[list[_Open]] | None = None


class GeometryRecord(StoredRecord):
    """``geometry.json``."""

    crossings: list[FrameGeometry]
    calibration: FitRecord
    camera: CameraRecord

    def misfit(self, n_crossings: int) -> str | None:
        """Say which list is not as long as a layout with so many crossings wants it."""
        fit, n = self.calibration, len(self.crossings)
        lengths = {
            f"crossings[{i}].{name}": (len(values), n_crossings)
            for i, frame in enumerate(self.crossings)
            for name, values in frame
            if isinstance(values, list)
        }
        lengths |= {
            f"calibration.{name}": (len(values), n)
            for name, values in fit
            if isinstance(values, list)
        }
        for i, row in enumerate(fit.crossing_sigma_px or ()):
            lengths[f"calibration.crossing_sigma_px[{i}]"] = (len(row), n_crossings)
        for name, (found, expected) in lengths.items():
            if found != expected:
                return f"{name} has {found} entries, expected are {expected}"
        for i, (H, used) in enumerate(zip(fit.homographies, fit.used, strict=True)):
            if used and (any(v is None for row in H for v in row) or not _can_be_inverted(H)):
                return f"calibration.homographies[{i}] can't be inverted"
        return None


def _can_be_inverted(H: Any) -> bool:
    # Those of photographs have a condition number of 1 to 1000.
    return bool(np.linalg.cond(np.array(H, np.float64)) < 1e9)
