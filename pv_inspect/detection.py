"""Crossing points of the cells in every frame (stage *detect*).

The idea follows Hoffmann et al. 2019 (ref. [37] of the paper): a coarse pose from the outline of
the module, then profiles across the expected cell borders. Every gap between two cells is
measured as the position of a blurred dark line between two brightness levels, which is unbiased
where neighbouring cells differ in brightness; a crossing is where its measured gaps meet.
"""

from __future__ import annotations

import contextlib
from collections.abc import Generator
from functools import partial

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from pv_inspect.concurrency import mapped
from pv_inspect.crossings import Crossings, FrameCrossings, crossings_of
from pv_inspect.edges import CellEdges, EdgeOffsets, cell_edges, measure_edges
from pv_inspect.errors import InspectionError
from pv_inspect.frame_copies import copies_told
from pv_inspect.large_frames import ReducedFrames, enlarged, reduction
from pv_inspect.layout import ModuleLayout
from pv_inspect.outline import Outline, OutlineError, Pose, find_outlines, fit_pose
from pv_inspect.pose_refinement import refined_pose
from pv_inspect.sequence import Sequence

__all__ = ["detect", "detect_in_frame"]

Array = NDArray[np.float64]

MIN_EDGE_SHARE = 0.6
"""Share of the expected gaps that must be in place; dead cells and cracks hide some."""
IN_PLACE_PX = 0.5
FINER_SHARE = 0.85
SURE_SHARE = 0.8
"""If fewer crossing points are measured, other starts are tried too."""
CONTINUITY = 0.1
"""Correlation of the cells' brightness that counts as much as half the turn between two frames."""
MAX_ASPECT_RATIO_ERROR = 1.4
"""Perspective at 35 degrees changes the apparent aspect by 1.22, a wrong layout by 1.5 or more."""
SEARCH_UNITS = (0.12, 0.06, 0.04)
"""Half width of the search across a gap, module units, in successive rounds."""
MIN_SEARCH_PX = 1.2
SAMPLES_PER_CELL = 4
MIN_GAPS_TO_COMPLETE = 30
"""With fewer gaps between cells, most of them may be in place by chance."""
EQUAL_STANDING = 0.2
"""Difference of the distances from the centre of the frame, as a share of the distance."""
RUNS_OVER = "what is bright runs over the border of the image, no module is completely in view"
NEAR_CELLS = 0.5
"""A point may be so many cells beside the module that it chooses."""


class TwoModulesError(OutlineError):
    """The frame shows two modules that are equally near to its centre."""


Found = tuple[Pose, FrameCrossings]


