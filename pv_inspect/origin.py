"""What a result came from: where its frames lie, and the geometry that a later run starts from."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pv_inspect.calibration import Calibration
from pv_inspect.camera import Camera
from pv_inspect.crossings import Crossings, FrameCrossings
from pv_inspect.errors import InspectionError
from pv_inspect.layout import ModuleLayout
from pv_inspect.pipeline import Inspection
from pv_inspect.sequence import Sequence

__all__ = ["GEOMETRY_JSON", "geometry_record", "places", "read_geometry", "source_record"]

Array = NDArray[np.float64]

GEOMETRY_JSON = "geometry.json"


def source_record(sequence: Sequence, out: Path) -> dict[str, Any]:
    """Where the frames are: absolute, and relative to the result folder, which may move along."""
    given = sequence.opened_from
    record = {}
    for name, turn in (("path", str), ("relative", _relative_to(out))):
        record[name] = [turn(p) for p in given] if isinstance(given, tuple) else turn(given)
    return record


def _relative_to(out: Path) -> Callable[[Path], str | None]:
    def turn(path: Path) -> str | None:
        try:
            return os.path.relpath(os.path.realpath(path), os.path.realpath(out))
        except ValueError:  # another drive
            return None

    return turn


def places(source: dict[str, Any], folder: Path) -> list[list[Path]]:
    """Return where the frames of a result may be, the likeliest first; each a list of paths."""
    found = [_place(source.get(name), folder) for name in ("relative", "path")]
    return [place for place in found if place]


def geometry_record(inspection: Inspection) -> dict[str, Any]:
    """Return crossing points and calibration, which a later run can start from."""
    crossings, calibration = inspection.crossings, inspection.calibration
    assert crossings is not None
    assert calibration is not None
    return {
        "crossings": [vars(frame) for frame in crossings.frames],
        "calibration": {
            name: value
            for name, value in vars(calibration).items()
            if name not in {"layout", "camera"}
        },
        "camera": {"K": calibration.camera.K, "kappa": calibration.camera.kappa},
    }


def read_geometry(
    folder: Path, layout: ModuleLayout
) -> tuple[Crossings | None, Calibration | None]:
    """Read crossing points and calibration of a result folder; None where it has no such file.

    Raises
    ------
    InspectionError
        If the file is damaged.
    """
    path = folder / GEOMETRY_JSON
    if not path.is_file():
        return None, None
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        found = tuple(
            FrameCrossings(
                _array(frame["points_px"], (layout.n_crossings, 2)),
                np.nan_to_num(_array(frame["sigma_px"], (layout.n_crossings,)), nan=np.inf),
                np.array(frame["measured"], bool),
                str(frame["why"]),
                **_marks(frame),
            )
            for frame in record["crossings"]
        )
        fit = record["calibration"]
        n = len(found)
        camera = Camera(np.array(record["camera"]["K"], np.float64), record["camera"]["kappa"])
        sigma = fit["crossing_sigma_px"]
        calibration = Calibration(
            layout,
            camera,
            _array(fit["homographies"], (n, 3, 3)),
            np.array(fit["used"], bool),
            tuple(map(str, fit["why"])),
            _array(fit["rms_px"], (n,)),
            bool(fit["focal_convention"]),
            float(fit["kappa_std"]),
            None if sigma is None else _array(sigma, (n, layout.n_crossings)),
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InspectionError(
            f"{path} is damaged ({error}): run the inspection again, it starts with the detection."
        ) from None
    return Crossings(layout, found), calibration


def _marks(frame: dict[str, Any]) -> dict[str, Any]:
    """What is optional in `FrameCrossings`: flags of single points."""
    optional = (f.name for f in fields(FrameCrossings) if f.default is None)
    return {k: np.array(frame[k], bool) for k in optional if frame.get(k) is not None}


def _place(given: Any, folder: Path) -> list[Path]:
    """Paths of one record, out of the folder where they are relative; empty if unknown."""
    given = given if isinstance(given, list) else [given]
    return [] if None in given else [Path(os.path.normpath(folder / path)) for path in given]


def _array(values: Any, shape: tuple[int, ...]) -> Array:
    """Numbers out of JSON, None being NaN."""
    array = np.array(values, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"an array of {array.shape} where {shape} is expected")
    return array
