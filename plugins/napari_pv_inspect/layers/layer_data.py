"""What the reader gives to napari: a sequence as a lazy stack, a result folder as images."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import dask
import dask.array as da
import numpy as np
from numpy.typing import NDArray

from napari_pv_inspect.appearance import FRAMES, MODULE, contrast_limits
from napari_pv_inspect.layers.attributes import MODULE_PARTS, attributes_of
from pv_inspect.cracks import CrackMap
from pv_inspect.image_files.limits import ReadLimits
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.results.read import read_result
from pv_inspect.sequence.sequence import FrameSequence

__all__ = [
    "PART_KEY",
    "RESULT_KEY",
    "SEQUENCE_KEY",
    "LayerData",
    "lazy_stack",
    "open_sequence",
    "result_layers",
    "sequence_layer",
]

LayerData = tuple[Any, dict[str, Any], str]

# Under these keys of its metadata a layer carries what it shows; the workbench updates such layers.
SEQUENCE_KEY = "pv_inspect.sequence"
RESULT_KEY = "pv_inspect.result"
PART_KEY = "pv_inspect.part"


def open_sequence(
    path: Any,
    dark_frame: Path | None = None,
    flat_frame: Path | None = None,
    limits: ReadLimits | None = None,
    series: str | None = None,
    lock_in: bool | None = None,
) -> FrameSequence:
    """Open one path, or a list of frames, with the reference images of the camera if given.

    Raises
    ------
    InspectionError
        If the frames are no usable sequence.
    """
    given = path if isinstance(path, (str, Path)) else [Path(p) for p in path]
    return FrameSequence.open(given, dark_frame, flat_frame, limits, series, lock_in)


def lazy_stack(sequence: FrameSequence) -> da.Array:
    """Frames (n_frames, height, width) float32, full scale = 1, each read when looked at."""
    frames = [
        da.from_delayed(dask.delayed(_frame)(sequence, i), sequence.shape, np.float32)
        for i in range(len(sequence))
    ]
    stack: da.Array = da.stack(frames)
    return stack


def sequence_layer(sequence: FrameSequence) -> LayerData:
    """Return the lazy stack as a napari layer; only the first one that is measured is read now."""
    attributes = {
        "name": FRAMES,
        "contrast_limits": contrast_limits(_frame(sequence, next(iter(sequence.measured), 0))),
        "colormap": "gray",
        "axis_labels": ("frame", "row", "col"),
        "metadata": {SEQUENCE_KEY: sequence},
    }
    return lazy_stack(sequence), attributes, "image"


def result_layers(folder: Path) -> list[LayerData]:
    """Return the images of a result folder as layers, the module image carrying the result."""
    result = read_result(folder)
    made, found = result.need(Reconstruction), result.need(CrackMap)
    own: dict[str, dict[str, Any]] = {part: {PART_KEY: part} for part in MODULE_PARTS}
    own[MODULE][RESULT_KEY] = result
    attributes = {part: {**attributes_of(part), "metadata": own[part]} for part in MODULE_PARTS}
    attributes[MODULE]["contrast_limits"] = contrast_limits(made.image)
    images = (made.image, made.support, made.consistency, found.probability)
    return [
        (image, attributes[part], "image") for image, part in zip(images, MODULE_PARTS, strict=True)
    ]


def _frame(sequence: FrameSequence, index: int) -> NDArray[np.float32]:
    return sequence.frame(index).image
