"""The module in one frame: from an outline to the pose that fits the gaps, and its crossings."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.detection.crossings import FrameCrossings, crossings_of
from pv_inspect.detection.edges import CellEdges, EdgeOffsets, cell_edges, measure_edges
from pv_inspect.detection.grid_check import IN_PLACE_PX, cell_levels, grid_fault, is_lit, offsets_px
from pv_inspect.detection.outline import (
    MAX_KAPPA,
    Outline,
    OutlineError,
    find_outlines,
    fit_pose,
    solver_errors_as_reasons,
)
from pv_inspect.detection.pose_refinement import refined_pose, split_edges
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose

__all__ = [
    "MAX_ASPECT_RATIO_ERROR",
    "RUNS_OVER",
    "Found",
    "GridFaultError",
    "TwoModulesError",
    "complete_outlines",
    "completed_module",
    "detect_in_frame",
    "find_module",
    "found_in_outline",
    "search_units",
]

Array = NDArray[np.float64]

MIN_EDGE_SHARE = 0.6
"""Share of the expected gaps that must be in place; cracks and noise hide some."""
MIN_BRIGHT_SHARE = 0.25
"""If fewer of the gaps lie between bright cells, the gaps of dead cells are asked too."""
SURE_SHARE = 0.8
"""If fewer crossing points are measured, other starts are tried too."""
MAX_ASPECT_RATIO_ERROR = 1.4
"""Perspective at 35 degrees changes the apparent aspect by 1.22, a wrong layout by 1.5 or more."""
SEARCH_UNITS = (0.12, 0.06, 0.04)
"""Half width of the search across a gap, module units, in successive rounds."""
MIN_SEARCH_PX = 1.2
MAX_SEARCH_PX = 8.0
"""The outline is right to a few pixels however large the cells are."""
MIN_GAPS_TO_COMPLETE = 30
"""With fewer gaps between cells, most of them may be in place by chance."""
EQUAL_STANDING = 0.2
"""Difference of the distances from the centre of the frame, as a share of the distance."""
LEAST_ENDS = 0.4
"""Share of the points of an outer line that are measured; dead cells may hide the one on the other
side. Grids that lie on busbars had 0 to 0.29, right ones 0.85 to 1 (frames of 58 sequences of
benchmarks/wrong_layouts.py) and 0.56 to 0.89 on seven photographs of a power plant."""
SAME_OUTLINE_PX = 1.0
RUNS_OVER = "what is bright runs over the border of the image, no module is completely in view"


class Found(NamedTuple):
    """The module in one frame.

    `share` is that of the gaps between bright cells that are in place, in the worse direction.
    """

    pose: Pose
    crossings: FrameCrossings
    share: float


class TwoModulesError(OutlineError):
    """The frame shows two modules that are equally near to its centre."""


class GridFaultError(OutlineError):
    """The gaps are in place, but something speaks against this number of rows and columns."""


@solver_errors_as_reasons()
def detect_in_frame(
    image: NDArray[np.float32],
    layout: ModuleLayout,
    start: Pose,
    *,
    whole: bool = False,
    to_the_edge: bool = False,
    searches: Sequence[float] = SEARCH_UNITS,
) -> Found:
    """Refine a coarse pose on the gaps between the cells and read the crossing points.

    Parameters
    ----------
    image : (height, width) float32
    layout : ModuleLayout
    start : Pose
        Right to about a tenth of a cell.
    whole : bool
        Whether the frame is known to show the whole module.
    to_the_edge : bool
        Whether outer lines may lie on the border of the image, where they can't be measured.
    searches : sequence of float, optional
        Half widths of the searches across a gap, cells, one after the other. Narrow ones do not
        reach the busbars beside a gap, where the pose is known better.

    Returns
    -------
    Found
        With the pose that fits the gaps best.

    Raises
    ------
    OutlineError
        If too few of the expected gaps are there.
    GridFaultError
        If something speaks against this number of rows and columns.
    """
    edges = cell_edges(layout)
    pose = start
    # In small cells a share of the cell is less than what noise moves a gap by.
    scale = start.scale_px(layout.size)
    if not np.isfinite(scale):
        raise OutlineError("what is bright in it determines no pose of a flat module")
    least, most = MIN_SEARCH_PX / scale, MAX_SEARCH_PX / scale
    parts = split_edges(edges)
    for search in searches:
        reach = min(max(search, least), most)
        pose = refined_pose(pose, parts, measure_edges(image, parts, pose, reach))
    if not abs(pose.camera.kappa) <= MAX_KAPPA:
        raise OutlineError(
            f"the cells only fit with a lens distortion of kappa {pose.camera.kappa:+.3g}, which "
            "no lens has"
        )
    offsets = measure_edges(image, edges, pose, search_units(layout, pose))
    bright = _between_bright_cells(image, layout, pose)
    share = _share_in_place(edges, offsets, pose, bright)
    if share < MIN_EDGE_SHARE:
        raise OutlineError(
            f"only {100 * share:.0f} % of the borders between {layout.rows} x {layout.cols} cells "
            "are where they should be"
        )
    fault = grid_fault(image, layout, pose, whole=whole)
    if fault:
        raise GridFaultError(fault)
    crossings = crossings_of(layout, edges, offsets, pose)
    if whole and not to_the_edge and _share_of_ends(layout, crossings) < LEAST_ENDS:
        raise GridFaultError(
            f"the {layout.rows} x {layout.cols} cells begin and end at no border: what lies on the "
            "inner lines are busbars"
        )
    return Found(pose, crossings, share)


def _share_of_ends(layout: ModuleLayout, crossings: FrameCrossings) -> float:
    """Share of the points of the better outer line that are measured, of the worse direction."""
    measured = crossings.measured.reshape(layout.rows + 1, layout.cols + 1)
    return min(float(max(lines[0].mean(), lines[-1].mean())) for lines in (measured, measured.T))


def find_module(
    image: NDArray[np.float32],
    layout: ModuleLayout,
    inside: tuple[float, float] | None = None,
    outlined: NDArray[np.float32] | None = None,
) -> Found:
    """Find the module in one frame from its outline.

    Parameters
    ----------
    image : (height, width) float32
    layout : ModuleLayout
    inside : tuple of float, optional
        (x, y) of a point in the wanted module, LR pixels.
    outlined : (height, width) float32, optional
        What the outline is taken from; the image if not given.

    Returns
    -------
    Found
        Pose and crossing points of the first outline in which the gaps are in place.

    Raises
    ------
    OutlineError
        If the frame shows no whole module of that layout.
    """
    reason: OutlineError | None = None
    outlined = image if outlined is None else outlined
    for outline in complete_outlines(outlined, inside):
        try:
            found = found_in_outline(image, layout, outline)
        except OutlineError as error:
            reason = reason or error
            continue
        if inside is None:
            _refuse_a_second(image, outlined, layout, found)
        return found
    raise reason or OutlineError("no module")


def completed_module(
    image: NDArray[np.float32], layout: ModuleLayout, inside: tuple[float, float] | None = None
) -> Found:
    """Find the module in one frame whose outline lacks a corner because cells are dead there.

    Parameters and errors are those of `find_module`, which comes first.
    """
    if cell_edges(layout).inner.sum() >= MIN_GAPS_TO_COMPLETE:
        # Nearly the same outline may come to another fifth side.
        for outline in complete_outlines(image, inside, apart_px=0.0):
            for whole in outline.completed():
                with contextlib.suppress(OutlineError):
                    return found_in_outline(image, layout, whole)
    raise OutlineError("no module with a corner missing")


def complete_outlines(
    image: NDArray[np.float32],
    inside: tuple[float, float] | None,
    apart_px: float = SAME_OUTLINE_PX,
) -> Iterator[Outline]:
    """Yield the outlines that are not cut, each once.

    Raises
    ------
    OutlineError
        If there is none.
    """
    seen: list[Outline] = []
    cut = False
    for outline in find_outlines(image, inside):
        cut |= outline.cut
        corners = outline.corners_px
        if outline.cut or any(np.abs(corners - one.corners_px).max() < apart_px for one in seen):
            continue
        seen.append(outline)
        yield outline
    if not seen:
        raise OutlineError(RUNS_OVER if cut else "no module")


def found_in_outline(
    image: NDArray[np.float32],
    layout: ModuleLayout,
    outline: Outline,
    *,
    to_the_edge: bool = False,
) -> Found:
    """Find the crossing points within one outline, with lens distortion and else without.

    Parameters and errors are those of `find_module` and `detect_in_frame`.
    """
    first: OutlineError | None = None
    fits: list[Found] = []
    for distorted in (True, False):
        for start in _starts(image.shape, outline, layout, distorted):
            try:
                fits.append(
                    detect_in_frame(image, layout, start, whole=True, to_the_edge=to_the_edge)
                )
            except OutlineError as error:
                first = first or error
        # The wrong orientation of a square outline may catch busbars, but not everywhere.
        best = max(fits, key=_share_measured, default=None)
        if best is not None and (not distorted or _share_measured(best) > SURE_SHARE):
            return best
    raise first or OutlineError("no module")


def _refuse_a_second(
    image: NDArray[np.float32], outlined: NDArray[np.float32], layout: ModuleLayout, found: Found
) -> None:
    """Raise if the frame shows a module on its other side that is as near to the centre."""
    height, width = image.shape
    centre = np.array([width / 2, height / 2])
    pose = found.pose
    at = pose.project(np.array([layout.size]) / 2)[0]
    middle = pose.unproject(centre[None])[0]
    if np.all((middle > 0) & (middle < layout.size)):
        return
    opposite = 2 * centre - at
    for outline in find_outlines(outlined, (float(opposite[0]), float(opposite[1]))):
        corners = outline.corners_px
        other = corners.mean(axis=0)
        away = float(np.linalg.norm(other - opposite) / np.linalg.norm(at - centre))
        if outline.cut or away > EQUAL_STANDING:
            continue
        try:
            found_in_outline(image, layout, outline)
        except OutlineError:
            continue
        raise TwoModulesError(
            f"two modules of equal standing, around ({at[0]:.0f}, {at[1]:.0f}) and "
            f"({other[0]:.0f}, {other[1]:.0f}) px"
        )


def _share_measured(found: Found) -> float:
    return float(found.crossings.measured.mean())


def _starts(
    shape: tuple[int, int], outline: Outline, layout: ModuleLayout, distorted: bool
) -> list[Pose]:
    """Fit the outline; return the orientations that the aspect of the module allows."""
    pose, distance = fit_pose(outline, layout, shape, 0, distorted=distorted)
    ratio = layout.size[0] / layout.size[1]
    seen = pose.aspect * ratio
    uneven = (layout.row_heights or layout.col_widths) and 2 not in layout.turns
    turns = range(4 if uneven else 2)
    starts = [pose, *(pose.turned(layout.size, layout.size, turn) for turn in turns[1:])]
    errors = [abs(np.log(seen * ratio if turn % 2 else seen / ratio)) for turn in turns]
    if min(errors) > np.log(MAX_ASPECT_RATIO_ERROR):
        raise OutlineError(
            f"the module is {max(seen, 1 / seen):.2f} times as long as wide, but "
            f"{layout.rows} x {layout.cols} cells of aspect {layout.cell_aspect:g} make "
            f"{max(ratio, 1 / ratio):.2f}"
        )
    width, height = layout.size
    corners = pose.project(np.array([[0, 0], [width, 0], [width, height], [0, height]]))
    area = cv2.contourArea(np.nan_to_num(corners).astype(np.float32))
    if distance > 0.15 * np.sqrt(area / (width * height)):
        raise OutlineError(f"the outline is no rectangle (median distance {distance:.1f} px)")
    order = np.argsort(errors)
    return [starts[k] for k in order if errors[k] <= np.log(MAX_ASPECT_RATIO_ERROR)]


def search_units(layout: ModuleLayout, pose: Pose) -> float:
    """Half width of the last search across a gap, module units."""
    scale = pose.scale_px(layout.size)
    return min(max(SEARCH_UNITS[-1], MIN_SEARCH_PX / scale), MAX_SEARCH_PX / scale)


def _share_in_place(
    edges: CellEdges, offsets: EdgeOffsets, pose: Pose, bright: NDArray[np.bool_]
) -> float:
    """Share of the gaps that lie within half a pixel, of the worse of the two directions.

    Busbars can be taken for gaps, but they do not lie at the places of one pose; and wrong rows
    leave all the upright gaps in place, which the mean of both directions would hide. Between dead
    cells no gap can be seen.
    """
    with np.errstate(invalid="ignore"):
        in_place = np.abs(offsets_px(edges, offsets, pose)) < IN_PLACE_PX
    shares = []
    for axis in range(2):
        across = edges.normal[:, axis] == 1
        # A single row or column has outer edges alone.
        expected = across & edges.inner if (across & edges.inner).any() else across
        seen = expected & offsets.visible
        if (seen & bright).sum() > MIN_BRIGHT_SHARE * seen.sum():
            seen &= bright
        shares.append(float(in_place[seen].mean()) if seen.any() else 0.0)
    return min(shares)


def _between_bright_cells(
    image: NDArray[np.float32], layout: ModuleLayout, pose: Pose
) -> NDArray[np.bool_]:
    """Whether the cells beside each of the `cell_edges` are bright."""
    lit = np.pad(is_lit(cell_levels(image, layout, pose)), 1)
    upright = lit[1:-1, :-1] & lit[1:-1, 1:]
    level = lit[:-1, 1:-1] & lit[1:, 1:-1]
    return np.concatenate([upright.ravel(), level.ravel()])