def detect(
    sequence: Sequence, layout: ModuleLayout, inside: tuple[float, float] | None = None
) -> Generator[float, None, Crossings]:
    """Find the crossing points in every frame.

    A frame in which the module is cut by the image border, or whose outline fails, is found again
    from the nearest frame that succeeded. All frames are brought to the same way up. Frames that
    repeat another one are not looked at.

    Parameters
    ----------
    sequence : Sequence
    layout : ModuleLayout
    inside : tuple of float, optional
        (x, y) of a point in the wanted module, pixels of the first frame, for frames that show
        several; by default the completely visible module nearest to the centre.

    Yields
    ------
    float
        Share of the work that is done.

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
    found: dict[int, Found] = {}
    copied = copies_told(sequence.copies, sequence.names)
    reasons: dict[int, str] = {}
    ambiguous = False
    point = inside
    index = 0
    while index < count:
        # A point goes with the module from frame to frame, and the first find differs.
        together = 1 if inside is not None or not found else 2 * numba.get_num_threads()
        upto = min(index + together, count)
        frames = [k for k in range(index, upto) if k not in copied]
        images = [sequence.frame(k).image for k in frames]
        look = partial(_outcome, layout=layout, inside=point, first=not found)
        for k, outcome in zip(frames, mapped(look, images), strict=True):
            if isinstance(outcome, OutlineError):
                reasons[k] = str(outcome)
                ambiguous |= isinstance(outcome, TwoModulesError)
                continue
            found[k] = outcome
            if inside is not None:
                if len(found) == 1:
                    _require_inside(inside, layout, outcome[0])
                x, y = outcome[0].project(np.array([layout.size]) / 2)[0]
                point = float(x), float(y)
        index = upto
        yield 0.8 * index / count
    for index in sorted(reasons):
        if not found or reasons[index].startswith(("black", "saturated")):
            continue
        nearest = min(found, key=lambda other: abs(other - index))
        try:
            image = sequence.frame(index).image
            start = _translated(sequence.frame(nearest).image, image, found[nearest][0])
            found[index] = detect_in_frame(image, layout, start, check_layout=False)
            del reasons[index]
        except OutlineError as error:
            reasons[index] = str(error)
        yield 0.8 + 0.2 * (index + 1) / count
    if not found:
        raise InspectionError(_nothing_found(sequence, layout, reasons, ambiguous))
    _same_way_up(sequence, layout, found)
    return Crossings(
        layout,
        tuple(
            found[index][1]
            if index in found
            else FrameCrossings.failed(layout, copied.get(index) or reasons[index])
            for index in range(count)
        ),
    )


def _outcome(
    image: NDArray[np.float32],
    layout: ModuleLayout,
    inside: tuple[float, float] | None,
    first: bool,
) -> Found | OutlineError:
    try:
        return _find_module(image, layout, inside, first=first)
    except OutlineError as error:
        return error


def _nothing_found(
    sequence: Sequence, layout: ModuleLayout, reasons: dict[int, str], ambiguous: bool
) -> str:
    first = min(reasons)
    module = f"{layout.rows} rows x {layout.cols} columns"
    if ambiguous:
        return (
            f"{sequence.names[first]} shows {reasons[first]}: give a point inside of the wanted "
            "one (module_at, --module-at X Y)."
        )
    if len(reasons) > 1 and set(reasons.values()) == {RUNS_OVER}:
        return (
            f"No frame shows a module of {module}: in all {len(reasons)} {RUNS_OVER}; at least "
            "one frame must show the whole module."
        )
    return (
        f"No frame shows a module of {module} ({sequence.names[first]}: {reasons[first]}): check "
        "the frames, rows and cols."
    )


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


def detect_in_frame(
    image: NDArray[np.float32], layout: ModuleLayout, start: Pose, *, check_layout: bool = True
) -> tuple[Pose, FrameCrossings]:
    """Refine a coarse pose on the gaps between the cells and read the crossing points.

    Parameters
    ----------
    image : (height, width) float32
    layout : ModuleLayout
    start : Pose
        Right to about a tenth of a cell.
    check_layout : bool
        Whether to look for gaps inside of the cells, which say that the module has more of them.
        Once in a sequence is enough.

    Returns
    -------
    Pose
        The pose that fits the gaps best.
    FrameCrossings

    Raises
    ------
    OutlineError
        If too few of the expected gaps are there.
    """
    edges = cell_edges(layout)
    pose = start
    # In small cells a share of the cell is less than what noise moves a gap by.
    least = MIN_SEARCH_PX / _scale_px(layout, start)
    for search in SEARCH_UNITS:
        pose = refined_pose(pose, edges, measure_edges(image, edges, pose, max(search, least)))
    offsets = measure_edges(image, edges, pose, max(SEARCH_UNITS[-1], least))
    share = _share_in_place(edges, offsets, pose)
    if share < MIN_EDGE_SHARE:
        raise OutlineError(
            f"only {100 * share:.0f} % of the borders between {layout.rows} x {layout.cols} cells "
            "are where they should be"
        )
    if check_layout and _has_finer_grid(image, layout, pose):
        raise OutlineError(
            f"there are borders in the middle of the {layout.rows} x {layout.cols} cells too"
        )
    return pose, crossings_of(layout, edges, offsets, pose)


def _find_module(
    image: NDArray[np.float32],
    layout: ModuleLayout,
    inside: tuple[float, float] | None,
    *,
    first: bool,
) -> Found:
    """Take the first outline in which the gaps of the layout are in place.

    Until one frame of the sequence is found, the layout is checked and missing corners are put
    back; afterwards the frames that are found help the others.
    """
    reason: OutlineError | None = None
    complete: list[Outline] = []
    for outline in find_outlines(image, inside):
        if outline.cut:
            reason = reason or OutlineError(RUNS_OVER)
            continue
        complete.append(outline)
        try:
            found = _fitted(image, layout, outline, first)
        except OutlineError as error:
            reason = reason or error
            continue
        if inside is None:
            _refuse_a_second(image, layout, found)
        return found
    # Dead cells at a corner of the module take it out of the outline.
    edges = cell_edges(layout)
    incomplete = complete if first and edges.inner.sum() >= MIN_GAPS_TO_COMPLETE else []
    for outline in (whole for one in incomplete for whole in one.completed()):
        with contextlib.suppress(OutlineError):
            return _fitted(image, layout, outline, first)
    raise reason or OutlineError("no module")


def _fitted(
    image: NDArray[np.float32], layout: ModuleLayout, outline: Outline, check_layout: bool
) -> Found:
    """Find the crossing points within one outline, with lens distortion and else without."""
    first: OutlineError | None = None
    fits: list[Found] = []
    for distorted in (True, False):
        for start in _starts(image.shape, outline, layout, distorted):
            try:
                fits.append(detect_in_frame(image, layout, start, check_layout=check_layout))
            except OutlineError as error:
                first = first or error
        # The wrong orientation of a square outline may catch busbars, but not everywhere.
        best = max(fits, key=_share_measured, default=None)
        if best is not None and (not distorted or _share_measured(best) > SURE_SHARE):
            return best
    raise first or OutlineError("no module")


def _refuse_a_second(image: NDArray[np.float32], layout: ModuleLayout, found: Found) -> None:
    """Raise if the frame shows a module on its other side that is as near to the centre."""
    height, width = image.shape
    centre = np.array([width / 2, height / 2])
    pose = found[0]
    at = pose.project(np.array([layout.size]) / 2)[0]
    middle = pose.unproject(centre[None])[0]
    if np.all((middle > 0) & (middle < layout.size)):
        return
    opposite = 2 * centre - at
    for outline in find_outlines(image, (float(opposite[0]), float(opposite[1]))):
        corners = outline.corners_px
        other = corners.mean(axis=0)
        away = float(np.linalg.norm(other - opposite) / np.linalg.norm(at - centre))
        if outline.cut or away > EQUAL_STANDING:
            continue
        try:
            _fitted(image, layout, outline, check_layout=False)
        except OutlineError:
            continue
        raise TwoModulesError(
            f"two modules of equal standing, around ({at[0]:.0f}, {at[1]:.0f}) and "
            f"({other[0]:.0f}, {other[1]:.0f}) px"
        )


def _share_measured(found: Found) -> float:
    return float(found[1].measured.mean())


def _starts(
    shape: tuple[int, int], outline: Outline, layout: ModuleLayout, distorted: bool
) -> list[Pose]:
    """Fit the outline; return the orientations that the aspect of the module allows."""
    pose, distance = fit_pose(outline, layout, shape, 0, distorted=distorted)
    ratio = layout.size[0] / layout.size[1]
    seen = pose.aspect * ratio
    starts = [pose, pose.turned(layout.size, layout.size, 1)]
    errors = [abs(np.log(seen / ratio)), abs(np.log(seen * ratio))]
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


def _same_way_up(sequence: Sequence, layout: ModuleLayout, found: dict[int, Found]) -> None:
    """Turn the frames so that all show the same cells at the same places of the module.

    The outline looks the same turned by half a turn; the brightness of the cells does not. Where
    all cells look alike, the turn that continues the frame before decides.
    """
    square = layout.rows == layout.cols and layout.cell_aspect == 1.0
    turns = (0, 1, 2, 3) if square else (0, 2)
    known: NDArray[np.float32] | None = None
    direction = 0.0
    for index in sorted(found):
        pose, frame = found[index]
        picture = _coarse_picture(sequence.frame(index).image, layout, pose)
        if known is None:
            known, direction = picture, _direction(pose, layout)
            continue
        turned = {turn: pose.turned(layout.size, layout.size, turn) for turn in turns}
        scale = float(np.linalg.norm(known) * np.linalg.norm(picture)) + 1e-12
        score = {
            turn: float((known * np.rot90(picture, turn)).sum()) / scale
            + CONTINUITY * float(np.cos(_direction(turned[turn], layout) - direction))
            for turn in turns
        }
        turn = max(score, key=lambda key: score[key])
        known = known + np.rot90(picture, turn)
        direction = _direction(turned[turn], layout)
        if turn:
            found[index] = turned[turn], frame.turned(layout, turn)


def _direction(pose: Pose, layout: ModuleLayout) -> float:
    """Angle of the module's x axis in the image."""
    height = layout.size[1] / 2
    ends = pose.project(np.array([[0.0, height], [layout.size[0], height]]))
    return float(np.arctan2(*(ends[1] - ends[0])[::-1]))


