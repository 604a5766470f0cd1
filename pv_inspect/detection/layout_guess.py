"""Rows, columns and cell aspect of a module, guessed from the frames when nobody gives them.

Through the pose of the outline the module is a rectangle in which the gaps between cells are evenly
spaced dark lines (see `pv_inspect.detection.line_scores`). What those leave open, the aspect of the
cells and the edges of gaps in single frames decide.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.detection.large_frames import ReducedFrames, reduction
from pv_inspect.detection.line_profiles import rectified, unit_corners
from pv_inspect.detection.line_scores import FINER, LineScores, line_scores
from pv_inspect.detection.outline import OutlineError, find_outlines, fit_pose
from pv_inspect.detection.single_frame import detect_in_frame
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose
from pv_inspect.sequence.sequence import FrameSequence
from pv_inspect.settings import Settings

__all__ = [
    "LayoutGuess",
    "View",
    "guess_layout",
    "is_known",
    "layouts_in",
    "ranked_layouts",
    "scored_view",
    "view_of",
]

Array = NDArray[np.float64]

# No search for these constants is on record: they were chosen by hand. What they give is shown by
# tests/detection/test_layout_guess.py on simulated modules, and on photographs by
# `python benchmarks/field.py FOLDER --guess`.

MAX_FRAMES = 6
"""Frames that are looked at, spread over the sequence."""
MAX_CANDIDATES = 8
USUAL_ASPECTS = (1.0, 2.0, 0.5, 3.0, 1 / 3)
"""Width over height of whole cells and of cells cut in two and three, either way."""
SNAP = 0.12
"""A cell aspect this near to a usual one is taken for it; the perspective leaves it uncertain."""
ASPECT_SIGMA = 0.06
"""Spread of the logarithm of a seen aspect around a usual one."""
UNUSUAL_WEIGHT = 0.15
"""Least weight of a layout whose cells are of another aspect."""
MIN_SCORE = 0.02
"""A layout with less is no candidate."""
MIN_CONFIDENCE = 0.4
"""With less a guess is refused."""
CLOSE = 0.3
"""Share of the best score from which on the next best layout is named to the user."""
MAX_DISTANCE = 0.01
"""Median distance of the contour from a rectangle, in lengths of a side."""
CLEAR = 0.25
"""Score from which on a grid counts as clear: no other outline is tried, confidence is full."""
CHECKED_FRAMES = 3
"""Frames in which the gaps of a layout have to be in place."""
UNIT = ModuleLayout(1, 1)


@dataclass(frozen=True)
class LayoutGuess:
    """What the frames say about the layout, for a person to confirm.

    Parameters
    ----------
    layout : ModuleLayout
        The most likely rows, columns and cell aspect; how wide its wide gaps are is measured by
        `pv_inspect.detection.wide_gaps`.
    confidence : float
        1 - score of the next best layout / score of this one, less where no grid is clear; 0 to 1.
    alternatives : tuple of ModuleLayout
        Other layouts, more likely ones first.
    runner_up : ModuleLayout or None
        The first of them, if its gaps are in place too and it is nearly as likely.
    """

    layout: ModuleLayout
    confidence: float
    alternatives: tuple[ModuleLayout, ...]
    runner_up: ModuleLayout | None = None


@dataclass(frozen=True)
class View:
    """One frame: the module as the unit square, and how well each number of cells fits."""

    image: NDArray[np.float32]
    pose: Pose
    across: LineScores
    down: LineScores
    ratio: float

    def turned(self) -> View:
        """Return the view of the module turned by a quarter."""
        pose = self.pose.turned(UNIT.size, UNIT.size, 1)
        return View(self.image, pose, self.down, self.across, 1 / self.ratio)


def guess_layout(
    sequence: FrameSequence,
    settings: Settings | None = None,
    inside: tuple[float, float] | None = None,
) -> LayoutGuess:
    """Guess rows, columns and cell aspect of the module that the frames show.

    Parameters
    ----------
    sequence : FrameSequence
    settings : Settings, optional
        The guess keeps to what they, or else ``module.json``, say of rows, cols and cell_aspect.
    inside : tuple of float, optional
        (x, y) of a point in the wanted module, LR pixels.

    Returns
    -------
    LayoutGuess

    Raises
    ------
    InspectionError
        If no frame shows a whole module, or its gaps do not tell how many cells it has.
    """
    known = _known(sequence, settings or Settings())
    factor = reduction(sequence, None)
    if factor > 1:
        reduced = ReducedFrames(sequence, factor)
        sequence, inside = reduced.as_sequence(), reduced.point(inside)
    views: list[View] = []
    reason = "no frame"
    distinct = sequence.measured
    picks = np.linspace(0, len(distinct) - 1, min(len(distinct), 2 * MAX_FRAMES)).round()
    for index in (distinct[int(pick)] for pick in np.unique(picks)):
        if len(views) == MAX_FRAMES:
            break
        try:
            view = view_of(sequence.frame(index).image, inside, wide_gaps=True)
        except OutlineError as error:
            reason = f"{sequence.names[index]}: {error}"
            continue
        if views and abs(np.log(view.ratio * views[0].ratio)) < abs(
            np.log(view.ratio / views[0].ratio)
        ):
            view = view.turned()
        views.append(view)
    if not views:
        raise InspectionError(
            f"The rows and columns of cells can't be guessed, no frame shows a whole module "
            f"({reason}): give rows and cols (--rows, --cols)."
        )
    candidates = ranked_layouts(views, known)
    # Even a guess with half of the lines brings the pose that shows all of them sharply.
    for layout, _ in candidates:
        held = _in_place(views, layout)
        if held:
            sharper = [scored_view(view.image, pose, wide_gaps=True) for view, pose in held]
            candidates = ranked_layouts(sharper, known)
            break
    good = [pair for pair in candidates if _in_place(views, pair[0])]
    confidence = 0.0
    if good:
        rest = good[1][1] if len(good) > 1 else 0.0
        confidence = min(1.0, good[0][1] / CLEAR) * (1.0 - rest / good[0][1])
    if confidence < MIN_CONFIDENCE:
        seen = " or ".join(_words(layout) for layout, _ in (good or candidates)[:2])
        raise InspectionError(
            "The rows and columns of cells can't be guessed with confidence"
            + (f" ({seen} perhaps)" if seen else "")
            + ": give rows and cols (--rows, --cols)."
        )
    best = good[0][0].plain
    others = [layout.plain for layout, _ in [*good[1:], *candidates]]
    alternatives = tuple(dict.fromkeys(other for other in others if other != best))[:3]
    close = alternatives and len(good) > 1 and good[1][1] > CLOSE * good[0][1]
    return LayoutGuess(best, confidence, alternatives, alternatives[0] if close else None)


def layouts_in(image: NDArray[np.float32]) -> list[tuple[ModuleLayout, float]]:
    """Likely layouts of the module in one picture with their scores, 0 to 1, best first.

    None if no outline stands out from what is around it, or no grid is seen in it.
    """
    try:
        return ranked_layouts([view_of(image, None)], {})
    except OutlineError:
        return []


def is_known(sequence: FrameSequence, settings: Settings) -> bool:
    """Whether the settings or ``module.json`` give both rows and columns."""
    return _known(sequence, settings).keys() >= {"rows", "cols"}


def _known(sequence: FrameSequence, settings: Settings) -> dict[str, float]:
    given = {key: getattr(settings, key) for key in ("rows", "cols", "cell_aspect")}
    return {**sequence.layout_hint, **{k: v for k, v in given.items() if v is not None}}


def view_of(
    image: NDArray[np.float32], inside: tuple[float, float] | None, wide_gaps: bool = False
) -> View:
    """Take the outline in which the lines of a grid are clearest."""
    best: View | None = None
    for outline in find_outlines(image, inside):
        if outline.cut:
            continue
        pose, distance = fit_pose(outline, UNIT, image.shape, 0)
        view = scored_view(image, pose, wide_gaps)
        if distance > MAX_DISTANCE * np.sqrt(cv2.contourArea(unit_corners(pose))):
            continue
        if best is None or _strength(view) > _strength(best):
            best = view
        if _strength(best) > CLEAR:
            break
    if best is None:
        raise OutlineError(
            "what is bright runs over the border of the image, no module is completely in view"
        )
    return best


def scored_view(image: NDArray[np.float32], pose: Pose, wide_gaps: bool = False) -> View:
    """Score each number of cells on the module seen through a pose of the unit square."""
    corners = unit_corners(pose)
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    across_px, down_px = float(sides[[0, 2]].mean()), float(sides[[1, 3]].mean())
    return View(
        image,
        pose,
        line_scores(rectified(image, pose, across_px, True), across_px, wide_gaps),
        line_scores(rectified(image, pose, down_px, False), down_px, wide_gaps),
        pose.aspect,
    )


def _strength(view: View) -> float:
    return float(view.across.base.max() * view.down.base.max())


def ranked_layouts(views: list[View], known: dict[str, float]) -> list[tuple[ModuleLayout, float]]:
    """Likely layouts with their scores, best first."""
    across, down = [view.across for view in views], [view.down for view in views]
    score_across, score_down = (np.mean([s.base for s in side], axis=0) for side in (across, down))
    finer_across, finer_down = (np.mean([s.finer for s in side], axis=0) for side in (across, down))
    gaps_across, gaps_down = _typical_gaps(across), _typical_gaps(down)
    ratio = float(np.median([view.ratio for view in views]))
    factors = np.array(FINER, np.float64)
    found = []
    likely = np.argwhere(score_down[:, None] * score_across[None, :] > MIN_SCORE)
    for n_rows, n_cols in likely.tolist():
        if n_rows != known.get("rows", n_rows) or n_cols != known.get("cols", n_cols):
            continue
        middle_x, between_x = gaps_across[n_cols].tolist()
        middle_y, between_y = gaps_down[n_rows].tolist()
        seen = ratio * (n_rows + middle_y - between_y) / (n_cols + middle_x - between_x)
        aspect, weight = _cell_aspect(seen, known.get("cell_aspect"))
        score = weight
        score *= score_down[n_rows] - (_usual(seen * factors) * finer_down[n_rows]).max()
        score *= max(
            score_across[n_cols] - (_usual(seen / factors) * finer_across[n_cols]).max(), 0.0
        )
        if score > MIN_SCORE:
            layout = ModuleLayout(
                n_rows,
                n_cols,
                aspect,
                ((n_rows // 2, middle_y / aspect),) if middle_y else (),
                ((n_cols // 2, middle_x),) if middle_x else (),
                (between_x, between_y / aspect),
            )
            found.append((layout, float(score)))
    return sorted(found, key=lambda pair: -pair[1])[:MAX_CANDIDATES]


def _typical_gaps(sides: list[LineScores]) -> Array:
    """Gap in the middle and between all cells that most views see, per number of cells, (n, 2)."""
    seen = np.median([[side.middle, side.between] for side in sides], axis=0)
    return np.asarray(seen.T, np.float64)


def _usual(aspects: Array) -> Array:
    """Weight of gaps that would make cells of these aspects: busbars make unusual ones."""
    distance = np.abs(np.log(aspects[:, None] / np.array(USUAL_ASPECTS))).min(axis=1)
    return np.where(distance < np.log1p(SNAP), 1.0, 0.5)


def _cell_aspect(seen: float, known: float | None) -> tuple[float, float]:
    """Cell aspect to take for a seen one, and how likely it is."""
    usual = USUAL_ASPECTS if known is None else (known,)
    nearest = min(usual, key=lambda aspect: abs(np.log(seen / aspect)))
    distance = abs(np.log(seen / nearest))
    weight = float(np.exp(-0.5 * (distance / ASPECT_SIGMA) ** 2))
    if distance < np.log1p(SNAP):
        return nearest, max(weight, UNUSUAL_WEIGHT)
    if known is not None or not 0.25 <= seen <= 4:
        return nearest, 0.0
    return round(seen, 2), UNUSUAL_WEIGHT


def _in_place(views: list[View], layout: ModuleLayout) -> list[tuple[View, Pose]]:
    """Refine the pose of the unit square on the gaps of a layout in some frames.

    Returns an empty list unless the gaps are in place in most of these frames, with the wide ones
    or without.
    """
    tried = views[:CHECKED_FRAMES]
    held = [(view, pose) for view in tried if (pose := _pose_on(view, layout)) is not None]
    if 2 * len(held) > len(tried):
        return held
    return [] if layout == layout.plain else _in_place(views, layout.plain)


def _pose_on(view: View, layout: ModuleLayout) -> Pose | None:
    """Refine the pose of the unit square on the gaps of a layout; None if they are not there."""
    to_unit = _to_unit(layout)
    start = Pose(view.pose.camera, view.pose.homography @ to_unit)
    with suppress(OutlineError):
        pose = detect_in_frame(view.image, layout, start, whole=True).pose
        return Pose(pose.camera, pose.homography @ np.linalg.inv(to_unit))
    return None


def _to_unit(layout: ModuleLayout) -> Array:
    """Homography from the module plane to the unit square that the cells fill."""
    (left, top), _, (right, bottom), _ = layout.outline
    x, y = 1 / (right - left), 1 / (bottom - top)
    return np.array([[x, 0, -x * left], [0, y, -y * top], [0, 0, 1]])


def _words(layout: ModuleLayout) -> str:
    return f"{layout.rows} x {layout.cols} cells"
