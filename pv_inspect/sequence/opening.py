"""What is checked when a sequence is opened."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pv_inspect.errors import InspectionError
from pv_inspect.image_files.jpeg_loss import jpeg_error_variance
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.image_files.video import video_error_variance
from pv_inspect.sequence.copies import FrameContents
from pv_inspect.sequence.frame import Frame, prepared
from pv_inspect.sequence.frame_files import FrameFile, expand, read_frame, read_tinted
from pv_inspect.sequence.frame_list import existing_image
from pv_inspect.sequence.modulation import LevelPictures
from pv_inspect.sequence.noise import NoiseModel
from pv_inspect.sequence.sensor import (
    black_level,
    column_offsets,
    defective_pixels,
    flat_field,
    temporal_median,
)
from pv_inspect.sequence.values import Raw, ValueScale, ValueSurvey, comparable

__all__ = [
    "DecodedFrames",
    "SensorState",
    "check_frames",
    "read_reference",
    "reference_dn",
    "sensor_of",
    "with_compression",
]

_SMALLEST_SIDE_PX = 32
# Frames that the loss of compression is estimated from.
_LOSS_FRAMES = 3
# JPEG and most video compress blocks of this side.
_COMPRESSION_PX = 8


class DecodedFrames:
    """The frames as they are on disk; the first ones are kept once they were decoded.

    Parameters
    ----------
    files : tuple of FrameFile
    most_bytes : int
        So much is kept.

    Attributes
    ----------
    tinted : set of int
        Frames that had a slight tint.
    """

    def __init__(self, files: tuple[FrameFile, ...], most_bytes: int) -> None:
        self._files = files
        self._left = most_bytes
        self._kept: dict[int, Raw] = {}
        self.tinted: set[int] = set()

    def __getitem__(self, index: int) -> Raw:
        """Return a frame, (height, width) uint8, uint16 or float32."""
        known = self._kept.get(index)
        if known is not None:
            return known
        image, tinted = read_tinted(self._files[index])
        if tinted:
            self.tinted.add(index)
        if image.nbytes <= self._left:
            self._left -= image.nbytes
            self._kept[index] = image
        return image


def check_frames(
    files: tuple[FrameFile, ...],
    names: tuple[str, ...],
    contents: FrameContents,
    decoded: DecodedFrames,
    pictures: LevelPictures,
) -> tuple[tuple[int, int], ValueSurvey]:
    """Decode every frame once, into contents and pictures; return their shape and their values."""
    shape = Counter(file.shape for file in files).most_common(1)[0][0]
    kind = Counter(_kind(file) for file in files).most_common(1)[0][0]
    # What the headers say comes first: nothing is decoded in vain.
    for name, file in zip(names, files, strict=True):
        if file.shape != shape:
            raise InspectionError(
                f"{name} is {file.shape[1]} x {file.shape[0]}, the sequence is {shape[1]} x "
                f"{shape[0]}: remove it or load it as its own sequence."
            )
        if _kind(file) != kind:
            raise InspectionError(
                f"{name} has {_kind(file)}, the sequence has {_short(kind, _kind(file))}: remove "
                "it or export all frames alike."
            )
    if min(shape) < _SMALLEST_SIDE_PX:
        raise InspectionError(
            f"The frames are {shape[1]} x {shape[0]}, too small to show a module: at least "
            f"{_SMALLEST_SIDE_PX} x {_SMALLEST_SIDE_PX} is needed, give the full images."
        )
    survey = ValueSurvey()
    for index in range(len(files)):
        image = decoded[index]
        survey.add(image)
        contents.add(comparable(image))
        pictures.add(image)
    if not np.isfinite(survey.maximum):
        raise InspectionError(
            f"{names[0]} and all other frames hold no number at all: export what the camera "
            "delivered."
        )
    return shape, survey


def with_compression(
    noise: NoiseModel, files: Sequence[FrameFile], full_scale: float
) -> NoiseModel:
    """Add to the noise what JPEG has taken from the frames, estimated on some of them.

    Parameters
    ----------
    noise : NoiseModel
        Estimated from the pixels, where compression has smoothed most of it away.
    files : sequence of FrameFile
    full_scale : float
        DN.
    """
    lossy = [file for file in files if file.picture.lossy]
    if not lossy:
        return noise
    noise = replace(noise, grain_px=_COMPRESSION_PX)
    first, limits = lossy[0], lossy[0].limits
    if first.format.name == "video":
        error = video_error_variance(first.path, first.state, first.picture, limits, _LOSS_FRAMES)
    else:
        paths = [file.path for file in lossy if file.format.name == "JPEG"]
        some = paths[:: max(1, len(paths) // _LOSS_FRAMES)][:_LOSS_FRAMES]
        error = float(np.median([jpeg_error_variance(path, limits) for path in some] or [0.0]))
    return replace(noise, read_variance=noise.read_variance + error / full_scale**2)


def _kind(file: FrameFile) -> str:
    """What type of values a frame holds, in words."""
    if file.dtype in (np.uint8, np.uint16):
        return f"{file.picture.bits or 8 * file.dtype.itemsize} bits"
    return f"{file.dtype} values"


def _short(kind: str, other: str) -> str:
    """Leave out "bits" where both are said in them."""
    return kind.removesuffix(" bits") if other.endswith(" bits") else kind


def read_reference(
    path: Path, kind: str, shape: tuple[int, int], like: FrameFile, limits: ReadLimits
) -> Raw:
    """Read a dark or flat frame, the median of its pages, in stored values."""
    files = expand(existing_image(path), limits)
    for file in files:
        if file.shape != shape or file.dtype != like.dtype:
            raise InspectionError(
                f"The {kind} frame {path} is {file.shape[1]} x {file.shape[0]} with "
                f"{_kind(file)}, the sequence is {shape[1]} x {shape[0]} with "
                f"{_kind(like)}: take it with the same camera settings."
            )
    pages = [read_frame(file) for file in files]
    if len(pages) == 1:
        return pages[0]
    median: Raw = temporal_median(np.stack(pages)).astype(pages[0].dtype)
    return median


def reference_dn(raw: Raw, scale: ValueScale) -> Raw:
    """Bring a dark or flat frame to DN, (height, width) uint8, uint16 or float32."""
    if raw.dtype.kind == "u":
        return raw
    filled = scale.without_gaps(raw)[0]
    return (filled.astype(np.float64) * scale.factor).astype(np.float32)


class SensorState(NamedTuple):
    """What a sensor does to the numbers of all frames; DN.

    Black per column or pixel, its typical level, defective pixels, relative response or None.
    """

    black: NDArray[np.float32]
    level: float
    defects: NDArray[np.bool_]
    flat: NDArray[np.float32] | None

    def prepared(self, raw: Raw, scale: ValueScale) -> Frame:
        """Return a frame without that."""
        return prepared(raw, self.black, self.level, scale, self.defects, self.flat)

    def with_defects_in(self, stack: Raw, full_scale: float) -> SensorState:
        """Add the pixels that are defective in some frames, (n_frames, height, width) in DN."""
        defects = self.defects | defective_pixels(stack, full_scale)
        defects.flags.writeable = False
        return self._replace(defects=defects)


def sensor_of(
    stack: Raw,
    scale: ValueScale,
    dark: tuple[Path, Raw] | None,
    flat: tuple[Path, Raw] | None,
) -> SensorState:
    """Estimate what the sensor does, with the help of reference images where there are any.

    Parameters
    ----------
    stack : (n_frames, height, width), DN
        Some frames.
    scale : ValueScale
    dark, flat : (Path, Raw) or None
        Reference images in stored values, with their names.

    Raises
    ------
    InspectionError
        If a reference image can't be one.
    """
    full_scale = scale.full_scale_dn
    defects = defective_pixels(stack, full_scale)
    if dark is None:
        columns = column_offsets(stack, full_scale)
        level = min(black_level(temporal_median(stack) - columns), 0.5 * full_scale)
        black = columns + np.float32(level)
    else:
        of_dark = reference_dn(dark[1], scale)
        black, level = of_dark.astype(np.float32), float(np.median(of_dark))
        bright = float(np.percentile(temporal_median(stack), 99.0))
        if level >= full_scale or level > bright:
            raise InspectionError(
                f"The dark frame {dark[0]} has a median of {level / scale.factor:g} DN and "
                f"is brighter than the frames ({bright / scale.factor:g} DN): give the image "
                "taken without current."
            )
        defects |= defective_pixels(of_dark[None], full_scale)
    response = None
    if flat is not None:
        try:
            response = flat_field(reference_dn(flat[1], scale), black, full_scale)
        except ValueError as error:
            raise InspectionError(
                f"The flat frame {flat[0]} {error}: take an evenly bright surface that "
                "fills the image, well exposed but not saturated."
            ) from None
        defects = defects | (response == 0.0)
    defects.flags.writeable = False
    return SensorState(black, level, defects, response)
