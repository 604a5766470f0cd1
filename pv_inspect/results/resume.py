"""A result folder taken up again: its frames found, its inspection as it was written."""

from __future__ import annotations

import numpy as np

from pv_inspect.cells import cut_cells
from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.registration.registration import Registration
from pv_inspect.results.geometry_record import exists, places, read_geometry
from pv_inspect.results.record import Result
from pv_inspect.results.sensor_correction import read_photometry
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["reopen", "resume"]


def reopen(result: Result) -> FrameSequence:
    """Open the frames that a result was made of.

    The way from the result folder is tried first: folders move together.

    Raises
    ------
    InspectionError
        If they are not where they were, or are others now.
    """
    source = result.record.get("source", {})
    known = places(source, result.folder)
    found = [place for place in known if all(exists(path) for path in place)]
    if not found:
        where = f" at {known[-1][0]}" if known else ""
        raise InspectionError(
            f"The frames of {result.folder} are no longer{where}: what was made of them can be "
            "looked at, but nothing can be computed; open the frames themselves for that."
        )
    given = source["path"]
    opened = FrameSequence.open(
        found[0] if isinstance(given, list) else found[0][0],
        result.settings.dark_frame,
        result.settings.flat_frame,
        result.settings.read_limits,
        result.settings.series,
    )
    names = tuple(frame.file for frame in result.frames)
    if opened.names != names:
        raise InspectionError(
            f"{opened.source} holds other frames than those that {result.folder} was made of "
            f"({len(opened)} instead of {len(names)}, or other names): open it as a new sequence."
        )
    return opened


def resume(result: Result, sequence: FrameSequence) -> Inspection:
    """Build the inspection that a result folder was written from.

    Without ``geometry.json`` (results of earlier versions) the crossing points are missing: what
    is there can be looked at, and a run starts with the detection.

    Parameters
    ----------
    result : Result
    sequence : FrameSequence
        Its frames, from `reopen`.

    Raises
    ------
    InspectionError
        If the record of the geometry is damaged.
    """
    layout, record = result.grid.layout, result.record
    frames = record["frames"]
    nothing = float("nan")
    registration = Registration(
        layout,
        result.camera,
        np.array([np.full((3, 3), np.nan) if f.H is None else f.H for f in result.frames]),
        np.array([f.used for f in result.frames]),
        tuple(f.why for f in result.frames),
        np.array([1.0 if np.isnan(f.gain) else f.gain for f in result.frames]),
        np.array([0.0 if np.isnan(f.offset) else f.offset for f in result.frames]),
        np.array([f.rms for f in result.frames]),
    )
    reconstruction = Reconstruction(
        result.image,
        result.support,
        result.grid,
        result.prior_weight,
        result.psf_sigma_lr_px,
        tuple(_numbers(record["solver"]["objective"])),
        bool(record["solver"]["converged"]),
        result.consistency,
        tuple(_numbers([f["residual"] for f in frames])),
        tuple((m[0], m[1]) for m in (f["motion_px_deg"] or (0.0, 0.0) for f in frames)),
        int(record["solver"]["iterations"]),
        tuple(
            (nothing if a is None else a, nothing if b is None else b)
            for a, b in record["lambda_curve"]
        ),
        photometry=read_photometry(
            result.folder, record, result.camera, len(result.frames), sequence.shape
        ),
    )
    crossings, calibration = read_geometry(result.folder, layout, len(result.frames))
    seconds = {stage: t for stage, t in result.seconds.items() if stage != "total"}
    return Inspection(
        sequence,
        result.settings,
        layout,
        crossings,
        calibration,
        registration,
        reconstruction,
        cut_cells(reconstruction),
        result.crack_map,
        seconds,
        result.warnings,
        layout_guessed=bool(record.get("layout_guessed", False)),
        doubts=result.doubts,
    )


def _numbers(values: list[float | None]) -> list[float]:
    return [float("nan") if value is None else float(value) for value in values]
