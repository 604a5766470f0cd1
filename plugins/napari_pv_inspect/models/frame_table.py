"""Rows of the frame list, and the settings that follow from its ticks. No Qt."""

from __future__ import annotations

from dataclasses import dataclass

from pv_inspect.inspection.inspection import Inspection
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings

__all__ = ["FrameRow", "frame_rows", "ticked"]


@dataclass(frozen=True)
class FrameRow:
    """One frame.

    Parameters
    ----------
    name : str
    grid_px : float
        Distance of the measured crossing points from the fitted grid (RMS), LR px; NaN: unknown.
    residual : float
        Against the module image, in units of the noise; NaN: unknown, there is no image yet.
    motion_px : float
        Length of the motion blur, LR px; NaN: unknown.
    used : bool or None
        None: not known yet.
    status : str
        "used", or why it is not used.
    wanted : bool
        The tick: whether the next run is going to use it, as far as is known.
    """

    name: str
    grid_px: float
    residual: float
    motion_px: float
    used: bool | None
    status: str
    wanted: bool


def frame_rows(
    sequence: FrameSequence | None, inspection: Inspection | None, settings: Settings
) -> tuple[FrameRow, ...]:
    """Return one row for every frame of the sequence."""
    if sequence is None:
        return ()
    skipped, kept = set(settings.skip_frames), set(settings.keep_frames)
    rows = []
    for i, name in enumerate(sequence.names):
        used, why = _used(inspection, i)
        by_user = _left_out_by_user(inspection, name)
        wanted = name not in skipped and (name in kept or by_user or used is not False)
        grid, residual, motion = _numbers(inspection, i)
        if (reason := sequence.no_measurements.get(i)) is not None and not by_user:
            rows.append(FrameRow(name, grid, residual, motion, False, reason, wanted=False))
            continue
        left_out = "left out by you" if by_user else f"rejected: {why}" if why else "rejected"
        status = _status(used, left_out, wanted)
        rows.append(FrameRow(name, grid, residual, motion, used, status, wanted))
    return tuple(rows)


def ticked(settings: Settings, row: FrameRow, wanted: bool) -> Settings:
    """Return the settings after the tick of a row was set or taken away."""
    skip = [name for name in settings.skip_frames if name != row.name]
    keep = [name for name in settings.keep_frames if name != row.name]
    was_skipped = row.name in settings.skip_frames
    if not wanted and not (row.used is False and row.name in settings.keep_frames):
        skip.append(row.name)
    if wanted and not was_skipped and row.used is False:
        keep.append(row.name)
    return settings.changed(skip_frames=tuple(skip), keep_frames=tuple(keep))


def _used(inspection: Inspection | None, i: int) -> tuple[bool | None, str]:
    if inspection is None:
        return None, ""
    poses = inspection.registration or inspection.calibration
    if poses is not None:
        return bool(poses.used[i]), poses.why[i]
    if inspection.crossings is not None and (why := inspection.crossings.frames[i].why):
        return False, why
    return None, ""


def _left_out_by_user(inspection: Inspection | None, name: str) -> bool:
    return inspection is not None and name in inspection.settings.skip_frames


def _numbers(inspection: Inspection | None, i: int) -> tuple[float, float, float]:
    grid = residual = motion = float("nan")
    if inspection is None:
        return grid, residual, motion
    if inspection.calibration is not None:
        grid = float(inspection.calibration.rms_px[i])
    made, poses = inspection.reconstruction, inspection.registration
    if made is not None and poses is not None and poses.used[i]:
        residual, motion = float(made.residual_rms[i]), float(made.motion[i][0])
    return grid, residual, motion


def _status(used: bool | None, left_out: str, wanted: bool) -> str:
    if used is None:
        return "" if wanted else "to be left out"
    if used:
        return "used" if wanted else "to be left out"
    return f"{left_out}; the next run tries it" if wanted else left_out
