"""Which rows and columns one frame shows, where those that were given do not fit it."""

from __future__ import annotations

import contextlib

import numpy as np
from numpy.typing import NDArray

from pv_inspect.detection.layout_guess import View, ranked_layouts, scored_view, view_of
from pv_inspect.detection.outline import OutlineError
from pv_inspect.detection.single_frame import MAX_ASPECT_RATIO_ERROR, Found, detect_in_frame
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose

__all__ = ["SURE_SHARE", "better_layout", "fits_given", "found_around", "seen_layout"]

UNIT = ModuleLayout(1, 1)
MAX_TRIED = 4
SURE_SHARE = 0.85
"""With so many gaps in place no other layout is asked for. On simulated modules of 15 to 60 px per
cell right layouts had 0.85 to 1 in nearly all frames, a wrong one that came through 0.64."""
CLEARLY = 0.1
MAX_HIDDEN = 2
"""So many rows and columns of dead cells may lie outside of what is seen."""
MIN_GAPS = 30
"""With fewer gaps between cells, most of them may be in place by chance."""


def seen_layout(
    image: NDArray[np.float32], given: ModuleLayout, inside: tuple[float, float] | None = None
) -> tuple[ModuleLayout, Found] | None:
    """Find rows and columns whose gaps are in place in a frame.

    Parameters
    ----------
    image : (height, width) float32
    given : ModuleLayout
        Of the two ways round, the layout that is nearer to this one is returned; where only its
        cell aspect differs a little, this one itself.
    inside : tuple of float, optional
        (x, y) of a point in the wanted module, LR pixels.

    Returns
    -------
    ModuleLayout
    Found
        Pose and crossing points of that layout; None instead of both if there is none, or if the
        given layout has a single row or column.
    """
    if min(given.rows, given.cols) < 2:
        # A guess needs gaps both ways; in a single row it would take busbars for them.
        return None
    try:
        view = view_of(image, inside)
    except OutlineError:
        return None
    found = _first_that_fits(view, given)
    if found is None:
        return None
    # Even a grid with half of the lines brings the pose that shows all of them sharply.
    layout, there = found
    sharp = scored_view(image, there.pose.turned(layout.size, UNIT.size, 0))
    return _first_that_fits(sharp, given, found)


def found_around(
    image: NDArray[np.float32], given: ModuleLayout, seen: ModuleLayout, there: Found
) -> Found | None:
    """Find a module of which a smaller layout is seen because outer cells are dead.

    Parameters
    ----------
    image : (height, width) float32
    given : ModuleLayout
    seen : ModuleLayout
    there : Found
        Pose of what is seen.

    Returns
    -------
    Found or None
        Of the places where the given layout holds all that is seen, the one with most gaps.
    """
    rows, cols = given.rows - seen.rows, given.cols - seen.cols
    hidden = rows + cols > 0 and 0 <= rows <= MAX_HIDDEN and 0 <= cols <= MAX_HIDDEN
    if not hidden or not _alike_cells(seen, given):
        return None
    # Module units go with the width of a cell.
    stretched = np.diag([1.0, given.cell_aspect / seen.cell_aspect, 1.0])
    fits: list[Found] = []
    for above in range(rows + 1):
        for before in range(cols + 1):
            x, y = given.col_starts[before], given.row_starts[above]
            moved = np.array([[1.0, 0, -x], [0, 1, -y], [0, 0, 1]])
            start = Pose(there.pose.camera, there.pose.homography @ stretched @ moved)
            with contextlib.suppress(OutlineError):
                fits.append(detect_in_frame(image, given, start, whole=True))
    return max(fits, key=lambda fit: fit.share, default=None)


def better_layout(
    image: NDArray[np.float32],
    given: ModuleLayout,
    found: Found,
    inside: tuple[float, float] | None = None,
) -> ModuleLayout | None:
    """Return a layout of which clearly more gaps are in place than of the given one.

    Parameters
    ----------
    image : (height, width) float32
    given : ModuleLayout
    found : Found
        What the frame shows of it.
    inside : tuple of float, optional
        (x, y) of a point in the wanted module, LR pixels.

    Returns
    -------
    ModuleLayout or None
    """
    if found.share >= SURE_SHARE:
        return None
    seen = seen_layout(image, given, inside)
    if seen is None or fits_given(seen[0], given) or seen[1].share < found.share + CLEARLY:
        return None
    return seen[0]


def fits_given(seen: ModuleLayout, given: ModuleLayout) -> bool:
    """Whether rows and columns are the given ones, and the shape of the cells nearly."""
    return (seen.rows, seen.cols) == (given.rows, given.cols) and _alike_cells(seen, given)


def _first_that_fits(
    view: View, given: ModuleLayout, known: tuple[ModuleLayout, Found] | None = None
) -> tuple[ModuleLayout, Found] | None:
    """Try likely layouts until one fits; one that is known to fit need not be tried."""
    for layout, _ in ranked_layouts([view], {})[:MAX_TRIED]:
        seen, start = _as_given(layout, view.pose, given)
        if _few_gaps(seen) and seen.rows < given.rows and seen.cols < given.cols:
            # In small cells busbars and noise make a coarse grid.
            continue
        if known is not None and seen == known[0]:
            return known
        with contextlib.suppress(OutlineError):
            return seen, detect_in_frame(view.image, seen, start, whole=True)
    return known


def _as_given(layout: ModuleLayout, pose: Pose, given: ModuleLayout) -> tuple[ModuleLayout, Pose]:
    """Return the layout with its start; turned by a quarter if it then is nearer to the given."""
    turned = ModuleLayout(layout.cols, layout.rows, 1 / layout.cell_aspect)
    quarter = int(_difference(turned, given) < _difference(layout, given))
    seen = turned if quarter else layout
    if fits_given(seen, given):
        seen = given
    return seen, pose.turned(UNIT.size, seen.size, quarter)


def _alike_cells(one: ModuleLayout, other: ModuleLayout) -> bool:
    """Whether the cells have nearly the same shape; perspective changes the apparent one."""
    stretch = abs(np.log(one.cell_aspect / other.cell_aspect))
    return bool(stretch <= np.log(MAX_ASPECT_RATIO_ERROR))


def _few_gaps(layout: ModuleLayout) -> bool:
    rows, cols = layout.rows, layout.cols
    return rows * (cols - 1) + cols * (rows - 1) < MIN_GAPS


def _difference(one: ModuleLayout, other: ModuleLayout) -> float:
    ratios = (one.rows / other.rows, one.cols / other.cols, one.cell_aspect / other.cell_aspect)
    return float(np.abs(np.log(ratios)).sum())
