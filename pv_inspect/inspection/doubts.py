"""What a person has to know before a result is used: doubts first, then warnings."""

from __future__ import annotations

import numpy as np

from pv_inspect.common.gap_text import gap_text
from pv_inspect.cracks import CrackMap
from pv_inspect.detection.filled_frame import hidden_sides
from pv_inspect.detection.orientation import runs_down
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose
from pv_inspect.inspection.coverage import unseen_sentence
from pv_inspect.inspection.figures import known_median
from pv_inspect.inspection.inspection import Inspection
from pv_inspect.reconstruction.reconstruction import Reconstruction
from pv_inspect.reconstruction.sampling import FEW, STILL, sampling_of
from pv_inspect.registration.registration import Registration
from pv_inspect.sequence.copies import copies_sentence
from pv_inspect.sequence.lock_in import lock_in_sentence

__all__ = [
    "CONTRADICTION",
    "doubts_of",
    "left_out",
    "no_super_resolution",
    "not_used_sentence",
    "quarter_turn_sentence",
    "warnings_of",
]

CONTRADICTION = 2.5
"""Median residual of the frames, in units of their noise, from which on a result is in doubt.

Seven photographs of different modules gave 6 to 8, simulated sequences 0.8 to 1."""


OVER_FIT = 0.4
"""Median residual of the frames, in units of their noise, below which a user is warned.

Simulated sequences of 2 to 20 frames, of 8 and 12 bit and with usual and low noise, gave 0.52 to
0.92; single frames, which nothing keeps from following their noise, 0.15 to 0.33; a given PSF that
is far too narrow 0 to 0.2."""


def doubts_of(inspection: Inspection) -> tuple[str, ...]:
    """Say why a result must not be relied on.

    Parameters
    ----------
    inspection : Inspection
        With all its parts.

    Returns
    -------
    tuple of str
        One sentence each, the gravest first; empty if there is no doubt.
    """
    registration = inspection.need(Registration)
    unseen = unseen_sentence(registration, inspection.frames.shape)
    sentences = (
        registration.misfit,
        _contradiction(inspection),
        unseen,
        _blindness(inspection),
    )
    return tuple(sentence for sentence in sentences if sentence)


def warnings_of(inspection: Inspection) -> tuple[str, ...]:
    """Say what is worth knowing about a result and puts none of it in doubt.

    Parameters
    ----------
    inspection : Inspection
        With all its parts.

    Returns
    -------
    tuple of str
        One sentence each.
    """
    layout, registration = inspection.layout, inspection.need(Registration)
    sequence = inspection.frames
    used = int(registration.used.sum())
    plain = no_super_resolution(registration, sequence.shape)
    found = [*([plain] if plain else []), *sequence.warnings]
    if inspection.layout_guessed:
        found.append(
            f"Rows and columns were not given: {layout.rows} x {layout.cols} cells of "
            f"aspect {layout.cell_aspect:g} guessed{_runner_up(inspection)}, please confirm."
        )
    if inspection.gaps_found:
        found.append(_seen_gaps(layout))
    sentences = (
        lock_in_sentence(sequence.lock_in, confirm=inspection.settings.lock_in is None),
        copies_sentence(sequence.copies, sequence.names),
        quarter_turn_sentence(registration),
        _no_end_seen(registration, sequence.shape),
    )
    found += [sentence for sentence in sentences if sentence]
    if used > 1 and not registration.comparable:
        found.append(
            "The cells look so much alike in these frames that frames of another module would not "
            "be noticed."
        )
    found += [sentence for sentence in (_over_fit(inspection), _unfinished(inspection)) if sentence]
    return (*found, *(not_used_sentence(*frame) for frame in left_out(inspection)))


def no_super_resolution(registration: Registration, shape: tuple[int, int]) -> str:
    """Say if the frames together show no more than one of them; told before anything else.

    Parameters
    ----------
    registration : Registration
    shape : tuple of int
        (height, width) of a frame.

    Returns
    -------
    str
        Empty if they show more.
    """
    used, total = int(registration.used.sum()), len(registration.used)
    if used == 1:
        which = "1 frame" if total == 1 else f"1 frame of {total} could be used"
        return (
            f"{which}: the result is a rectified single frame, not a super-resolution. Narrow or "
            "faint cracks that more frames would show may be missing."
        )
    sampling = sampling_of(registration, shape)
    if sampling < STILL:
        return (
            f"The {used} frames show the module in the same place: the result is a rectified "
            "frame with less noise, not a super-resolution. Move the camera a little from frame to "
            "frame."
        )
    if sampling < FEW:
        return (
            f"The {used} frames stand in too few different places between the pixels: the result "
            "shows little more detail than one frame. Take more frames with small movements "
            "between them."
        )
    return ""


def _runner_up(inspection: Inspection) -> str:
    other = inspection.runner_up
    if other is None:
        return ""
    return f" ({other.rows} x {other.cols} of aspect {other.cell_aspect:g} fit nearly as well)"


