"""Which module a sequence is about, where its frames show several."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pv_inspect.calibration.calibrate import Calibration
from pv_inspect.detection.crossings import Crossings
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose
from pv_inspect.module_choice.frame_agreement import FrameGroups, Placement, group_frames
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings

__all__ = ["ModuleChoice", "choose_module"]

T = TypeVar("T", bound=np.generic)

LONGEST_LIST = 180
"""Characters that the modules may take in a message."""
LONGEST_NAME = 40
CUT_CELLS = 0.3
"""By less a frame does not count as one that cuts the module: its outline may touch the border."""


@dataclass(frozen=True, eq=False)
class ModuleChoice:
    """Frames of one module.

    Parameters
    ----------
    why : tuple of str
        Why a frame is left out: it shows another module; "" for all others.
    placements : tuple of Placement
        What brings the grids of the frames of the module onto each other.
    comparable : bool
        Whether frames of another module would have been noticed.
    """

    why: tuple[str, ...]
    placements: tuple[Placement, ...]
    comparable: bool = True

    def of_calibration(self, calibration: Calibration) -> Calibration:
        """Return the calibration with the frames of other modules left out, on one grid."""
        if not any(self.why) and all(placement == Placement() for placement in self.placements):
            return calibration
        layout = calibration.layout
        homographies = calibration.homographies.copy()
        sigma = calibration.crossing_sigma_px
        sigma = None if sigma is None else sigma.copy()
        for i, placement in enumerate(self.placements):
            if placement == Placement():
                continue
            back = np.eye(3)
            back[:2, 2] = -placement.cols, -placement.rows / layout.cell_aspect
            pose = Pose(calibration.camera, homographies[i] @ back)
            homographies[i] = pose.turned(layout.size, layout.size, placement.turn).homography
            if sigma is not None:
                sigma[i] = _placed(sigma[i], layout, placement, np.nan)
        return replace(
            calibration,
            homographies=homographies,
            used=calibration.used & np.array([not reason for reason in self.why]),
            why=tuple(old or new for old, new in zip(calibration.why, self.why, strict=True)),
            crossing_sigma_px=sigma,
        )

    def of_crossings(self, crossings: Crossings) -> Crossings:
        """Return the crossing points with the frames of other modules left out, on one grid."""
        layout = crossings.layout
        frames = (
            replace(
                frame,
                points_px=_placed(frame.points_px, layout, placement, np.nan),
                sigma_px=_placed(frame.sigma_px, layout, placement, np.inf),
                measured=_placed(frame.measured, layout, placement, False),
                edited=None
                if frame.edited is None
                else _placed(frame.edited, layout, placement, False),
                why=frame.why or why,
            )
            for frame, placement, why in zip(
                crossings.frames, self.placements, self.why, strict=True
            )
        )
        return replace(crossings, frames=tuple(frames))


def choose_module(
    sequence: FrameSequence, calibration: Calibration, settings: Settings
) -> ModuleChoice:
    """Choose the module that most frames show, or the one that a person names.

    Parameters
    ----------
    sequence : FrameSequence
    calibration : Calibration
        Poses of the frames.
    settings : Settings
        ``module_of`` names a frame of the wanted module. ``skip_frames`` do not count;
        ``keep_frames`` are used whatever they show.

    Returns
    -------
    ModuleChoice

    Raises
    ------
    InspectionError
        If no module is shown by more than half of the frames and none is named.
    """
    skipped, kept = (
        set(sequence.indices(names)) for names in (settings.skip_frames, settings.keep_frames)
    )
    frames = [int(i) for i in np.flatnonzero(calibration.used) if i not in skipped]
    wanted = _wanted(sequence, calibration, settings, frames)
    count = len(sequence)
    if len(frames) < 2 or (wanted is None and _parts_only(calibration, frames, sequence.shape)):
        return ModuleChoice(("",) * count, (Placement(),) * count)
    found = group_frames(sequence, calibration, frames)
    chosen = _chosen(sequence, found, kept, wanted)
    why, placements = [""] * count, [Placement()] * count
    for number, group in enumerate(found.groups):
        for i in group:
            placements[i] = found.placements[i]
            if number != chosen and i not in kept:
                why[i] = _reason(found, number, chosen, named=wanted is not None)
    return ModuleChoice(tuple(why), tuple(placements), found.comparable)


def _parts_only(calibration: Calibration, frames: list[int], shape: tuple[int, int]) -> bool:
    """Whether no frame shows the whole module.

    The detection has then put the frames together by the details of their cells: what fits no
    other frame is left out already, and two parts may have hardly a cell in common.
    """
    last = np.array([shape[1], shape[0]]) - 1
    for i in frames:
        px = calibration.crossings_px(i)
        slack = CUT_CELLS * float(np.linalg.norm(px[1] - px[0]))
        if np.all((px >= -slack) & (px <= last + slack)):
            return False
    return True


def _wanted(
    sequence: FrameSequence, calibration: Calibration, settings: Settings, frames: list[int]
) -> int | None:
    """Return the frame that names the module."""
    if settings.module_of is None:
        return None
    (wanted,) = sequence.indices([settings.module_of])
    if wanted not in frames:
        reason = calibration.why[wanted].rstrip(".") or "it is left out"
        raise InspectionError(
            f"The module of frame {settings.module_of} is wanted, but that frame can't be used "
            f"({reason}): name another frame of this module (module_of, --module-of)."
        )
    return wanted


def _chosen(sequence: FrameSequence, found: FrameGroups, kept: set[int], wanted: int | None) -> int:
    """Return the number of the group to use."""
    for number, group in enumerate(found.groups):
        if wanted is not None:
            if wanted in group:
                return number
            continue
        others = {i for other in found.groups if other != group for i in other} - kept
        if len(group) > len(others):
            return number
    raise InspectionError(_refusal(sequence, found.groups))


def _refusal(sequence: FrameSequence, groups: tuple[tuple[int, ...], ...]) -> str:
    listed: list[str] = []
    for group in groups:
        name = sequence.names[group[0]]
        name = name if len(name) <= LONGEST_NAME else f"...{name[3 - LONGEST_NAME :]}"
        others = len(group) - 1
        text = f"{name} and {others} more" if others else name
        if len("; ".join([*listed, text])) > LONGEST_LIST:
            listed.append("...")
            break
        listed.append(text)
    total = sum(len(group) for group in groups)
    return (
        f"These {total} frames look like {len(groups)} modules ({'; '.join(listed)}): run each "
        "module by itself, or name a frame of the one to be used (module_of, --module-of)."
    )


def _reason(found: FrameGroups, number: int, chosen: int, *, named: bool) -> str:
    between, within = found.agreement[number, chosen], found.agreement[chosen, chosen]
    n = len(found.groups[chosen])
    frames = f"{n} frames" if n > 1 else "frame"
    which = "of the module that was asked for" if named else "of the largest group"
    about = f"agreement {between:.2f}"
    if np.isfinite(within):
        about += f", within the group {within:.2f}"
    return f"it shows another module than the {frames} {which} ({about})"


def _placed(
    values: NDArray[T], layout: ModuleLayout, placement: Placement, unknown: float | bool
) -> NDArray[T]:
    """Values of the crossing points, (n_crossings, ...), in the order of another grid."""
    shape = (layout.rows + 1, layout.cols + 1, *values.shape[1:])
    moved = np.roll(values.reshape(shape), (placement.rows, placement.cols), (0, 1))
    for axis, by in ((0, placement.rows), (1, placement.cols)):
        beyond = slice(0, by) if by > 0 else slice(shape[axis] + by, shape[axis])
        np.moveaxis(moved, axis, 0)[beyond] = unknown
    return np.rot90(moved, placement.turn).reshape(values.shape)
