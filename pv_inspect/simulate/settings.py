"""What is simulated: every number with its unit and its range, checked on construction."""

from __future__ import annotations

from dataclasses import Field, asdict, dataclass, field, fields
from typing import Any

from pv_inspect.common.gap_text import NO_GAPS, sizes_from
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout

__all__ = ["SimulationSettings"]

_MAX_SAMPLES = 100e6
"""Largest number of scene pixels or sensor samples: 400 MB per float32 array."""


def _number(default: Any, unit: str, low: float, high: float, text: str) -> Any:
    return field(default=default, metadata={"unit": unit, "low": low, "high": high, "help": text})


def _sizes(text: str) -> Any:
    return field(default=NO_GAPS, metadata={"sizes": True, "unit": "cell widths", "help": text})


def _choice(default: str, choices: tuple[str, ...], text: str) -> Any:
    return field(default=default, metadata={"choices": choices, "help": text})


@dataclass(frozen=True)
class SimulationSettings:
    """Settings of one simulated sequence; immutable, checked on construction.

    ``dataclasses.fields(SimulationSettings)`` carries ``unit``, ``low``, ``high`` (or ``choices``)
    and ``help`` of each setting in its metadata.

    Raises
    ------
    InspectionError
        If a value has the wrong type or lies outside its range.
    """

    seed: int = _number(0, "1", 0, 2**63 - 1, "Same seed and settings, same frames.")
    rows: int = _number(6, "cells", 1, 60, "Rows of cells.")
    cols: int = _number(10, "cells", 1, 60, "Columns of cells.")
    cell_aspect: float = _number(
        1.0, "1", 0.25, 4, "Cell width / cell height; 2 and 0.5 are half-cut cells."
    )
    row_gap: float = _number(
        0.0, "cell widths", 0, 2, "How much wider the gap is in the middle of the rows."
    )
    col_gap: float = _number(
        0.0, "cell widths", 0, 2, "How much wider the gap is in the middle of the columns."
    )
    cell_gap: float = _number(
        0.0, "cell widths", 0, 0.4, "Gap between all cells, if not the usual 1 to 3 mm."
    )
    row_heights: str = _sizes("Rows of other cells: NUMBER:HEIGHT, with commas between several.")
    col_widths: str = _sizes("Columns of other cells: NUMBER:WIDTH, with commas between several.")
    wafer: str = _choice("multi", ("multi", "mono"), "Multicrystalline or monocrystalline cells.")
    busbars: int = _number(3, "1", 1, 12, "Busbars per cell.")
    busbar_style: str = _choice("solid", ("solid", "dashed"), "Form of the busbars.")
    crack_share: float = _number(0.35, "share", 0, 1, "Share of cells in which a crack starts.")
    dark_cell_share: float = _number(0.015, "share", 0, 1, "Share of cells that are nearly dead.")
    wafer_gap: float = _number(0.019, "cell widths", 0, 0.2, "The usual gap between two wafers.")
    light_spread: float = _number(
        0.0038,
        "cell widths",
        0,
        0.2,
        "Spread of light in a cell: busbars get soft, its outline not.",
    )
    scene_blur: float = _number(
        0.0, "cell widths", 0, 0.2, "Gaussian blur of the whole scene, outlines of cells as well."
    )
    pixels_per_unit: int = _number(240, "scene px", 24, 1000, "Scene pixels per cell width.")

    n_frames: int = _number(20, "frames", 1, 1000, "Frames of the sequence.")
    width: int = _number(640, "LR px", 32, 8192, "Width of a frame.")
    height: int = _number(512, "LR px", 32, 8192, "Height of a frame.")
    focal_length_px: float | None = _number(
        None, "LR px", 10, 1e6, "Focal length; 1.1 x width if not given."
    )
    kappa: float = _number(-0.2, "1", -1, 1, "Radial distortion r_d = r_u + kappa r_u^3.")
    tilt_deg: float = _number(12.0, "deg", 0, 60, "Angle between optical axis and module normal.")
    tilt_axis_deg: float = _number(110.0, "deg", -360, 360, "Direction of the tilt axis.")
    roll_deg: float = _number(3.0, "deg", -360, 360, "Rotation about the optical axis.")
    fill: float = _number(0.92, "share", 0.1, 1.5, "Share of the frame that the module spans.")
    jitter_px: float = _number(2.5, "LR px", 0, 100, "Spread of the shifts between frames.")
    jitter_deg: float = _number(0.4, "deg", 0, 5, "Spread of tilt and roll between frames.")
    motion_blur_px: float = _number(0.3, "LR px", 0, 30, "Longest motion during one exposure.")
    psf_sigma_px: float = _number(
        0.42, "LR px", 0, 5, "Optical blur, standard deviation per axis, before the aperture."
    )
    psf_shape: str = _choice("gaussian", ("gaussian", "disc"), "Gaussian or disc out of focus.")
    supersampling: int = _number(6, "1", 1, 16, "Scene samples per LR pixel along x and y.")

    exposure: float = _number(0.62, "full scale", 0.001, 100, "Signal at radiance 1.")
    full_well_e: float = _number(25000.0, "electrons", 100, 1e7, "Electrons at full scale.")
    shot_noise: bool = field(default=True, metadata={"help": "Photon noise on or off."})
    read_noise_e: float = _number(40.0, "electrons", 0, 1e4, "Read noise, standard deviation.")
    ambient: float = _number(0.01, "radiance", 0, 10, "Stray light, the same everywhere.")
    vignetting: float = _number(0.15, "share", 0, 0.9, "Loss of light in the corners.")
    flicker: float = _number(0.015, "share", 0, 0.3, "Spread of the gain between frames.")
    prnu: float = _number(0.004, "share", 0, 0.2, "Spread of the gain between pixels.")
    column_offset_e: float = _number(60.0, "electrons", 0, 1e4, "Fixed column pattern, offset.")
    column_gain: float = _number(0.002, "share", 0, 0.2, "Fixed column pattern, gain.")
    sensor_seed: int = _number(
        -1, "1", -1, 2**63 - 1,
        "Same seed, same pattern and defective pixels in several sequences; -1: each its own.",
    )  # fmt: skip
    hot_share: float = _number(2e-4, "share", 0, 0.05, "Share of hot pixels.")
    dead_share: float = _number(1e-4, "share", 0, 0.05, "Share of dead pixels.")
    black_level_dn: int = _number(64, "DN", 0, 1000, "Black level.")
    bit_depth: int = _number(12, "bits", 8, 16, "Bits of the converter, in 16-bit files.")

    def __post_init__(self) -> None:
        for spec in fields(self):
            _check(spec, getattr(self, spec.name))
        width, height = self.layout.size
        samples = max(
            (width + 1) * (height + 1) * self.pixels_per_unit**2,
            self.width * self.height * self.supersampling**2,
        )
        if samples > _MAX_SAMPLES:
            raise InspectionError(
                f"The simulation would need arrays of {samples / 1e6:.0f} million samples, but at "
                f"most {_MAX_SAMPLES / 1e6:.0f} are allowed: lower pixels_per_unit, supersampling "
                "or the frame size."
            )
        if self.black_level_dn >= self.max_dn:
            raise InspectionError(
                f"black_level_dn is {self.black_level_dn}, but {self.bit_depth} bits end at "
                f"{self.max_dn} DN: lower the black level or raise bit_depth."
            )

    @property
    def layout(self) -> ModuleLayout:
        """Cells of the module."""
        return ModuleLayout(
            self.rows,
            self.cols,
            self.cell_aspect,
            ((self.rows // 2, self.row_gap),) if self.row_gap else (),
            ((self.cols // 2, self.col_gap),) if self.col_gap else (),
            (self.cell_gap, self.cell_gap),
            sizes_from(self.row_heights),
            sizes_from(self.col_widths),
        )

    @property
    def focal_px(self) -> float:
        """Focal length in LR pixels, given or by convention."""
        return 1.1 * self.width if self.focal_length_px is None else self.focal_length_px

    @property
    def max_dn(self) -> int:
        """Largest value of the converter."""
        return int(2**self.bit_depth) - 1

    def without_noise(self) -> SimulationSettings:
        """Return a copy whose sensor is ideal: no noise, pattern, flicker, vignetting, defects."""
        off = dict.fromkeys(
            ("read_noise_e", "ambient", "vignetting", "flicker", "prnu", "column_offset_e"), 0.0
        )
        off |= dict.fromkeys(("column_gain", "hot_share", "dead_share"), 0.0)
        return SimulationSettings(**{**asdict(self), **off, "shot_noise": False})

    def without_motion(self) -> SimulationSettings:
        """Return a copy in which all frames have the same pose and no motion blur."""
        still = {"jitter_px": 0.0, "jitter_deg": 0.0, "motion_blur_px": 0.0}
        return SimulationSettings(**{**asdict(self), **still})


def _check(spec: Field[Any], value: object) -> None:
    """Raise one sentence if ``value`` does not fit the declared type or range."""
    kind = str(spec.type)
    if kind == "bool":
        if not isinstance(value, bool):
            raise InspectionError(f"{spec.name} is {value!r}: give True or False.")
        return
    if "sizes" in spec.metadata:
        try:
            sizes_from(str(value))
        except ValueError as error:
            raise InspectionError(f"{spec.name}: {error}.") from None
        return
    if "choices" in spec.metadata:
        choices = spec.metadata["choices"]
        if value not in choices:
            raise InspectionError(f"{spec.name} is {value!r}: use one of {', '.join(choices)}.")
        return
    if value is None and kind.endswith("None"):
        return
    low, high, unit = (spec.metadata[key] for key in ("low", "high", "unit"))
    what = "a whole number" if kind == "int" else "a number"
    number = isinstance(value, int if kind == "int" else (int, float))
    if (
        not isinstance(value, (int, float))
        or isinstance(value, bool)
        or not (number and low <= value <= high)
    ):
        raise InspectionError(
            f"{spec.name} is {value!r} [{unit}], but {what} from {low:g} to {high:g} is expected: "
            "correct the value."
        )