def _seen_gaps(layout: ModuleLayout) -> str:
    """Say which gaps were found in the frames, and how to give them."""
    options = [
        f"{option} {gap_text(gaps)}"
        for option, gaps in (("--row-gaps", layout.row_gaps), ("--col-gaps", layout.col_gaps))
        if gaps
    ]
    if any(layout.cell_gap):
        options.append(f"--cell-gap {layout.cell_gap[0]:.3g}")
    return (
        f"The frames show gaps wider than usual, in cell widths: {layout.gaps_in_words}; please "
        f"confirm them ({' '.join(options)})."
    )


def left_out(inspection: Inspection) -> tuple[tuple[str, str], ...]:
    """Return every frame that is not used, but for those that one warning tells of together.

    These are copies, and by daylight the frames without current.

    Parameters
    ----------
    inspection : Inspection
        Registered.

    Returns
    -------
    tuple of (str, str)
        Name and reason.
    """
    registration = inspection.need(Registration)
    sequence = inspection.sequence
    told = set() if sequence is None else {*sequence.copies, *sequence.without_current}
    frames = zip(inspection.names, registration.used, registration.why, strict=True)
    return tuple(
        (name, why) for k, (name, ok, why) in enumerate(frames) if not ok and k not in told
    )


def not_used_sentence(name: str, why: str) -> str:
    """Say why a frame is not used."""
    return f"{name} is not used: {(why or 'not used').rstrip('.')}."


def quarter_turn_sentence(registration: Registration) -> str:
    """Say if the rows of the module run down the frames, as when rows and columns are swapped.

    Parameters
    ----------
    registration : Registration

    Returns
    -------
    str
        Empty if the rows run across in most frames, or the module looks the same either way.
    """
    layout, used = registration.layout, np.flatnonzero(registration.used)
    if layout.rows == layout.cols or not len(used):
        return ""
    poses = [Pose(registration.camera, registration.homographies[i]) for i in used]
    if not runs_down(layout, poses):
        return ""
    aspect = f" --cell-aspect {1 / layout.cell_aspect:g}" if layout.cell_aspect != 1 else ""
    return (
        f"The frames show the module with {layout.cols} rows and {layout.rows} columns, turned by "
        "a quarter from the given ones: if rows and columns were swapped, give --rows "
        f"{layout.cols} --cols {layout.rows}{aspect}."
    )


def _no_end_seen(registration: Registration, shape: tuple[int, int]) -> str:
    """Say where the module fills the frames to their edge, so that it may go on outside."""
    used = np.flatnonzero(registration.used)
    poses = [Pose(registration.camera, registration.homographies[i]) for i in used]
    hidden = hidden_sides(registration.layout, poses, shape) if poses else []
    if not hidden:
        return ""
    return (
        f"The frames end at the {', '.join(hidden)} of the module: whether it goes on there can't "
        "be seen, please confirm rows and columns."
    )


def _contradiction(inspection: Inspection) -> str:
    registration = inspection.need(Registration)
    typical = known_median(inspection.need(Reconstruction).residual_rms)
    if not typical > CONTRADICTION:
        return ""
    if registration.used.sum() == 1:
        return (
            f"The module image differs from the only frame by {typical:.1f} times its noise, "
            "typically 1: its intensities or its noise were misjudged."
        )
    return (
        f"The frames contradict the module image by {typical:.1f} times their noise, typically "
        "1: check that all of them show the same module and that the grid fits them."
    )


def _over_fit(inspection: Inspection) -> str:
    """Say if the image repeats the noise of the frames, or the frames have none of their own."""
    typical = known_median(inspection.need(Reconstruction).residual_rms)
    if not typical < OVER_FIT:
        return ""
    if inspection.need(Registration).used.sum() == 1:
        return (
            f"The image follows the only frame down to {typical:.2f} times its noise (about 1 is "
            "right): its finest structure may be noise."
        )
    return (
        f"The frames agree better than their noise allows (residual {typical:.2f}, about 1 is "
        "right): the image repeats their noise, or they were smoothed or are copies of one "
        "exposure; its finest structure may be noise."
    )


def _unfinished(inspection: Inspection) -> str:
    """Say if the reconstruction ended before it had converged."""
    reconstruction = inspection.need(Reconstruction)
    if reconstruction.converged:
        return ""
    return (
        f"The reconstruction had not converged after {reconstruction.iterations} steps: "
        "raise max_iterations, or leave the prior's weight and the PSF to be estimated."
    )


def _blindness(inspection: Inspection) -> str:
    """Say if cracks would show in no cell at all: then the absence of cracks says nothing.

    A broad dark part makes a cell class C in any frame; that does not mean that cracks would show.
    """
    found = inspection.need(CrackMap)
    counts = found.counts
    seen = any(cell.supported and not (cell.undecidable or cell.dark) for cell in found.cells)
    if seen or not counts.total:
        return ""
    if counts.unfamiliar > counts.total // 2:
        todo = "look at the cells yourself, or try the detector 'ridge'"
    elif counts.blurred > counts.total // 2:
        todo = "the image is too blurred for cracks to show, take it in focus and from closer up"
    elif counts.undecidable:
        todo = (
            "take frames with more pixels per cell, less noise and no overexposure, or more of "
            "them with small movements between them"
        )
    else:
        todo = "check that current flows through the module"
    unjudged = counts.unjudged_text
    return f"{unjudged}, so that cells without marks may be cracked all the same: {todo}."
