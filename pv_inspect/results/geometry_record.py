"""What a result came from: where its frames lie, and the geometry that a later run starts from."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pv_inspect.calibration.calibrate import Calibration
from pv_inspect.common.records import checked, json_from, read_text
from pv_inspect.detection.crossings import Crossings, FrameCrossings
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.results.records import GeometryRecord
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["GEOMETRY_JSON", "exists", "geometry_record", "places", "read_geometry", "source_record"]

GEOMETRY_JSON = "geometry.json"


def source_record(sequence: FrameSequence, out: Path) -> dict[str, Any]:
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


def exists(path: Path) -> bool:
    """Whether there is something at a place that may be no place at all."""
    try:
        return path.exists()
    except (OSError, ValueError):  # a name that is too long, or with a zero in it
        return False


def geometry_record(inspection: Inspection) -> dict[str, Any]:
    """Return crossing points and calibration, which a later run can start from."""
    crossings, calibration = inspection.need(Crossings), inspection.need(Calibration)
    return {
        "format": GeometryRecord.newest_format,
        "crossings": [vars(frame) for frame in crossings.frames],
        "calibration": {
            name: value
            for name, value in vars(calibration).items()
            if name not in {"layout", "camera"}
        },
        "camera": {"K": calibration.camera.K, "kappa": calibration.camera.kappa},
    }


def read_geometry(
    folder: Path, layout: ModuleLayout, n_frames: int
) -> tuple[Crossings | None, Calibration | None]:
    """Read crossing points and calibration of a result folder; None where it has no such file.

    Raises
    ------
    InspectionError
        If the file is damaged, or of another layout or number of frames.
    """
    path = folder / GEOMETRY_JSON
    if not path.exists():
        return None, None
    try:
        record = checked(GeometryRecord, json_from(read_text(path)))
        if len(record.crossings) != n_frames:
            raise ValueError(
                f"crossings has {len(record.crossings)} frames, the result has {n_frames}"
            )
        if (misfit := record.misfit(layout.n_crossings)) is not None:
            raise ValueError(misfit)
        camera = Camera(np.array(record.camera.K, np.float64), record.camera.kappa)
    except (OSError, ValueError, InspectionError) as error:
        raise InspectionError(
            f"{path} is damaged ({error}): run the inspection again, it starts with the detection."
        ) from None
    found = tuple(
        FrameCrossings(
            np.array(frame.points_px, np.float64),
            np.nan_to_num(np.array(frame.sigma_px, np.float64), nan=np.inf),
            np.array(frame.measured, bool),
            frame.why,
            None if frame.edited is None else np.array(frame.edited, bool),
        )
        for frame in record.crossings
    )
    fit = record.calibration
    sigma = fit.crossing_sigma_px
    calibration = Calibration(
        layout,
        camera,
        np.array(fit.homographies, np.float64),
        np.array(fit.used, bool),
        tuple(fit.why),
        np.array(fit.rms_px, np.float64),
        fit.focal_convention,
        np.nan if fit.kappa_std is None else fit.kappa_std,
        None if sigma is None else np.array(sigma, np.float64),
    )
    return Crossings(layout, found), calibration


def _place(given: Any, folder: Path) -> list[Path]:
    """Paths of one record, out of the folder where they are relative; empty if unknown."""
    given = given if isinstance(given, list) else [given]
    return [] if None in given else [Path(os.path.normpath(folder / path)) for path in given]
