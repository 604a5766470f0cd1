"""What the reader gives to napari: a sequence as a lazy stack, a result folder as images."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import dask
import dask.array as da
import numpy as np
from napari.utils.colormaps import Colormap
from numpy.typing import NDArray

from napari_pv_inspect.appearance import (
    CONSISTENCY,
    CONSISTENCY_LIMITS,
    CRACKS,
    FRAMES,
    MODULE,
    SUPPORT,
    contrast_limits,
    crack_colormap,
)
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

# Under these keys of its metadata a layer carries what it shows; the workbench adopts such layers.
SEQUENCE_KEY = "pv_inspect.sequence"
RESULT_KEY = "pv_inspect.result"
PART_KEY = "pv_inspect.part"


def open_sequence(
    path: Any,
    dark_frame: Path | None = None,
    flat_frame: Path | None = None,
    limits: ReadLimits | None = None,
    series: str | None = None,
) -> FrameSequence:
    """Open one path, or a list of frames, with the reference images of the camera if given.

    Raises
    ------
    InspectionError
        If the frames are no usable sequence.
    """
    given = path if isinstance(path, (str, Path)) else [Path(p) for p in path]
    return FrameSequence.open(given, dark_frame, flat_frame, limits, series)


def lazy_stack(sequence: FrameSequence) -> da.Array:
    """Frames (n_frames, height, width) float32, full scale = 1, each read when looked at."""
    frames = [
        da.from_delayed(dask.delayed(_frame)(sequence, i), sequence.shape, np.float32)
        for i in range(len(sequence))
    ]
    stack: da.Array = da.stack(frames)
    return stack


def sequence_layer(sequence: FrameSequence) -> LayerData:
    """Return the lazy stack as a napari layer; only its first frame is read now."""
    attributes = {
        "name": FRAMES,
        "contrast_limits": contrast_limits(_frame(sequence, 0)),
        "colormap": "gray",
        "axis_labels": ("frame", "row", "col"),
        "metadata": {SEQUENCE_KEY: sequence},
    }
    return lazy_stack(sequence), attributes, "image"


def result_layers(folder: Path) -> list[LayerData]:
    """Return module image, support and cracks of a result folder, the image carrying the result."""
    result = read_result(folder)
    made, found = result.need(Reconstruction), result.need(CrackMap)
    image = {
        "name": MODULE,
        "contrast_limits": contrast_limits(made.image),
        "colormap": "gray",
        "metadata": {RESULT_KEY: result, PART_KEY: MODULE},
    }
    support = {
        "name": SUPPORT,
        "metadata": {PART_KEY: SUPPORT},
        "contrast_limits": (0.0, 1.0),
        "colormap": "viridis",
        "visible": False,
    }
    consistency = {
        "name": CONSISTENCY,
        "metadata": {PART_KEY: CONSISTENCY},
        "contrast_limits": CONSISTENCY_LIMITS,
        "colormap": "magma",
        "visible": False,
    }
    cracks = {
        "name": CRACKS,
        "metadata": {PART_KEY: CRACKS},
        "contrast_limits": (0.0, 1.0),
        "colormap": Colormap(**crack_colormap()),
        "blending": "translucent",
        "opacity": 0.75,
    }
    return [
        (made.image, image, "image"),
        (made.support, support, "image"),
        (made.consistency, consistency, "image"),
        (found.probability, cracks, "image"),
    ]


def _frame(sequence: FrameSequence, index: int) -> NDArray[np.float32]:
    return sequence.frame(index).image
