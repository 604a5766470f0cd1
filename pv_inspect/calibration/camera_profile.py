"""What is known of a camera from many results: a TOML file whose uncertainties act as priors."""

from __future__ import annotations

import json
from dataclasses import dataclass
from math import exp, sqrt
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from pv_inspect.calibration.focal_length import conventional_focal_length
from pv_inspect.common.records import Number, Record, StoredRecord, Text, Whole, checked
from pv_inspect.errors import InspectionError
from pv_inspect.settings.toml import read_toml
from pv_inspect.storage.folders import replace_file

__all__ = [
    "CameraProfile",
    "ColumnsProfile",
    "Known",
    "LensProfile",
    "PsfProfile",
    "VignettingProfile",
    "conventional_kappa",
    "read_profile",
    "write_profile",
]

# Five numbers for each of 100,000 columns.
_MOST_BYTES = 2**23

PsfShape = Literal["gaussian", "disc", "unknown"]

_Error = Annotated[float, Field(strict=True, gt=0, le=1e4)]
_NotNegative = Annotated[float, Field(strict=True, ge=0, le=1e4)]
_Side = Annotated[int, Field(strict=True, ge=1, le=10**6)]


@dataclass(frozen=True)
class Known:
    """A value and its standard deviation."""

    value: float
    error: float


class LensProfile(Record):
    """Distortion and principal point."""

    focal_length_px: Annotated[float, Field(strict=True, gt=10, le=1e6)]
    """That kappa belongs to: only kappa / f^2 has a meaning."""
    kappa: Annotated[float, Field(strict=True, ge=-1, le=1)]
    kappa_error: _Error
    principal_point_px: tuple[Number, Number] | None = None
    principal_point_error_px: _Error | None = None


class PsfProfile(Record):
    """Blur of the optics."""

    sigma_lr_px: Annotated[float, Field(strict=True, gt=0, le=10)]
    error_lr_px: _Error
    shape: PsfShape = "unknown"


class VignettingProfile(Record):
    """Fall-off of the light, see `pv_inspect.photometry.vignetting`."""

    coefficients: Annotated[tuple[Number, ...], Field(min_length=1, max_length=4)]
    deviations: Annotated[tuple[Number, ...], Field(min_length=1, max_length=4)]


class ColumnsProfile(Record):
    """Pattern of the columns: each adds ``level + gain (p - light)`` to a light p, full scale = 1.

    One number per column, as in `pv_inspect.photometry.fixed_pattern.ColumnPattern`.
    """

    light: tuple[Number, ...]
    level: tuple[Number, ...]
    level_error: tuple[_NotNegative, ...]
    gain: tuple[Number, ...]
    gain_error: tuple[_NotNegative, ...]


