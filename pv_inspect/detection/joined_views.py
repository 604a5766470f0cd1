"""The module in frames that all cut it: the parts are put together by what their cells look like.

The grid of each frame is known up to whole cells (`pv_inspect.detection.grid_of_a_part`). How two
grids lie to each other, what both frames show says: the shift at which their cells agree, if no
other shift agrees nearly as well. Where all parts together end, on all four sides, is the module.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.detection.outline import OutlineError
from pv_inspect.detection.part_shift import ASIDE, off_cells, shift_between
from pv_inspect.detection.seen_part import SAMPLES, Part, laid_together
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose

__all__ = [
    "NO_PLACE",
    "SHOWN_TOGETHER",
    "beside_others",
    "joined_picture",
    "lies_on",
    "of_another_aspect",
    "poses_together",
]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# No search for these constants is on record: they were set by hand on seeds 0 to 3 of
# `python benchmarks/partial_views.py`.

AT_ONCE = 0.75
"""Pairs this much as clear as the clearest one are put together before others are looked at."""
MOST_MISFIT = 0.3
"""Cells by which shifts around a loop of frames may contradict each other."""
UNEVEN_ENDS = 0.25 * SAMPLES
"""How much more or less than whole cells what is bright may span, samples."""
MOST_HIDDEN = 0.002
SHOWN_TOGETHER = "together they show"
BEYOND = 0.17
"""So far beyond the outer line it must be dark, cells."""
LEAST_DARK_SHARE = 0.3
MOST_STRETCH = 0.03
"""By how much the aspect of the cells may differ from that in the other frames. Right grids differ
by 0.001 at most (seeds 20, 24 and 40), grids on busbars by 0.11 to 0.14 (seeds 40 and 44)."""
NO_PLACE = (
    "which part of the module it shows can't be told: it fits no other frame at one place only"
)


def beside_others(parts: Mapping[int, Part]) -> list[int]:
    """Say which frames do not lie on what all others show, the worst one first.

    Parameters
    ----------
    parts : mapping of frame number to Part
        Seen through the module itself, with the poses that were found at last.
    """
    left, out = dict(parts), []
    while len(left) > 1:
        beside = {
            k: _beside(part, joined_picture({n: one for n, one in left.items() if n != k}))
            for k, part in left.items()
        }
        worst = max(beside, key=lambda k: beside[k])
        if beside[worst] <= ASIDE:
            break
        # It is in the picture that the others were compared with.
        del left[worst]
        out.append(worst)
    return out


def joined_picture(parts: Mapping[int, Part]) -> Part:
    """Lay frames that are seen through the module itself over each other."""
    return laid_together(parts, {k: np.zeros(2) for k in parts})


def lies_on(part: Part, others: Part) -> bool:
    """Whether a frame fits what others show of the module where it lies, and only there.

    Parameters
    ----------
    part, others : Part
        Seen through the module itself.
    """
    shift = shift_between(others, part, whole_cells=True)
    return shift is not None and not np.abs(shift[0]).max() > MOST_MISFIT


def _beside(part: Part, others: Part) -> float:
    """Cells by which a frame lies beside what others show; 0 if that can't be told."""
    shift = shift_between(others, part, whole_cells=True)
    if shift is not None and np.abs(shift[0]).max() > MOST_MISFIT:
        return float(np.abs(shift[0]).max())
    return off_cells(part, others) or 0.0


def of_another_aspect(poses: Mapping[int, Pose]) -> list[int]:
    """Say in which frames the cells are of another aspect than in most: their grid is on busbars.

    Parameters
    ----------
    poses : mapping of frame number to Pose
        Of one module in frames of one camera.
    """
    aspects = {k: float(np.log(pose.aspect)) for k, pose in poses.items()}
    usual = float(np.median(list(aspects.values()))) if aspects else 0.0
    return [k for k, aspect in aspects.items() if abs(aspect - usual) > MOST_STRETCH]


def poses_together(parts: Mapping[int, Part], layout: ModuleLayout) -> dict[int, Pose]:
    """Find where the parts lie on the module.

    Parameters
    ----------
    parts : mapping of frame number to Part
    layout : ModuleLayout
        Without wide gaps.

    Returns
    -------
    dict of frame number to Pose
        Of the module; frames that fit no other one at one place only are missing.

    Raises
    ------
    OutlineError
        If what fits together is not the whole module, or contradicts itself.
    """
    places = _places(parts)
    if len(places) < 2:
        raise OutlineError("what they show does not fit together at one place only")
    try:
        corner, turned, per_mesh = _module(parts, places, layout)
    except OutlineError as error:
        if len(places) == len(parts):
            raise
        some = f"only {len(places)} of {len(parts)} fit together without doubt, and {error}"
        raise OutlineError(some) from None
    poses = {}
    for k, place in places.items():
        x, y = corner - place
        side = 1.0 / per_mesh
        moved = np.array([[side, 0, x], [0, side, y / layout.cell_aspect], [0, 0, 1]])
        pose = Pose(parts[k].pose.camera, parts[k].pose.homography @ moved)
        if turned:
            size = (float(layout.rows), float(layout.cols))
            pose = pose.turned(size, layout.size, 1)
        poses[k] = pose
    return poses


def _places(parts: Mapping[int, Part]) -> dict[int, Array]:
    """Where cell (0, 0) of each frame's plane lies on a common plane, cells (x, y).

    What fits together is compared with the rest as one picture: two lines of views overlap by more
    than any two of their frames. Grids on the borders of cells lie whole cells apart; only what
    fits nowhere like this may have its grid on busbars.
    """
    groups = [{k: np.zeros(2)} for k in parts]
    for whole_cells in (True, False):
        count = len(groups) + 1
        while 1 < len(groups) < count:
            count = len(groups)
            groups = _joined(parts, groups, whole_cells)
    return max(groups, key=len, default={})