def _coarse_picture(
    image: NDArray[np.float32], layout: ModuleLayout, pose: Pose
) -> NDArray[np.float32]:
    """Brightness of parts of the cells against their surroundings, standard deviation 1."""
    shape = (SAMPLES_PER_CELL * layout.rows, SAMPLES_PER_CELL * layout.cols)
    y, x = (np.mgrid[0 : shape[0], 0 : shape[1]] + 0.5) / SAMPLES_PER_CELL
    points = np.column_stack([x.ravel(), y.ravel() / layout.cell_aspect])
    pixels = np.nan_to_num(pose.project(points), nan=-1e4).astype(np.float32).reshape(*shape, 2)
    smooth = cv2.GaussianBlur(image, (0, 0), 1.5)
    values = cv2.remap(
        smooth, pixels[..., 0], pixels[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    around = 3 * SAMPLES_PER_CELL
    values = values - cv2.blur(values, (around, around), borderType=cv2.BORDER_REPLICATE)
    return np.asarray(values / (values.std() + 1e-12), np.float32)


def _scale_px(layout: ModuleLayout, pose: Pose) -> float:
    """LR pixels per module unit in the middle of the module."""
    middle = np.array([layout.size]) / 2
    jacobian = pose.camera.jacobian(pose.homography, middle)[0]
    return float(np.sqrt(np.abs(np.linalg.det(jacobian))))


def _share_in_place(edges: CellEdges, offsets: EdgeOffsets, pose: Pose) -> float:
    """Share of the gaps that lie within half a pixel, of the worse of the two directions.

    Busbars can be taken for gaps, but they do not lie at the places of one pose; and wrong rows
    leave all the upright gaps in place, which the mean of both directions would hide.
    """
    jacobian = pose.camera.jacobian(pose.homography, edges.middle)
    across = np.linalg.norm(np.einsum("nij,nj->ni", jacobian, edges.normal), axis=1)
    in_place = offsets.found & (np.abs(np.nan_to_num(offsets.offset)) * across < IN_PLACE_PX)
    shares = []
    for axis in range(2):
        expected = edges.inner & (edges.normal[:, axis] == 1)
        seen = expected & offsets.visible
        if expected.any():
            shares.append(float(in_place[seen].mean()) if seen.any() else 0.0)
    return min(shares, default=1.0)


def _has_finer_grid(image: NDArray[np.float32], layout: ModuleLayout, pose: Pose) -> bool:
    """Whether gaps halve the cells in both directions, as when rows and cols are half too few."""
    finer = ModuleLayout(2 * layout.rows, 2 * layout.cols, layout.cell_aspect)
    edges = cell_edges(finer)
    halved = Pose(pose.camera, pose.homography @ np.diag([0.5, 0.5, 1.0]))
    offsets = measure_edges(image, edges, halved, SEARCH_UNITS[-1])
    return _share_in_place(edges, offsets, halved) > FINER_SHARE


def _translated(reference: NDArray[np.float32], image: NDArray[np.float32], pose: Pose) -> Pose:
    """Shift the pose of one frame to where the same picture is found in another frame."""
    height, width = image.shape
    pad = max(height, width) // 5
    smooth = [cv2.GaussianBlur(a, (0, 0), 1.5) for a in (reference, image)]
    template = smooth[0][pad // 2 : height - pad // 2, pad : width - pad]
    canvas = cv2.copyMakeBorder(smooth[1], pad, pad, pad, pad, cv2.BORDER_CONSTANT, value=0)
    score = cv2.matchTemplate(canvas, template, cv2.TM_CCOEFF_NORMED)
    _, best, _, (x, y) = cv2.minMaxLoc(score)
    if best < 0.4:
        raise OutlineError(f"it does not look like its neighbours (correlation {best:.2f})")
    shift = np.array([x - 2 * pad, y - pad - pad // 2], np.float64)
    ideal = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]) * 4
    pixels = pose.project(ideal) + shift
    normalised = pose.camera.undistort((pixels - pose.camera.K[:2, 2]) / pose.camera.K[0, 0])
    matrix = cv2.getPerspectiveTransform(
        ideal.astype(np.float32), np.asarray(normalised).astype(np.float32)
    )
    return Pose(pose.camera, np.asarray(matrix, np.float64))