class CameraProfile(StoredRecord):
    """A camera as many results saw it.

    What no result told is missing.
    """

    newest_format: ClassVar[int] = 1

    width: _Side
    height: _Side
    results: Whole
    notes: tuple[Text, ...] = ()
    defective_pixels: tuple[tuple[Whole, Whole], ...] = ()
    """(row, column), from 0."""
    lens: LensProfile | None = None
    psf: PsfProfile | None = None
    vignetting: VignettingProfile | None = None
    columns: ColumnsProfile | None = None

    @model_validator(mode="after")
    def _fits_the_frames(self) -> Self:
        for row, col in self.defective_pixels:
            if row >= self.height or col >= self.width:
                raise ValueError(
                    f"has the defective pixel [{row}, {col}] outside of {self.width} x "
                    f"{self.height} px"
                )
        for name, values in self.columns or ():
            if len(values) != self.width:
                raise ValueError(
                    f"has {len(values)} numbers in columns.{name}, but a width of {self.width}"
                )
        return self

    def kappa_at(self, focal_length_px: float) -> Known | None:
        """Return kappa and its error for another focal length; None if it is not known."""
        if self.lens is None:
            return None
        factor = (focal_length_px / self.lens.focal_length_px) ** 2
        return Known(factor * self.lens.kappa, factor * self.lens.kappa_error)

    @property
    def principal_point(self) -> tuple[tuple[float, float], float] | None:
        """Its place and the standard deviation per axis, LR px; None if it is not known."""
        lens = self.lens
        if lens is None or lens.principal_point_px is None or not lens.principal_point_error_px:
            return None
        return lens.principal_point_px, lens.principal_point_error_px

    @property
    def sigma(self) -> Known | None:
        """Standard deviation of the optical blur, LR px; None if it is not known."""
        return None if self.psf is None else Known(self.psf.sigma_lr_px, self.psf.error_lr_px)

    @property
    def described(self) -> tuple[str, ...]:
        """What it says, a line each, for a person."""
        lines = []
        if self.lens is not None:
            lines.append(
                f"kappa {self.lens.kappa:+.4f} \u00b1 {self.lens.kappa_error:.4f} for a focal "
                f"length of {self.lens.focal_length_px:g} px"
            )
        if self.psf is not None:
            shape = "" if self.psf.shape == "unknown" else f", {self.psf.shape}"
            lines.append(
                f"blur {self.psf.sigma_lr_px:.3f} \u00b1 {self.psf.error_lr_px:.3f} LR px{shape}"
            )
        if self.vignetting is not None:
            fall = 100 * (1 - exp(sum(self.vignetting.coefficients)))
            lines.append(f"corners darker by {fall:.1f} %")
        if self.columns is not None:
            level, gain = (
                100 * sqrt(sum(v**2 for v in values) / self.width)
                for values in (self.columns.level, self.columns.gain)
            )
            lines.append(f"columns differ by {level:.2f} % of full scale, {gain:.2f} % in gain")
        if self.defective_pixels:
            n = len(self.defective_pixels)
            lines.append(f"{n} defective pixel{'s' if n > 1 else ''}")
        return tuple(lines)


def read_profile(path: Path, image_shape: tuple[int, int] | None = None) -> CameraProfile:
    """Read a camera profile.

    Parameters
    ----------
    path : Path
        Written by `write_profile`, or by hand.
    image_shape : tuple of int, optional
        (height, width) of the frames that it is meant for.

    Raises
    ------
    InspectionError
        If the file can't be read, holds something else, or is of a camera of another size.
    """
    try:
        profile = checked(CameraProfile, read_toml(path, _MOST_BYTES))
    except ValueError as error:
        raise InspectionError(
            f"{path} is no camera profile ({error}): make one with pv-inspect calibrate."
        ) from None
    if image_shape is not None and image_shape != (profile.height, profile.width):
        raise InspectionError(
            f"{path} is the profile of a camera of {profile.width} x {profile.height} px, but the "
            f"frames have {image_shape[1]} x {image_shape[0]} px: give the profile of this camera "
            "at this size."
        )
    return profile


def write_profile(path: Path, profile: CameraProfile) -> None:
    """Write a camera profile as TOML, as a whole or not at all.

    Raises
    ------
    InspectionError
        If the file can't be written.
    """
    record = profile.model_dump(mode="json", exclude_none=True)
    tables = {name: value for name, value in record.items() if isinstance(value, dict)}
    lines = ["# Camera profile of pv-inspect: a value, and its standard deviation as *_error."]
    lines += [_line(name, value) for name, value in record.items() if name not in tables]
    for name, table in tables.items():
        lines += ["", f"[{name}]", *(_line(key, value) for key, value in table.items())]
    replace_file(path, ("\n".join(lines) + "\n").encode())


def _line(name: str, value: Any) -> str:
    # JSON numbers, strings and lists of them are TOML as well.
    return f"{name} = {json.dumps(value)}"


def conventional_kappa(
    kappa: float, error: float, focal: float, image_shape: tuple[int, int]
) -> Known:
    """Return kappa for the focal length by convention: in this gauge results are comparable."""
    factor = (conventional_focal_length(image_shape) / focal) ** 2
    return Known(kappa * factor, error * factor)
