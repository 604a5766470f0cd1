"""Gaps of a module that are wider than the usual ones, found and measured in the frames.

A half-cut module has a wider gap in its middle, a mini-module wide gaps between all cells. The
lines between the cells then do not lie evenly, or the gaps take a share of the pitch. Neither is a
matter of the pose: what is measured here goes into the layout.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from pv_inspect.common.gap_text import WideGaps
from pv_inspect.common.parallel import parallel_map
from pv_inspect.common.robust import MAD_TO_SIGMA
from pv_inspect.detection.edges import CellEdges, cell_edges, measure_edges
from pv_inspect.detection.gap_proposals import proposed_layouts
from pv_inspect.detection.gaps_between_all import cell_gap_if_wide, seen_cell_gap
from pv_inspect.detection.large_frames import ReducedFrames, reduction
from pv_inspect.detection.outline import Outline, OutlineError, fit_pose
from pv_inspect.detection.seen_layout import SURE_SHARE, fits_given, seen_layout
from pv_inspect.detection.single_frame import (
    MAX_ASPECT_RATIO_ERROR,
    Found,
    complete_outlines,
    detect_in_frame,
    find_module,
    found_in_outline,
    search_units,
)
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["gaps_in_frame", "layout_with_gaps", "pose_basis", "robust_fit"]

Array = NDArray[np.float64]

TRIED_FRAMES = 3
LEAST_GAP = 0.01
"""What is less wide, 1.5 mm of a cell of 156 mm, is taken for a usual gap laid unevenly."""
LEAST_PX = 0.25
LEAST_SIGMA = 4.0
"""Of single frames of 13 simulated modules the clearest false gap had 2.3 and a width up to 0.015,
the least clear true one of 0.05 cell widths 4.3 (modules of benchmarks/wrong_layouts.py, seeds 200
to 213)."""
NARROW_GAP, NARROW_SIGMA = 0.02, 6.0
"""Narrower ones must be clearer. Of 29 single frames the clearest false gap had 3.2, the widest of
over 2 sigma 0.012 cell widths and 0.2 px (modules of benchmarks/gapped_modules.py, seeds 1000 to
1039 but the mini-modules)."""
PROPOSALS_EACH, MOST_PROPOSALS = 4, 12
"""Layouts tried in one outline, and in all of one frame."""
MOST_WIDE_GAPS = 6
CAUCHY = 2.385
"""95 % efficient on normal errors."""
KAPPA_STD = 0.2
ROUNDS = 5
SHARE_NOISE = 0.03
"""By so much the share of the gaps that are in place goes up and down by chance."""
CONVERGED = 5e-4
UNIT = ModuleLayout(1, 1)


@dataclass(frozen=True)
class _Seen:
    layout: ModuleLayout
    found: Found


def layout_with_gaps(
    sequence: FrameSequence, layout: ModuleLayout, inside: tuple[float, float] | None = None
) -> ModuleLayout:
    """Find out from some frames whether a module has wider gaps, and how wide they are.

    Parameters
    ----------
    sequence : FrameSequence
    layout : ModuleLayout
        Rows, columns and cell aspect.
    inside : tuple of float, optional
        (x, y) of a point in the wanted module, LR pixels of the first frame.

    Returns
    -------
    ModuleLayout
        With the gaps that most of these frames show; as it was given where they show none, or
        where no module is found.
    """
    factor = reduction(sequence, layout)
    if factor > 1:
        reduced = ReducedFrames(sequence, factor)
        return layout_with_gaps(reduced.as_sequence(), layout, reduced.point(inside))
    distinct = sequence.measured
    picks = np.linspace(0, len(distinct) - 1, min(len(distinct), TRIED_FRAMES)).round().astype(int)
    chosen = [distinct[pick] for pick in picks] if inside is None else distinct[:1]
    images = [sequence.frame(index).image for index in chosen]
    seen = [
        one
        for one in parallel_map(lambda image: gaps_in_frame(image, layout, inside), images)
        if one is not None
    ]
    return _agreed(layout, seen) if seen else layout


def gaps_in_frame(
    image: NDArray[np.float32],
    layout: ModuleLayout,
    inside: tuple[float, float] | None = None,
) -> ModuleLayout | None:
    """Return the layout with the wide gaps that one frame shows; None if no module is found."""
    best: _Seen | None = None
    with suppress(OutlineError):
        best = _refined(image, _Seen(layout, find_module(image, layout, inside)))
    if best is None and _other_layout_fits(image, layout, inside):
        return None
    if best is None or best.found.share < SURE_SHARE:
        for proposal, outline in islice(_proposals(image, layout, inside), MOST_PROPOSALS):
            with suppress(OutlineError):
                found = found_in_outline(image, proposal, outline)
                seen = _refined(image, _Seen(proposal, found))
                if best is None or seen.found.share > best.found.share:
                    best = seen
            if best is not None and best.found.share >= SURE_SHARE:
                break
    return None if best is None else _with_gap_between_all(image, best).layout


def _other_layout_fits(
    image: NDArray[np.float32], layout: ModuleLayout, inside: tuple[float, float] | None
) -> bool:
    """Whether other rows or columns explain the frame without any wide gap.

    One half of the given layout does not count: on both sides of a wide gap lies such a module.
    """
    seen = seen_layout(image, layout, inside)
    if seen is None or seen[1].share < SURE_SHARE or fits_given(seen[0], layout):
        return False
    other = seen[0]
    halves = sorted((layout.rows / other.rows, layout.cols / other.cols))
    return halves != [1.0, 2.0]


def _proposals(
    image: NDArray[np.float32], layout: ModuleLayout, inside: tuple[float, float] | None
) -> Iterator[tuple[ModuleLayout, Outline]]:
    """Yield layouts with gaps that may be seen, with the outline in which they may be.

    Wide gaps make outlines of single cells and of halves as well: the largest comes first.
    """
    shape = layout.size[0] / layout.size[1]
    for outline in sorted(_outlines(image, inside), key=lambda one: -one.area):
        # Dead cells may have taken a corner away.
        for whole in (outline, *outline.completed()):
            with suppress(OutlineError):
                pose, _ = fit_pose(whole, UNIT, image.shape, 0)
                for start in (pose, pose.turned(UNIT.size, UNIT.size, 1)):
                    if abs(np.log(start.aspect / shape)) > np.log(MAX_ASPECT_RATIO_ERROR):
                        continue
                    for proposal in islice(proposed_layouts(image, start, layout), PROPOSALS_EACH):
                        yield proposal, whole


def _outlines(image: NDArray[np.float32], inside: tuple[float, float] | None) -> list[Outline]:
    """Return the outlines that are not cut, as many as there are."""
    found: list[Outline] = []
    with suppress(OutlineError):
        for one in complete_outlines(image, inside):
            found.append(one)  # noqa: PERF402  # those before an error count
    return found


def _refined(image: NDArray[np.float32], seen: _Seen) -> _Seen:
    """Measure the gaps until they do not change any more."""
    layout, found = seen.layout, seen.found
    if any(layout.cell_gap):
        search = search_units(layout, found.pose)
        measured = seen_cell_gap(image, layout, found.pose, search)
        x, y = (new or old for new, old in zip(measured, layout.cell_gap, strict=True))
        layout = replace(layout, cell_gap=(x, y))
        found = _again(image, layout, layout, found) or found
    for _ in range(ROUNDS):
        wider = _with_measured_gaps(image, layout, found.pose)
        if wider is None:
            return _Seen(layout, found)
        change = float(np.abs(wider.crossings() - layout.crossings()).max())
        again = _again(image, layout, wider, found)
        if again is None or again.share < found.share - SHARE_NOISE:
            return _Seen(layout, found)
        layout, found = wider, again
        if change < CONVERGED:
            break
    return _Seen(layout, found)


def _again(
    image: NDArray[np.float32], old: ModuleLayout, new: ModuleLayout, found: Found
) -> Found | None:
    start = found.pose.turned(old.size, new.size, 0)
    with suppress(OutlineError):
        return detect_in_frame(image, new, start, whole=True)
    return None


def _with_gap_between_all(image: NDArray[np.float32], seen: _Seen) -> _Seen:
    """Return the module with a gap between all cells if its lines are clearly so wide.

    Cells that lie apart have lines wherever in the wide gaps they are looked for, so that a grid
    without such gaps, or with one wider gap somewhere, may seem to fit.
    """
    layout = seen.layout
    if any(layout.cell_gap):
        return seen
    gap = cell_gap_if_wide(image, layout, seen.found.pose, search_units(layout, seen.found.pose))
    if not 0 < max(gap) <= 2 * min(gap):
        return seen
    best = seen
    least = seen.found.share - SHARE_NOISE
    for apart in dict.fromkeys(
        (replace(layout.plain, cell_gap=gap), replace(layout, cell_gap=gap))
    ):
        with suppress(OutlineError, InspectionError):
            found = _again(image, layout, apart, seen.found) or seen.found
            tried = _refined(image, _Seen(apart, found))
            if tried.found.share >= least:
                best, least = tried, tried.found.share + SHARE_NOISE
    return best


def _with_measured_gaps(
    image: NDArray[np.float32], layout: ModuleLayout, pose: Pose
) -> ModuleLayout | None:
    """Correct the widths of the wide gaps, and add those that are missing; None if all are right.

    The offsets of the lines are explained by a change of the pose and of kappa, and by steps of
    all that lies beyond a wide gap; lines are given a step one by one as long as it is clear.
    """
    edges = cell_edges(layout)
    offsets = measure_edges(image, edges, pose, search_units(layout, pose))
    use = offsets.found & edges.inner
    if use.sum() < 12:
        return None
    base = np.einsum("nki,nk->ni", pose_basis(edges.middle, pose), edges.normal)[use]
    values, sigma = offsets.offset[use], offsets.sigma[use]
    steps = {
        (axis, line): _step(edges, axis, place)[use]
        for axis, lines in enumerate((layout.col_lines, layout.row_lines))
        for line, place in list(enumerate(lines))[1:-1]
    }
    known = {
        (axis, after): gap
        for axis, gaps in enumerate((layout.col_gaps, layout.row_gaps))
        for after, gap in gaps
    }
    chosen = list(known)
    while True:
        design = np.column_stack([base, *(steps[key] for key in chosen)])
        solution, weight = robust_fit(design, values, sigma)
        if len(chosen) - len(known) >= MOST_WIDE_GAPS:
            break
        key = _clearest_step(design, values, solution, weight, steps, chosen, pose, layout)
        if key is None:
            break
        chosen.append(key)
    extra = dict(zip(chosen, solution[base.shape[1] :], strict=True))
    if not chosen or all(abs(gap) < CONVERGED for gap in extra.values()):
        return None
    widths = {key: known.get(key, 0.0) + gap for key, gap in extra.items()}

    def gaps_of(axis: int) -> WideGaps:
        mine = ((line, gap) for (which, line), gap in widths.items() if which == axis)
        return tuple(sorted((line, float(gap)) for line, gap in mine if gap >= LEAST_GAP / 2))

    return replace(layout, col_gaps=gaps_of(0), row_gaps=gaps_of(1))


def _clearest_step(
    design: Array,
    values: Array,
    solution: Array,
    weight: Array,
    steps: dict[tuple[int, int], Array],
    chosen: list[tuple[int, int]],
    pose: Pose,
    layout: ModuleLayout,
) -> tuple[int, int] | None:
    """Return the line at which a wider gap explains most of what is left, if it is clear."""
    root = np.sqrt(weight)
    orthogonal, _ = np.linalg.qr(design * root[:, None])
    rest = (values - design @ solution) * root
    spread = MAD_TO_SIGMA * float(np.median(np.abs(rest)))
    # Of the search for the module: half of its width.
    least = max(LEAST_GAP, LEAST_PX / pose.scale_px(layout.size))
    best, clearest = None, 0.0
    for key, step in steps.items():
        if key in chosen:
            continue
        column = step * root
        column = column - orthogonal @ (orthogonal.T @ column)
        power = float(column @ column)
        if power < 1e-12:
            continue
        gap = float(column @ rest) / power
        significance = gap * np.sqrt(power) / max(spread, 1e-12)
        clear = significance > (LEAST_SIGMA if gap >= NARROW_GAP else NARROW_SIGMA)
        if gap >= least and clear and significance > clearest:
            best, clearest = key, significance
    return best


def robust_fit(design: Array, values: Array, sigma: Array) -> tuple[Array, Array]:
    """Weighted least squares with Cauchy weights; return the solution and the final weights."""
    size = np.maximum(np.abs(design).max(axis=0), 1e-12)
    # Kappa is the ninth; the others are free.
    prior = np.zeros(design.shape[1])
    prior[8] = 1 / (KAPPA_STD * size[8])
    sigma = np.hypot(sigma, np.median(sigma))
    weight, usual = np.ones(len(values)), 1.0
    for _ in range(20):
        w = np.sqrt(weight) / (usual * sigma)
        rows = np.vstack([design / size * w[:, None], np.diag(prior)])
        scaled, *_ = np.linalg.lstsq(rows, np.append(values * w, np.zeros(len(prior))), rcond=None)
        rest = (values - design / size @ scaled) / sigma
        usual = max(MAD_TO_SIGMA * float(np.median(np.abs(rest))), 1e-3)
        weight = 1 / (1 + (rest / (CAUCHY * usual)) ** 2)
    return scaled / size, weight / (usual * sigma) ** 2


def pose_basis(points: Array, pose: Pose) -> Array:
    """Displacements in the module plane: 8 of a homography, then kappa; (n, 2, 9)."""
    x, y = ((points - points.mean(axis=0)) / np.ptp(points, axis=0).max()).T
    one, zero = np.ones_like(x), np.zeros_like(x)
    plane = np.stack(
        [
            np.stack([one, x, y, zero, zero, zero, x * x, x * y], axis=-1),
            np.stack([zero, zero, zero, one, x, y, x * y, y * y], axis=-1),
        ],
        axis=1,
    )
    derivatives = pose.camera.derivatives(pose.homography, points)
    by_kappa = np.linalg.solve(derivatives.d_module, derivatives.d_kappa[..., None])
    return np.concatenate([plane, by_kappa], axis=-1)


def _step(edges: CellEdges, axis: int, place: float) -> Array:
    """How a wider gap at a line moves the edges along their normals, per unit of its width."""
    moved = 0.5 * np.sign(np.round(edges.middle[:, axis] - place, 6))
    return np.where(edges.normal[:, axis] == 1, moved, 0.0)


def _agreed(layout: ModuleLayout, seen: list[ModuleLayout]) -> ModuleLayout:
    """Return the layout with the gaps that more than half of the frames show, at their medians."""

    def common(gaps: list[WideGaps]) -> WideGaps:
        lines = sorted({after for one in gaps for after, _ in one})
        widths = {line: [dict(one)[line] for one in gaps if line in dict(one)] for line in lines}
        return tuple(
            (line, float(np.median(found)))
            for line, found in widths.items()
            if 2 * len(found) > len(seen) and np.median(found) >= LEAST_GAP
        )

    x, y = np.median([one.cell_gap for one in seen], axis=0)
    return replace(
        layout,
        row_gaps=common([one.row_gaps for one in seen]),
        col_gaps=common([one.col_gaps for one in seen]),
        cell_gap=(float(x), float(y)),
    )
