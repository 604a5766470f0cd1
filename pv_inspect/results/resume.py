"""A result folder taken up again: its frames found, its inspection as it was written."""

from __future__ import annotations

from dataclasses import replace

from pv_inspect.errors import InspectionError
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.inspection.stored import StoredResult
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.registration.registration import Registration
from pv_inspect.results.geometry_record import exists, places, read_geometry
from pv_inspect.results.sensor_correction import read_photometry
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["reopen", "resume"]


def reopen(result: Inspection) -> FrameSequence:
    """Open the frames that a result was made of.

    The way from the result folder is tried first: folders move together.

    Parameters
    ----------
    result : Inspection
        From `read_result`.

    Raises
    ------
    InspectionError
        If they are not where they were, or are others now.
    """
    stored = _stored(result)
    source = stored.record["source"]
    known = places(source, stored.folder)
    found = [place for place in known if all(exists(path) for path in place)]
    if not found:
        where = f" at {known[-1][0]}" if known else ""
        raise InspectionError(
            f"The frames of {stored.folder} are no longer{where}: what was made of them can be "
            "looked at, but nothing can be computed; open the frames themselves for that."
        )
    given = source["path"]
    opened = FrameSequence.open(
        found[0] if isinstance(given, list) else found[0][0],
        result.settings.dark_frame,
        result.settings.flat_frame,
        result.settings.read_limits,
        result.settings.series,
        # As it was found then, whatever is found now.
        bool(stored.record["lock_in"]),
    )
    if opened.names != stored.names:
        raise InspectionError(
            f"{opened.source} holds other frames than those that {stored.folder} was made of "
            f"({len(opened)} instead of {len(stored.names)}, or other names): open it as a new "
            "sequence."
        )
    return opened


def resume(result: Inspection, sequence: FrameSequence) -> Inspection:
    """Add to a result that was read what needs its frames: the inspection as it was written.

    Without ``geometry.json`` (results of earlier versions) the crossing points are missing: what
    is there can be looked at, and a run starts with the detection.

    Parameters
    ----------
    result : Inspection
        From `read_result`.
    sequence : FrameSequence
        Its frames, from `reopen`.

    Raises
    ------
    InspectionError
        If the record of the geometry or of the sensor is damaged.
    """
    stored, made = _stored(result), result.need(Reconstruction)
    n_frames, camera = len(stored.names), result.need(Registration).camera
    photometry = read_photometry(stored.folder, stored.record, camera, n_frames, sequence.shape)
    crossings, calibration = read_geometry(stored.folder, result.layout, n_frames)
    return replace(
        result,
        sequence=sequence,
        crossings=crossings,
        calibration=calibration,
        reconstruction=replace(made, photometry=photometry),
    )


def _stored(result: Inspection) -> StoredResult:
    assert result.stored is not None, "it was read from a result folder"
    return result.stored
