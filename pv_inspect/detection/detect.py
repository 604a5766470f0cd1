"""Crossing points of the cells in every frame (stage *detect*).

The idea follows Hoffmann et al. 2019 (ref. [37] of the paper): a coarse pose from the outline of
the module, then profiles across the expected cell borders. Every gap between two cells is
measured as the position of a blurred dark line between two brightness levels, which is unbiased
where neighbouring cells differ in brightness; a crossing is where its measured gaps meet.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator
from contextlib import suppress
from functools import partial

import numba
import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.parallel import parallel_map
from pv_inspect.common.work import Progress
from pv_inspect.detection.crossings import Crossings, FrameCrossings
from pv_inspect.detection.dim_cells import module_with_dim_cells
from pv_inspect.detection.filled_frame import module_to_the_edge
from pv_inspect.detection.joined_views import SHOWN_TOGETHER
from pv_inspect.detection.large_frames import ReducedFrames, enlarged, reduction
from pv_inspect.detection.orientation import same_way_up
from pv_inspect.detection.outline import FILLED, OutlineError
from pv_inspect.detection.overlapping_view import found_beside, nearest
from pv_inspect.detection.partial_views import found_together
from pv_inspect.detection.seen_layout import better_layout, fits_given, found_around, seen_layout
from pv_inspect.detection.single_frame import (
    RUNS_OVER,
    Found,
    GridFaultError,
    TwoModulesError,
    completed_module,
    detect_in_frame,
    find_module,
)
from pv_inspect.detection.uneven_cells import said_of_uneven
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["detect"]

_MESSAGE = "looking for the cell crossings"
NEAR_CELLS = 0.5
"""A point may be so many cells beside the module that it chooses."""
PROBED_TOGETHER = 3
"""Frames from all parts of the sequence that are looked at before the others, all means tried. If
as many show the same other layout and none the given one, the given one is wrong."""
CUT = "the border of the image cuts the module, and what is seen of it does not fit other frames"
MAX_FAILED = 8
"""If so many frames show a bright area, but none the module, the others would not either."""


class _OtherLayoutError(OutlineError):
    """The gaps of other rows and columns are in place."""

    def __init__(self, reason: str, layout: ModuleLayout) -> None:
        super().__init__(f"{reason}; it shows {layout.rows} x {layout.cols} cells")
        self.reason = reason
        self.layout = layout


def detect(
    sequence: FrameSequence, layout: ModuleLayout, inside: tuple[float, float] | None = None
) -> Generator[Progress, None, Crossings]:
    """Find the crossing points in every frame.

    A frame in which the module is cut by the image border, or whose outline fails, is found again
    from the nearest frame that succeeded. If the border cuts it in all frames, the parts are put
    together, if they make the whole module in one way only. All frames are brought to the same way
    up. The rows and columns are checked in every frame by itself, so that wrong ones are refused
    after a few. Frames that repeat another one are not looked at.

    Parameters
    ----------
    sequence : FrameSequence
    layout : ModuleLayout
    inside : tuple of float, optional
        (x, y) of a point in the wanted module, pixels of the first frame, for frames that show
        several; by default the completely visible module nearest to the centre.

    Yields
    ------
    Progress

    Returns
    -------
    Crossings

    Raises
    ------
    InspectionError
        If no frame shows a module of that layout, or not at the given point, or if two modules
        are equally near to the centre.
    """
    factor = reduction(sequence, layout)
    if factor > 1:
        reduced = ReducedFrames(sequence, factor)
        search = detect(reduced.as_sequence(), layout, reduced.point(inside))
        return (yield from enlarged(search, factor))
    count = len(sequence)
    no_measurements = sequence.no_measurements
    found: dict[int, Found] = {}
    reasons: dict[int, OutlineError] = {}
    point = inside
    wished = _spread(count) if inside is None else range(count)
    order = [k for k in wished if k not in no_measurements]
    while order and not (not found and _hopeless(reasons)):
        # A point goes with the module from frame to frame.
        together = PROBED_TOGETHER if not found else 2 * numba.get_num_threads()
        together = 1 if inside is not None else together
        batch, order = order[:together], order[together:]
        images = [sequence.frame(k).image for k in batch]
        look = partial(
            _outcome,
            layout=layout,
            inside=point,
            ask=not found or bool(_votes(reasons)),
            thoroughly=_tried(reasons) < PROBED_TOGETHER,
        )
        for k, outcome in zip(batch, parallel_map(look, images), strict=True):
            if isinstance(outcome, OutlineError):
                reasons[k] = outcome
                continue
            found[k] = outcome
            if inside is not None:
                if len(found) == 1:
                    _require_inside(inside, layout, outcome[0])
                x, y = outcome[0].project(np.array([layout.size]) / 2)[0]
                point = float(x), float(y)
        yield Progress(0.8 * (count - len(order)) / count, _MESSAGE)
    parts_only = not found and inside is None and _all_cut(reasons) and _is_plain(layout)
    why_not = ""
    if parts_only:
        try:
            found, left = yield from found_together(sequence, layout, reasons)
            reasons = dict(left)
        except OutlineError as error:
            why_not = str(error)
    if max(_votes(reasons).values(), default=0) > len(found) or not found:
        said = _nothing_found(sequence, layout, reasons, len(found), why_not)
        raise InspectionError(said + said_of_uneven(sequence, layout, inside))
    # Whoever has no place among the parts has none beside one of them either.
    for index in () if parts_only else sorted(reasons):
        reason = reasons[index]
        if isinstance(reason, _OtherLayoutError) or str(reason).startswith(("black", "saturated")):
            continue
        try:
            found[index] = _found_from_others(sequence, layout, index, found, reason)
            del reasons[index]
        except OutlineError as error:
            reasons[index] = error
        yield Progress(0.8 + 0.2 * (index + 1) / count, _MESSAGE)
    faulty = _faulty(reasons)
    if len(faulty) > len(found):
        said = _mostly_faulty(sequence, layout, reasons, faulty)
        raise InspectionError(said + said_of_uneven(sequence, layout, inside))
    if not parts_only:
        same_way_up(sequence, layout, found)
    return Crossings(
        layout,
        tuple(
            found[index][1]
            if index in found
            else FrameCrossings.failed(layout, no_measurements.get(index) or str(reasons[index]))
            for index in range(count)
        ),
    )


def _found_from_others(
    sequence: FrameSequence,
    layout: ModuleLayout,
    index: int,
    found: dict[int, Found],
    why: OutlineError,
) -> Found:
    """Find the module in a frame that shows a part of it, from frames in which it was found.

    `why` is what the search in the frame alone came to.
    """
    image = sequence.frame(index).image
    others = ((sequence.frame(k).image, found[k].pose) for k in nearest(found, index))
    try:
        return found_beside(
            image,
            others,
            lambda start: _unless_better(image, layout, detect_in_frame(image, layout, start)),
        )
    except OutlineError as error:
        raise OutlineError(f"{CUT} ({error})") if str(why) == RUNS_OVER else error from None


def _spread(count: int) -> list[int]:
    """Return all frames, the first ones from all parts of the sequence.

    The frames at the beginning may be black or show something else.
    """
    probes = np.unique(np.linspace(0, count - 1, PROBED_TOGETHER).round().astype(int)).tolist()
    further = np.unique(np.linspace(0, count - 1, MAX_FAILED).round().astype(int)).tolist()
    return list(dict.fromkeys([*probes, *further, *range(count)]))


def _hopeless(reasons: dict[int, OutlineError]) -> bool:
    """Whether no module of the layout is to be expected after these frames."""
    votes = max(_votes(reasons).values(), default=0)
    return _tried(reasons) >= MAX_FAILED or votes >= PROBED_TOGETHER


def _tried(reasons: dict[int, OutlineError]) -> int:
    """How many of these frames show something bright, completely."""
    texts = [str(error) for error in reasons.values()]
    nothing = ("black", "saturated", "no module", RUNS_OVER)
    return sum(not text.startswith(nothing) for text in texts)


def _all_cut(reasons: dict[int, OutlineError]) -> bool:
    """Whether the border of the image cuts what is bright in most frames, and none is whole."""
    cut = sum(str(error) in (RUNS_OVER, FILLED) for error in reasons.values())
    return cut > 1 and 2 * cut > len(reasons)


def _is_plain(layout: ModuleLayout) -> bool:
    return layout == layout.plain and not any(layout.cell_gap)


def _votes(reasons: dict[int, OutlineError]) -> Counter[ModuleLayout]:
    """In how many frames other layouts fit."""
    return Counter(e.layout for e in reasons.values() if isinstance(e, _OtherLayoutError))


def _outcome(
    image: NDArray[np.float32],
    layout: ModuleLayout,
    inside: tuple[float, float] | None,
    ask: bool,
    thoroughly: bool,
) -> Found | OutlineError:
    """Look for the module in one frame.

    Until one frame of the sequence is found, it is asked whether another layout fits, and missing
    corners are put back; afterwards the frames that are found help the others.
    """
    try:
        return _unless_better(image, layout, find_module(image, layout, inside), inside)
    except (TwoModulesError, _OtherLayoutError) as error:
        return error
    except OutlineError as error:
        reason = error
    with suppress(OutlineError):
        return _unless_better(image, layout, module_to_the_edge(image, layout, inside), inside)
    if not isinstance(reason, GridFaultError):
        with suppress(OutlineError):
            found = module_with_dim_cells(image, layout, inside)
            return _unless_better(image, layout, found, inside)
    if not ask:
        return reason
    seen = seen_layout(image, layout, inside)
    if seen is not None and fits_given(seen[0], layout):
        return seen[1]
    if seen is not None:
        # A row of mostly dead cells is missing from the outline, and then from what is seen.
        around = found_around(image, layout, *seen) if thoroughly else None
        return around or _OtherLayoutError(str(reason), seen[0])
    if thoroughly:
        with suppress(OutlineError):
            return completed_module(image, layout, inside)
    return reason


def _unless_better(
    image: NDArray[np.float32],
    layout: ModuleLayout,
    found: Found,
    inside: tuple[float, float] | None = None,
) -> Found:
    """Return what was found unless another layout fits the frame better."""
    better = better_layout(image, layout, found, inside)
    if better is None:
        return found
    reason = (
        f"only {100 * found.share:.0f} % of the borders between {layout.rows} x {layout.cols} "
        "cells are where they should be"
    )
    raise _OtherLayoutError(reason, better)


def _faulty(reasons: dict[int, OutlineError]) -> list[int]:
    """In which frames something speaks against the rows and columns."""
    faults = GridFaultError | _OtherLayoutError
    return [k for k in sorted(reasons) if isinstance(reasons[k], faults)]


def _mostly_faulty(
    sequence: FrameSequence,
    layout: ModuleLayout,
    reasons: dict[int, OutlineError],
    faulty: list[int],
) -> str:
    return (
        f"{len(faulty)} of {len(sequence)} frames speak against a module of {layout.rows} rows x "
        f"{layout.cols} columns ({sequence.names[faulty[0]]}: {reasons[faulty[0]]}): check rows "
        "and cols, and whether all rows and columns are alike (--row-heights, --col-widths)."
    )


def _nothing_found(
    sequence: FrameSequence,
    layout: ModuleLayout,
    reasons: dict[int, OutlineError],
    found: int,
    parts: str,
) -> str:
    first = min(reasons)
    module = f"{layout.rows} rows x {layout.cols} columns"
    ambiguous = [k for k in sorted(reasons) if isinstance(reasons[k], TwoModulesError)]
    if ambiguous:
        return (
            f"{sequence.names[ambiguous[0]]} shows {reasons[ambiguous[0]]}: give a point inside "
            "of the wanted one (module_at, --module-at X Y)."
        )
    votes = _votes(reasons)
    if votes:
        seen, times = votes.most_common(1)[0]
        frame, reason = min(
            (k, e.reason)
            for k, e in reasons.items()
            if isinstance(e, _OtherLayoutError) and e.layout == seen
        )
        aspect = (
            f" --cell-aspect {seen.cell_aspect:g}" if seen.cell_aspect != layout.cell_aspect else ""
        )
        frames = "this frame shows" if times == 1 else f"this and {times - 1} more frames show"
        none = "Hardly any" if found else "No"
        return (
            f"{none} frame shows a module of {module} ({sequence.names[frame]}: {reason}), but "
            f"{frames} {seen.rows} rows x {seen.cols} columns: check rows and cols, perhaps give "
            f"--rows {seen.rows} --cols {seen.cols}{aspect}."
        )
    if _all_cut(reasons):
        by_day = (
            " By daylight, with the current switched between the frames, give --lock-in."
            if sequence.lock_in is None and SHOWN_TOGETHER not in parts
            else ""
        )
        put = f" Nor do the parts make one: {parts}." if parts else ""
        return (
            f"No frame shows a module of {module}: in {_how_many(reasons)} {RUNS_OVER}.{put} At "
            f"least one frame must show the whole module, or all together.{by_day}"
        )
    return (
        f"No frame shows a module of {module} ({sequence.names[first]}: {reasons[first]}): check "
        "the frames, rows and cols, and whether all rows and columns are alike (--row-heights, "
        "--col-widths)."
    )


def _how_many(reasons: dict[int, OutlineError]) -> str:
    cut = sum(str(error) in (RUNS_OVER, FILLED) for error in reasons.values())
    return f"all {cut}" if cut == len(reasons) else f"{cut} of {len(reasons)}"


def _require_inside(point: tuple[float, float], layout: ModuleLayout, pose: Pose) -> None:
    """Refuse a point that chooses the module only because no other is nearer."""
    at = pose.unproject(np.array([point]))[0]
    if np.all((at > -NEAR_CELLS) & (at < np.array(layout.size) + NEAR_CELLS)):
        return
    x, y = pose.project(np.array([layout.size]) / 2)[0]
    raise InspectionError(
        f"There is no module of {layout.rows} rows x {layout.cols} columns at "
        f"({point[0]:g}, {point[1]:g}) px; the nearest lies around ({x:.0f}, {y:.0f}): give a "
        "point inside of the wanted one (module_at, --module-at X Y)."
    )
