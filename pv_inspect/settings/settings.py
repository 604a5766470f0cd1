"""Every number that a user may tune, with unit, range and the stage that it makes stale."""

from __future__ import annotations

from collections.abc import Collection
from functools import partial
from pathlib import Path
from typing import Any, Literal

from pydantic import ConfigDict, ValidationError

from pv_inspect.errors import InspectionError
from pv_inspect.image_files.endings import PATTERNS
from pv_inspect.image_files.limits import MAX_FRAME_MPX, MAX_FRAMES, ReadLimits
from pv_inspect.settings.declaration import Declaration, Group, tunable
from pv_inspect.settings.module_settings import Finite, ModuleSettings
from pv_inspect.settings.stages import Stage
from pv_inspect.settings.toml import read_toml, toml_text
from pv_inspect.settings.wrong_value import sentence_of

__all__ = ["Settings"]


_IMAGES = f"Images ({PATTERNS})"

_reading = partial(Declaration, Stage.LOAD, Group.FRAMES)
_lens = partial(Declaration, Stage.CALIBRATE, Group.LENS)
_choosing = partial(Declaration, Stage.REGISTER, Group.FRAMES)
_image = partial(Declaration, Stage.RECONSTRUCT, Group.IMAGE)
_cracks = partial(Declaration, Stage.CRACKS, Group.CRACKS)