def _joined(
    parts: Mapping[int, Part], groups: list[dict[int, Array]], whole_cells: bool
) -> list[dict[int, Array]]:
    """Join the groups of frames that fit together at one place only, the clearest ones first."""
    pictures = [laid_together(parts, group) for group in groups]
    links = []
    for one, other in combinations(range(len(groups)), 2):
        found = shift_between(pictures[one], pictures[other], whole_cells)
        if found is not None:
            links.append((found[1], one, other, found[0]))
    owners = {k: {k: np.zeros(2)} for k in range(len(groups))}
    # What is less clear may be clearer when these are one picture.
    clearest = max((link[0] for link in links), default=0.0)
    links = [link for link in links if link[0] >= AT_ONCE * clearest]
    for _, one, other, shift in sorted(links, key=lambda link: -link[0]):
        if other in owners[one]:
            continue
        first, second = owners[one], owners[other]
        move = first[one] + shift - second[other]
        first.update({k: place + move for k, place in second.items()})
        for k in second:
            owners[k] = first
    for _, one, other, shift in links:
        if np.abs(owners[one][one] + shift - owners[one][other]).max() > MOST_MISFIT:
            raise OutlineError("what they show fits together in more than one way")
    return [
        {k: at + place for n, at in owner.items() for k, place in groups[n].items()}
        for owner in {id(owner): owner for owner in owners.values()}.values()
    ]


def _module(
    parts: Mapping[int, Part], places: Mapping[int, Array], layout: ModuleLayout
) -> tuple[Array, bool, int]:
    """First cell (x, y) of the module on the common plane, and whether it lies on its side.

    And how many cells lie along a side of the meshes: large cells of a few pixels between their
    borders are easily seen two by two. Their own borders are measured afterwards.
    """
    low = np.array([place + parts[k].first for k, place in places.items()]).min(axis=0)
    low = np.floor(low).astype(int) - 1
    high = max(
        int(np.ceil((place + parts[k].first).max() + max(parts[k].details.shape) / SAMPLES))
        for k, place in places.items()
    )
    size = (high - int(low.min()) + 2) * SAMPLES
    lit, seen = np.zeros((size, size), np.int32), np.zeros((size, size), np.int32)
    for k, place in places.items():
        x, y = ((place + parts[k].first - low) * SAMPLES).round().astype(int)
        height, width = parts[k].details.shape
        lit[y : y + height, x : x + width] += parts[k].bright
        seen[y : y + height, x : x + width] += parts[k].inside
    bright = 2 * lit > seen
    count, labels, stats, _ = cv2.connectedComponentsWithStats(
        bright.astype(np.uint8), connectivity=4
    )
    if count < 2:
        raise OutlineError("nothing in them is bright")
    largest = labels == 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
    # Outer borders say where cells begin even if busbars were taken for the borders inside.
    ends = np.array([_ends(largest), _ends(largest.T)])
    spans = ends[:, 1] - ends[:, 0]
    cols, rows = ((spans + UNEVEN_ENDS) // SAMPLES).astype(int).tolist()
    together = f"{SHOWN_TOGETHER} {rows} rows x {cols} columns"
    box = *ends[:, 0].round().astype(int).tolist(), *(ends[:, 1].round().astype(int).tolist())
    sides = _open_sides(bright, seen > 0, box)
    if sides:
        raise OutlineError(f"{together}, and not where the module ends {' and '.join(sides)}")
    if np.abs(spans - SAMPLES * np.array([cols, rows])).max() > UNEVEN_ENDS:
        raise OutlineError(f"{together} and parts of cells")
    hidden = 1 - (seen[box[1] : box[3], box[0] : box[2]] > 0).mean()
    if hidden > MOST_HIDDEN:
        raise OutlineError(f"{together}, but {100 * hidden:.0f} % of this are in no frame")
    first = ends.mean(axis=1) / SAMPLES - np.array([cols, rows]) / 2 + low
    if (2 * rows, 2 * cols) == (layout.rows, layout.cols):
        return first, False, 2
    turned = (rows, cols) != (layout.rows, layout.cols)
    if turned and ((cols, rows) != (layout.rows, layout.cols) or layout.cell_aspect != 1):
        raise OutlineError(f"{together}, not {layout.rows} x {layout.cols}")
    return first, turned, 1


def _ends(bright: Mask) -> tuple[float, float]:
    """Where what is bright begins and ends along x, samples: in the middle of its lines."""
    lines = bright[bright.sum(axis=1) > 0.5 * bright.sum(axis=1).max()]
    width = lines.shape[1]
    first, last = lines.argmax(axis=1), width - lines[:, ::-1].argmax(axis=1)
    return float(np.median(first)), float(np.median(last))


def _open_sides(bright: Mask, seen: Mask, box: tuple[int, int, int, int]) -> list[str]:
    """On which sides no frame shows the dark beyond the module."""
    left, top, right, bottom = box
    step = round(BEYOND * SAMPLES)
    dark = seen & ~bright
    beyond = {
        "on the left": dark[top:bottom, left - step],
        "on the right": dark[top:bottom, right - 1 + step],
        "at the top": dark[top - step, left:right],
        "at the bottom": dark[bottom - 1 + step, left:right],
    }
    return [side for side, line in beyond.items() if line.mean() < LEAST_DARK_SHARE]
