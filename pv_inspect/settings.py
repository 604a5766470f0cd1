"""Every number that a user may tune, with unit, range and the stage that it makes stale."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Collection
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.config import JsonDict

from pv_inspect.common.records import read_text
from pv_inspect.errors import InspectionError
from pv_inspect.image_files.limits import MAX_FRAME_MPX, MAX_FRAMES, ReadLimits

__all__ = ["Settings", "Stage"]


# Settings are a few kilobytes; what is given by mistake must not fill the memory.
_LARGEST_FILE_BYTES = 2**20


class Stage(StrEnum):
    """The stages of the method in the order in which data flows (paper, Fig. 2)."""

    LOAD = "load"
    DETECT = "detect"
    CALIBRATE = "calibrate"
    REGISTER = "register"
    RECONSTRUCT = "reconstruct"
    CELLS = "cells"
    CRACKS = "cracks"

    @property
    def index(self) -> int:  # type: ignore[override]  # of no use on the name as a string
        """Position in the order of the stages, 0 for the first."""
        return list(Stage).index(self)

    # Stages compare by their order; that of their names means nothing.
    def __lt__(self, other: str) -> bool:
        return self.index < Stage(other).index

    def __le__(self, other: str) -> bool:
        return self.index <= Stage(other).index

    def __gt__(self, other: str) -> bool:
        return self.index > Stage(other).index

    def __ge__(self, other: str) -> bool:
        return self.index >= Stage(other).index


def _tunable(
    default: Any,
    stage: Stage,
    unit: str,
    description: str,
    *,
    option: tuple[str, ...] = (),
    slider: tuple[float, float] | None = None,
    **limits: Any,
) -> Any:
    """Declare a setting, once for the command line, the workbench and the documentation.

    Parameters
    ----------
    default : object
    stage : Stage
        The first stage that has to run again when it changes.
    unit, description : str
    option : tuple of str
        How the command line spells it, if not by its name with hyphens.
    slider : tuple of float, optional
        The usual values, which a slider spans; the limits if not given.
    **limits
        ``ge``, ``gt``, ``le`` of `pydantic.Field`.
    """
    extra: JsonDict = {"stage": stage.value, "unit": unit, "option": list(option)}
    if slider is not None:
        extra["slider"] = list(slider)
    return Field(default, description=description, json_schema_extra=extra, **limits)


Finite = Annotated[float, Field(allow_inf_nan=False)]
Pixel = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]


class Settings(BaseModel):
    """Settings of one inspection; immutable, validated on construction.

    ``Settings.model_fields[name].description`` says what a field means and
    ``Settings.unit_of(name)`` its unit: the command line and the workbench show both.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    rows: int | None = _tunable(
        None,
        Stage.DETECT,
        "cells",
        "Rows of cells; taken from module.json if not given.",
        ge=1,
        le=200,
    )
    cols: int | None = _tunable(
        None,
        Stage.DETECT,
        "cells",
        "Columns of cells; taken from module.json if not given.",
        ge=1,
        le=200,
    )
    cell_aspect: Finite | None = _tunable(
        None,
        Stage.DETECT,
        "1",
        "Cell width / cell height; from module.json if not given, else 1.",
        ge=0.1,
        le=10,
    )
    module_at: tuple[Pixel, Pixel] | None = _tunable(
        None,
        Stage.DETECT,
        "LR px",
        "x and y of a point inside of the wanted module in the first frame; the completely "
        "visible module nearest to the centre if not given.",
    )
    dark_frame: Path | None = _tunable(
        None,
        Stage.LOAD,
        "file",
        "Image taken without current, subtracted from every frame "
        "instead of the estimated black level.",
    )
    flat_frame: Path | None = _tunable(
        None,
        Stage.LOAD,
        "file",
        "Image of an evenly bright surface through the same lens at the same aperture: every frame "
        "is divided by it.",
    )
    series: str | None = _tunable(
        None,
        Stage.LOAD,
        "name",
        "Name, or number from 1, of the pictures that are meant where a file holds several series "
        "of them.",
    )
    max_frame_mpx: Finite = _tunable(
        MAX_FRAME_MPX,
        Stage.LOAD,
        "Mpx",
        "Largest picture that is read; a file that claims more is refused before memory is taken "
        "for it.",
        ge=0.01,
        le=2000,
    )
    max_frames: int = _tunable(
        MAX_FRAMES,
        Stage.LOAD,
        "frames",
        "Largest number of frames that is read as one sequence.",
        ge=1,
        le=100_000,
    )
    kappa: Finite | None = _tunable(
        None,
        Stage.CALIBRATE,
        "1",
        "Radial distortion, r_d = r_u + kappa r_u^3 in normalised coordinates; "
        "fitted if not given.",
        ge=-1,
        le=1,
        slider=(-0.6, 0.6),
    )
    focal_length_px: Finite | None = _tunable(
        None,
        Stage.CALIBRATE,
        "LR px",
        "Focal length; if not given it is a stated convention that the results do not depend on.",
        gt=10,
        le=1e6,
        option=("--focal-length",),
    )
    calibration_file: Path | None = _tunable(
        None,
        Stage.CALIBRATE,
        "file",
        "Calibration of the camera (YAML, JSON or XML of OpenCV, or a result.json): fixes focal "
        "length, principal point and, unless kappa is given, kappa.",
        option=("--calibration",),
    )
    module_of: str | None = _tunable(
        None,
        Stage.REGISTER,
        "file",
        "Name of a frame that shows the wanted module, where the frames show several; the module "
        "of most frames if not given.",
    )
    keep_frames: tuple[str, ...] = _tunable(
        (),
        Stage.REGISTER,
        "file",
        "Names of frames that are used even if they seem to show another module; a copy of another "
        "frame stays a copy.",
        option=("--keep-frame",),
    )
    skip_frames: tuple[str, ...] = _tunable(
        (),
        Stage.REGISTER,
        "file",
        "Names of frames that are left out, with their copies.",
        option=("--skip-frame",),
    )
    registration_model: Literal["camera", "homography"] = _tunable(
        "camera",
        Stage.REGISTER,
        "1",
        "camera: every frame against the module image, with lens distortion; homography: plain "
        "homographies between frames, the ablation OURS-H of the paper.",
    )
    magnification: Finite = _tunable(
        4.0,
        Stage.RECONSTRUCT,
        "1",
        "LR pixel pitch / HR pixel pitch; 3 and 4 are usual.",
        ge=1,
        le=6,
        option=("-m",),
    )
    prior: Literal["sparse_curvature", "btv", "tikhonov"] = _tunable(
        "sparse_curvature",
        Stage.RECONSTRUCT,
        "1",
        "Prior of Eq. 7: a group-sparse penalty on second differences, bilateral total variation, "
        "or squared differences (Tikhonov).",
    )
    prior_weight: Finite | None = _tunable(
        None,
        Stage.RECONSTRUCT,
        "noise units",
        "lambda of Eq. 7: weight of the prior against the mean squared residual in noise units; "
        "found from held-out pixels if not given.",
        ge=0,
        le=1e3,
        option=("--lambda",),
        slider=(1e-4, 10.0),
    )
    psf_sigma_lr_px: Finite | None = _tunable(
        None,
        Stage.RECONSTRUCT,
        "LR px",
        "Standard deviation of the optical blur, before the pixel aperture; "
        "estimated if not given.",
        ge=0.1,
        le=3,
        option=("--psf-sigma",),
    )
    motion_blur: Literal["auto", "none"] = _tunable(
        "auto",
        Stage.RECONSTRUCT,
        "1",
        "auto: straight motion during the exposure is estimated for every frame and undone; "
        "none: the frames are taken as still.",
    )
    second_pass: bool = _tunable(
        True,
        Stage.RECONSTRUCT,
        "1",
        "Two passes over the frames: against a first module image the sensor's fixed pattern and "
        "vignetting are found and taken out, and pixels that contradict it count for less.",
        option=("--second-pass/--no-second-pass",),
    )
    max_iterations: int = _tunable(
        200,
        Stage.RECONSTRUCT,
        "1",
        "Upper limit of solver iterations of the reconstruction; it ends when it has converged.",
        ge=1,
        le=1000,
    )
    crack_threshold: Finite | None = _tunable(
        None,
        Stage.CRACKS,
        "probability",
        "Probability above which a pixel counts as crack; the detector's own if not given.",
        ge=0,
        le=1,
    )
    detector: Literal["network", "ridge"] = _tunable(
        "network",
        Stage.CRACKS,
        "1",
        "What finds the cracks: a small network trained on labelled cells, or ridge filters.",
    )
    cell_width_mm: Finite | None = _tunable(
        None,
        Stage.CRACKS,
        "mm",
        "Pitch of the cells along a row; crack lengths are then given in mm as well.",
        gt=0,
        le=1000,
    )

    @classmethod
    def create(cls, **values: Any) -> Settings:
        """Build settings, turning a wrong value into one sentence.

        Raises
        ------
        InspectionError
            If a name is unknown or a value is outside its range.
        """
        try:
            return cls(**values)
        except ValidationError as error:
            raise InspectionError(_sentence(error)) from None

    @classmethod
    def from_toml(cls, path: Path) -> Settings:
        """Read settings from a TOML file.

        Raises
        ------
        InspectionError
            If the file can't be read, is no TOML, or holds a wrong name or value.
        """
        try:
            text = read_text(path, _LARGEST_FILE_BYTES)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InspectionError(
                f"{path} can't be read ({reason}): give an existing settings file."
            ) from None
        try:
            values = tomllib.loads(text)
        except RecursionError:
            raise InspectionError(
                f"{path} is nested too deep, but settings are plain lines like rows = 6: give a "
                "TOML file of settings."
            ) from None
        except ValueError as error:  # also from numbers that are too long
            raise InspectionError(
                f"{path} is not valid TOML ({error}): correct that line."
            ) from None
        try:
            return cls.create(**values)
        except InspectionError as error:
            raise InspectionError(f"{path}: {error}") from None

    def to_toml(self, fields: Collection[str] | None = None) -> str:
        """Return the settings, or some of them, as TOML; values that are not given are left out."""
        lines = []
        include = None if fields is None else set(fields)
        for name, value in self.model_dump(mode="json", include=include, exclude_none=True).items():
            # JSON strings and lists of them are TOML as well.
            text = json.dumps(value) if isinstance(value, str | list | bool) else repr(value)
            lines.append(f"{name} = {text}")
        return "\n".join(lines) + "\n"

    def changed(self, **values: Any) -> Settings:
        """Return a validated copy with some values changed."""
        return Settings.create(**{**self.model_dump(), **values})

    @property
    def read_limits(self) -> ReadLimits:
        """What is read at most, for `FrameSequence.open`."""
        return ReadLimits(self.max_frame_mpx, self.max_frames)

    @classmethod
    def unit_of(cls, name: str) -> str:
        """Unit of a setting, for labels and tooltips."""
        return str(cls._extra(name)["unit"])

    @classmethod
    def options_of(cls, name: str) -> tuple[str, ...]:
        """How the command line spells a setting."""
        spelled = tuple(cls._extra(name)["option"])
        long = any(text.startswith("--") for text in spelled)
        return spelled if long else (f"--{name.replace('_', '-')}", *spelled)

    @classmethod
    def limits_of(cls, name: str) -> tuple[float | None, float | None]:
        """Least and largest value of a setting, None where there is no limit."""
        limits = {
            kind: float(getattr(limit, kind))
            for limit in cls.model_fields[name].metadata
            for kind in ("ge", "gt", "le")
            if hasattr(limit, kind)
        }
        return limits.get("ge", limits.get("gt")), limits.get("le")

    @classmethod
    def slider_of(cls, name: str) -> tuple[float, float]:
        """Return the values that a slider of this setting spans.

        Raises
        ------
        ValueError
            If the setting has neither usual values nor limits.
        """
        low, high = cls.limits_of(name)
        if "slider" in (extra := cls._extra(name)):
            low, high = map(float, extra["slider"])
        if low is None or high is None:
            raise ValueError(f"{name} has no range")
        return low, high

    @classmethod
    def stage_of(cls, name: str) -> Stage:
        """Return the first stage that a change of this setting makes stale."""
        return Stage(cls._extra(name)["stage"])

    def first_stale_stage(self, other: Settings) -> Stage | None:
        """Return the first stage that has to run again to get from ``self`` to ``other``."""
        stages = [
            self.stage_of(name)
            for name in type(self).model_fields
            if getattr(self, name) != getattr(other, name)
        ]
        return min(stages, key=lambda stage: stage.index, default=None)

    @classmethod
    def _extra(cls, name: str) -> dict[str, Any]:
        extra = cls.model_fields[name].json_schema_extra
        assert isinstance(extra, dict)
        return dict(extra)


def _sentence(error: ValidationError) -> str:
    first = error.errors()[0]
    name = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        known = ", ".join(Settings.model_fields)
        return f"There is no setting {name!r}: use one of {known}."
    unit = Settings.unit_of(name) if name in Settings.model_fields else ""
    why = f"{first['msg'][0].lower()}{first['msg'][1:]}"
    try:
        found = repr(first["input"])
    except ValueError:  # Python writes out no number of thousands of digits
        found = "a number of thousands of digits"
    return f"Setting {name} is {found} [{unit}]: {why}."