class Settings(ModuleSettings):
    """Settings of one inspection; immutable, validated on construction.

    ``Settings.model_fields[name].description`` says what a field means and
    ``Settings.unit_of(name)`` its unit: the command line and the workbench show both.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    dark_frame: Path | None = tunable(
        None,
        _reading("dark frame", "file", automatic="none", files=_IMAGES),
        "Image taken without current, subtracted from every frame "
        "instead of the estimated black level.",
    )
    flat_frame: Path | None = tunable(
        None,
        _reading("flat frame", "file", automatic="none", files=_IMAGES),
        "Image of an evenly bright surface through the same lens at the same aperture: every frame "
        "is divided by it.",
    )
    series: str | None = tunable(
        None,
        _reading("series", "name", automatic="the only one"),
        "Name or number (from 1) of the pictures that are meant where a file holds several series.",
    )
    lock_in: bool | None = tunable(
        None,
        _reading(
            "lock-in",
            option=("--lock-in/--no-lock-in",),
            automatic="as seen",
            choices={
                "yes": ("Differences", "Frames with current minus the nearest ones without."),
                "no": ("As they are", "The frames themselves, whatever their levels do."),
            },
        ),
        "The current is switched on and off between the frames, by daylight: differences of frames "
        "with and without it are used. Found in the levels of the frames if not given.",
    )
    max_frame_mpx: Finite = tunable(
        MAX_FRAME_MPX,
        _reading("largest frame", "Mpx", advanced=True),
        "Largest picture that is read; a file that claims more is refused before memory is taken "
        "for it.",
        ge=0.01,
        le=2000,
    )
    max_frames: int = tunable(
        MAX_FRAMES,
        _reading("most frames", "frames", advanced=True),
        "Largest number of frames that is read as one sequence.",
        ge=1,
        le=100_000,
    )
    kappa: Finite | None = tunable(
        None,
        _lens("kappa", slider=(-0.6, 0.6), decimals=4, automatic="fitted", live=True),
        "Radial distortion, r_d = r_u + kappa r_u^3 in normalised coordinates; "
        "fitted if not given.",
        ge=-1,
        le=1,
    )
    focal_length_px: Finite | None = tunable(
        None,
        _lens(
            "focal length",
            "LR px",
            option=("--focal-length",),
            automatic="convention",
            advanced=True,
        ),
        "Focal length; if not given it is a stated convention that the results do not depend on.",
        gt=10,
        le=1e6,
    )
    calibration_file: Path | None = tunable(
        None,
        _lens(
            "camera file",
            "file",
            option=("--calibration",),
            automatic="none",
            files="Camera (*.yaml *.yml *.json *.xml);;All files (*)",
        ),
        "Calibration of the camera (YAML, JSON or XML of OpenCV, or a result.json): fixes focal "
        "length, principal point and, unless kappa is given, kappa.",
    )
    camera_profile: Path | None = tunable(
        None,
        _lens(
            "profile",
            "file",
            option=("--camera",),
            automatic="none",
            files="Camera profile (*.toml);;All files (*)",
        ),
        "What pv-inspect calibrate pooled from other results of this camera (TOML): kappa, "
        "principal point, blur, vignetting, columns and defective pixels are taken into account as "
        "far as they are known.",
    )
    module_of: str | None = tunable(
        None,
        _choosing("module of frame", "file", automatic="of most frames", advanced=True),
        "Name of a frame that shows the wanted module, where the frames show several; the module "
        "of most frames if not given.",
    )
    keep_frames: tuple[str, ...] = tunable(
        (),
        _choosing(
            "frames kept", "file", option=("--keep-frame",), set_by="ticks in the list of frames"
        ),
        "Names of frames that are used even if they seem to show another module; a copy of another "
        "frame stays a copy.",
    )
    skip_frames: tuple[str, ...] = tunable(
        (),
        _choosing(
            "frames left out",
            "file",
            option=("--skip-frame",),
            live=True,
            set_by="ticks in the list of frames",
        ),
        "Names of frames that are left out, with their copies.",
    )
    registration_model: Literal["camera", "homography"] = tunable(
        "camera",
        _choosing(
            "registration",
            choices={
                "camera": ("Camera and lens", "Every frame against the module image."),
                "homography": ("Homographies", "Frame to frame, without the lens (OURS-H)."),
            },
            advanced=True,
        ),
        "camera: every frame against the module image, with lens distortion; homography: plain "
        "homographies between frames, the ablation OURS-H of the paper.",
    )
    magnification: Finite = tunable(
        4.0,
        _image("magnification", option=("-m",), slider=(1.0, 6.0), live=True),
        "LR pixel pitch / HR pixel pitch; 3 and 4 are usual.",
        ge=1,
        le=6,
    )
    prior_weight: Finite | None = tunable(
        None,
        _image(
            "lambda",
            "noise units",
            option=("--lambda",),
            slider=(1e-4, 10.0),
            logarithmic=True,
            decimals=4,
            live=True,
        ),
        "lambda of Eq. 7: weight of the prior against the mean squared residual in noise units; "
        "found from held-out pixels if not given.",
        ge=0,
        le=1e3,
    )
    psf_sigma_lr_px: Finite | None = tunable(
        None,
        _image(
            "PSF sigma",
            "LR px",
            option=("--psf-sigma",),
            slider=(0.1, 3.0),
            logarithmic=True,
            automatic="estimated",
            live=True,
        ),
        "Standard deviation of the optical blur, before the pixel aperture; "
        "estimated if not given.",
        ge=0.1,
        le=3,
    )
    prior: Literal["learned", "sparse_curvature", "wbtv", "btv", "tikhonov"] = tunable(
        "learned",
        _image(
            "prior",
            choices={
                "learned": (
                    "Learnt from cells",
                    "Flattens noise and keeps what cells are made of: filters of a few pixels, "
                    "learnt from sharp pictures of cells (convex filters).",
                ),
                "sparse_curvature": (
                    "Sharp edges",
                    "Flattens noise and keeps cracks sharp; an edge once found is smoothed less "
                    "(sparse curvature).",
                ),
                "wbtv": (
                    "Sharp, as published",
                    "Differences of neighbours, large ones with less weight: the prior of the "
                    "method's paper (weighted bilateral total variation, WBTV).",
                ),
                "btv": (
                    "Sharp, plain",
                    "The same without weights: fine lines lose more contrast (BTV).",
                ),
                "tikhonov": (
                    "Smooth",
                    "Squared differences: no surprises, but edges are rounded and noise stays "
                    "(Tikhonov).",
                ),
            },
            live=True,
        ),
        "Prior of Eq. 7: a convex penalty on the answers of filters learnt from cells, a "
        "group-sparse penalty on second differences (sparse_curvature), the paper's weighted "
        "bilateral total variation (wbtv), bilateral total variation without weights (btv), or "
        "squared differences (tikhonov).",
    )
    motion_blur: Literal["auto", "none"] = tunable(
        "auto",
        _image(
            "motion blur",
            choices={
                "auto": ("Undo motion blur", "Estimated for every frame and undone."),
                "none": ("", "The frames are taken as still."),
            },
            live=True,
        ),
        "auto: straight motion during the exposure is estimated for every frame and undone; "
        "none: the frames are taken as still.",
    )
    second_pass: bool = tunable(
        True,
        _image("second pass", option=("--second-pass/--no-second-pass",), advanced=True),
        "Two passes over the frames: against a first module image the sensor's fixed pattern and "
        "vignetting are found and taken out, and pixels that contradict it count for less.",
    )
    max_iterations: int = tunable(
        200,
        _image("most iterations", advanced=True, live=True),
        "Upper limit of solver iterations of the reconstruction; it ends when it has converged.",
        ge=1,
        le=1000,
    )
    crack_threshold: Finite | None = tunable(
        None,
        _cracks(
            "crack threshold",
            "probability",
            slider=(0.0, 1.0),
            automatic="default",
        ),
        "Probability above which a pixel counts as crack; the detector's own if not given.",
        ge=0,
        le=1,
    )
    detector: Literal["network", "ridge"] = tunable(
        "network",
        _cracks(
            "detector",
            choices={
                "network": ("Network", "A small network trained on labelled cells."),
                "ridge": ("Ridge filters", "Bright and dark lines, without any training."),
            },
        ),
        "What finds the cracks: a small network trained on labelled cells, or ridge filters.",
    )
    cell_width_mm: Finite | None = tunable(
        None,
        Declaration(
            Stage.CRACKS,
            Group.MODULE,
            "cell width",
            "mm",
            decimals=1,
            automatic="not known",
            advanced=True,
        ),
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
            raise InspectionError(sentence_of(error, cls)) from None

    @classmethod
    def from_toml(cls, path: Path) -> Settings:
        """Read settings from a TOML file.

        Raises
        ------
        InspectionError
            If the file can't be read, is no TOML, or holds a wrong name or value.
        """
        values = read_toml(path)
        try:
            return cls.create(**values)
        except InspectionError as error:
            raise InspectionError(f"{path}: {error}") from None

    def to_toml(self, fields: Collection[str] | None = None) -> str:
        """Return the settings, or some of them, as TOML; values that are not given are left out."""
        include = None if fields is None else set(fields)
        return toml_text(self.model_dump(mode="json", include=include, exclude_none=True))

    def changed(self, **values: Any) -> Settings:
        """Return a validated copy with some values changed."""
        return Settings.create(**{**self.model_dump(), **values})

    @property
    def read_limits(self) -> ReadLimits:
        """What is read at most, for `FrameSequence.open`."""
        return ReadLimits(self.max_frame_mpx, self.max_frames)
