"""The module in a sequence of which every frame shows a part (see `joined_views`)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Mapping
from contextlib import suppress
from functools import partial

import numba
import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.parallel import parallel_map
from pv_inspect.common.work import Progress
from pv_inspect.detection.grid_of_a_part import grid_of_part
from pv_inspect.detection.joined_views import (
    NO_PLACE,
    beside_others,
    joined_picture,
    lies_on,
    of_another_aspect,
    poses_together,
)
from pv_inspect.detection.outline import OutlineError
from pv_inspect.detection.overlapping_view import found_beside, nearest
from pv_inspect.detection.seen_part import Part, part_of, part_of_module
from pv_inspect.detection.single_frame import Found, detect_in_frame
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["found_together"]

# No search for these constants is on record: they were set by hand on seeds 0 to 3 of
# `python benchmarks/partial_views.py`.

PROBED = 6
BESIDE = "where its cells lie does not go with what the other frames show"
UNLIKE = "its cells are of another aspect than those of the other frames, as on busbars"
NARROW_SEARCHES = (0.04, 0.04)
"""Half widths of the searches across a gap, cells: the grid of a part is right to 0.01."""
LEAST_SHARE_FOUND = 0.5
"""Share of the joined frames in which the borders of the whole grid must be in place."""


def found_together(
    sequence: FrameSequence, layout: ModuleLayout, indices: Collection[int]
) -> Generator[Progress, None, tuple[dict[int, Found], dict[int, OutlineError]]]:
    """Find the module in frames each of which shows a part of it.

    Parameters
    ----------
    sequence : FrameSequence
    layout : ModuleLayout
        Without wide gaps.
    indices : collection of int
        The frames.

    Yields
    ------
    Progress

    Returns
    -------
    dict of int to Found
    dict of int to OutlineError
        Why other frames are left out.

    Raises
    ------
    OutlineError
        If the parts do not make the whole module, or not in one way only.
    """
    parts: dict[int, Part] = {}
    reasons: dict[int, OutlineError] = {}
    order, together = sorted(indices), 2 * numba.get_num_threads()
    # Frames from all parts of the sequence first: without a grid in any of them, it is in none.
    order = list(dict.fromkeys([*order[:: max(1, len(order) // PROBED)], *order]))
    for begin in range(0, len(order), together):
        batch = order[begin : begin + together]
        images = [sequence.frame(k).image for k in batch]
        look = partial(_seen, cell_aspect=layout.cell_aspect)
        for k, seen in zip(batch, parallel_map(look, images), strict=True):
            if isinstance(seen, OutlineError):
                reasons[k] = seen
            else:
                parts[k] = seen
        if not parts and len(reasons) >= PROBED:
            raise next(iter(reasons.values()))
        yield Progress((begin + len(batch)) / len(order), "looking for the grid of each part")
    try:
        poses = poses_together(parts, layout)
    except OutlineError as error:
        if len(parts) == len(order):
            raise
        some = f"the grid of cells is seen in only {len(parts)} of {len(order)}, and {error}"
        raise OutlineError(some) from None
    found: dict[int, Found] = {}
    for k in parts:
        if k not in poses:
            reasons[k] = OutlineError(NO_PLACE)
            continue
        outcome = _detected(sequence.frame(k).image, layout, poses[k])
        if isinstance(outcome, OutlineError):
            reasons[k] = outcome
        else:
            found[k] = outcome
    checks: tuple[tuple[Callable[[], list[int]], str], ...] = (
        (lambda: of_another_aspect({k: one.pose for k, one in found.items()}), UNLIKE),
        (lambda: beside_others(_seen_at_last(sequence, layout, found)), BESIDE),
    )
    for unlike_others, why in checks:
        for k in unlike_others():
            del found[k]
            reasons[k] = OutlineError(why)
    if len(found) < max(2, LEAST_SHARE_FOUND * len(poses)):
        first = next(str(reasons[k]) for k in poses if k in reasons)
        raise OutlineError(f"the grid of the whole does not lie on the parts ({first})")
    for k, one in _found_from_others(sequence, layout, found, list(reasons)).items():
        found[k] = one
        del reasons[k]
    return found, reasons


def _seen_at_last(
    sequence: FrameSequence, layout: ModuleLayout, found: Mapping[int, Found]
) -> dict[int, Part]:
    return {
        k: part_of_module(sequence.frame(k).image, one.pose, layout.cell_aspect)
        for k, one in found.items()
    }


def _found_from_others(
    sequence: FrameSequence, layout: ModuleLayout, found: Mapping[int, Found], left: list[int]
) -> dict[int, Found]:
    """Find the module in frames whose own grid was not seen, or was seen on busbars."""
    together = joined_picture(_seen_at_last(sequence, layout, found))
    poses = {k: one.pose for k, one in found.items()}

    def look(index: int, start: Pose) -> Found:
        image = sequence.frame(index).image
        outcome = _detected(image, layout, start)
        if isinstance(outcome, OutlineError):
            raise outcome
        if index in of_another_aspect({**poses, index: outcome.pose}):
            raise OutlineError(UNLIKE)
        if not lies_on(part_of_module(image, outcome.pose, layout.cell_aspect), together):
            raise OutlineError(BESIDE)
        return outcome

    def search(index: int) -> Found | None:
        others = ((sequence.frame(k).image, poses[k]) for k in nearest(poses, index))
        with suppress(OutlineError):
            return found_beside(sequence.frame(index).image, others, partial(look, index))
        return None

    outcomes = zip(left, parallel_map(search, left), strict=True)
    return {k: one for k, one in outcomes if one is not None}


def _detected(image: NDArray[np.float32], layout: ModuleLayout, pose: Pose) -> Found | OutlineError:
    """Read the crossing points: the grid lies on the borders by now, unless it lay on busbars."""
    with suppress(OutlineError):
        return detect_in_frame(image, layout, pose, searches=NARROW_SEARCHES)
    try:
        return detect_in_frame(image, layout, pose)
    except OutlineError as error:
        return error


def _seen(image: NDArray[np.float32], cell_aspect: float) -> Part | OutlineError:
    try:
        return part_of(image, grid_of_part(image, cell_aspect), cell_aspect)
    except OutlineError as error:
        return error
