"""Rows, columns and cell aspect of a module, guessed from the frames when nobody gives them.

Through the pose of the outline the module is a rectangle in which gaps between cells are dark
lines at k / n of its width and height. Busbars are dark lines too, in one direction; they are less
dark, not evenly spaced together with the gaps, or make cells of an unlikely aspect.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.detection.large_frames import ReducedFrames, reduction
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

MAX_FRAMES = 6
MAX_CANDIDATES = 8
USUAL_ASPECTS = (1.0, 2.0, 0.5)
SNAP = 0.12
"""A cell aspect this near to a usual one is taken for it; the perspective leaves it uncertain."""
ASPECT_SIGMA = 0.06
UNUSUAL_WEIGHT = 0.15
MIN_CELL_PX = 8.0
MAX_CELLS = 60
RECTIFIED_PX = (300, 2400)
SAMPLES_PER_PX = 1.5
SAMPLES_ALONG = 240
BANDS = 6
BETWEEN = np.arange(0.15, 0.851, 0.05)
FINER = (2, 3, 4, 5)
BUSBAR_WEIGHT = 0.25
MIN_SCORE = 0.02
VALLEYS_PX = (2.5, 5.0)
"""Distances at which a dark line is compared with what is beside it, LR pixels."""
SHALLOW_BANDS = 2
"""Bands in which a gap need not show: a few cells are dead. A crack ends sooner."""
MIN_DEPTH = 0.05
MIN_CONFIDENCE = 0.4
MAX_DISTANCE = 0.01
"""Median distance of the contour from a rectangle, in lengths of a side."""
CLEAR = 0.25
CHECKED_FRAMES = 3
UNIT = ModuleLayout(1, 1)


@dataclass(frozen=True)
class LayoutGuess:
    """What the frames say about the layout, for a person to confirm.

    Parameters
    ----------
    layout : ModuleLayout
        The most likely one.
    confidence : float
        1 - score of the next best layout / score of this one, less where no grid is clear; 0 to 1.
    alternatives : tuple of ModuleLayout
        Other layouts, more likely ones first.
    """

    layout: ModuleLayout
    confidence: float
    alternatives: tuple[ModuleLayout, ...]


@dataclass(frozen=True)
class _Lines:
    """How well each number of cells n fits along one direction.

    `base` (n,) is the score, 0 to 1; `finer` (n, m) the depth of the lines that would divide each
    cell into `FINER` [m] ones.
    """

    base: Array
    finer: Array


@dataclass(frozen=True)
class View:
    """One frame: the module as the unit square, and how well each number of cells fits."""

    image: NDArray[np.float32]
    pose: Pose
    across: _Lines
    down: _Lines
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
    distinct = [index for index in range(len(sequence)) if index not in sequence.copies]
    picks = np.linspace(0, len(distinct) - 1, min(len(distinct), 2 * MAX_FRAMES)).round()
    for index in (distinct[int(pick)] for pick in np.unique(picks)):
        if len(views) == MAX_FRAMES:
            break
        try:
            view = view_of(sequence.frame(index).image, inside)
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
        sharper = _sharpened(views, layout)
        if sharper:
            candidates = ranked_layouts(sharper, known)
            break
    good = [pair for pair in candidates if _sharpened(views, pair[0])]
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
    others = tuple(layout for layout, _ in [*good[1:], *candidates] if layout != good[0][0])
    return LayoutGuess(good[0][0], confidence, tuple(dict.fromkeys(others))[:3])


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


def view_of(image: NDArray[np.float32], inside: tuple[float, float] | None) -> View:
    """Take the outline in which the lines of a grid are clearest."""
    best: View | None = None
    for outline in find_outlines(image, inside):
        if outline.cut:
            continue
        pose, distance = fit_pose(outline, UNIT, image.shape, 0)
        view = scored_view(image, pose)
        if distance > MAX_DISTANCE * np.sqrt(cv2.contourArea(_corners(pose))):
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


def _corners(pose: Pose) -> NDArray[np.float32]:
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    return np.nan_to_num(pose.project(square)).astype(np.float32)


def scored_view(image: NDArray[np.float32], pose: Pose) -> View:
    """Score each number of cells on the module seen through a pose of the unit square."""
    corners = _corners(pose)
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    across_px, down_px = float(sides[[0, 2]].mean()), float(sides[[1, 3]].mean())
    return View(
        image,
        pose,
        _line_scores(_rectified(image, pose, across_px, True), across_px),
        _line_scores(_rectified(image, pose, down_px, False), down_px),
        pose.aspect,
    )


def _strength(view: View) -> float:
    return float(view.across.base.max() * view.down.base.max())


def _rectified(
    image: NDArray[np.float32], pose: Pose, side_px: float, upright: bool
) -> NDArray[np.float32]:
    """See the module as a rectangle whose columns run along the lines that are sought."""
    fine = int(np.clip(SAMPLES_PER_PX * side_px, *RECTIFIED_PX))
    across, along = np.meshgrid(
        (np.arange(fine) + 0.5) / fine, (np.arange(SAMPLES_ALONG) + 0.5) / SAMPLES_ALONG
    )
    points = np.stack([across, along] if upright else [along, across], axis=-1).reshape(-1, 2)
    lookup = np.nan_to_num(pose.project(points), nan=-1e4).astype(np.float32)
    lookup = lookup.reshape(*across.shape, 2)
    rectified = cv2.remap(
        image, lookup[..., 0], lookup[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(rectified, np.float32)


def _line_profiles(rectified: NDArray[np.float32], lr_px: float) -> NDArray[np.float32]:
    """How dark the line at each column is against its surroundings, 0 to 1, in bands along it.

    The lines are a little bent yet, because the pose is that of the outline alone: within a band
    that does not matter. `lr_px` is the number of columns per LR pixel.
    """
    smooth = cv2.blur(rectified, (max(1, round(lr_px)) | 1, 3))
    depth = np.zeros(rectified.shape, np.float32)
    for distance in VALLEYS_PX:
        step = max(1, round(distance * lr_px))
        padded = cv2.copyMakeBorder(smooth, 0, 0, step, step, cv2.BORDER_REPLICATE)
        beside = np.minimum(padded[:, : -2 * step], padded[:, 2 * step :])
        depth = np.maximum(depth, 1 - smooth / np.maximum(beside, 1e-4))
    tolerance = 2 * max(1, round(0.5 * lr_px)) + 1
    depth = np.asarray(cv2.dilate(depth, np.ones((1, tolerance), np.uint8)), np.float32)
    bands = [np.median(band, axis=0) for band in np.array_split(depth, BANDS)]
    return np.asarray(bands, np.float32)


def _line_scores(rectified: NDArray[np.float32], side_px: float) -> _Lines:
    """Score every number of cells n from 0 to `MAX_CELLS` along x.

    Relative to the deepest lines there are, the score is the depth of the shallower lines at k / n,
    less what differs between one cell and the next, less a little for other lines in the cells.
    """
    width = rectified.shape[1]
    profiles = _line_profiles(rectified, width / side_px)
    base = np.zeros(MAX_CELLS + 1)
    depths = np.zeros(MAX_CELLS + 1)
    finer = np.zeros((MAX_CELLS + 1, len(FINER)))
    for n in range(2, int(min(MAX_CELLS, side_px / MIN_CELL_PX)) + 1):
        lines = _along(profiles, 0.1 * width / n)[_columns(np.arange(1, n) / n, width)]
        depths[n] = np.quantile(lines, 0.15)
        within = _along(profiles, 0.03 * width / n)

        def typical(phase: Array, n: int = n, within: Array = within) -> tuple[Array, Array]:
            cells = np.arange(n)
            one = within[_columns((cells + phase[:, None]) / n, width)]
            other = within[_columns((cells + 1 - phase[:, None]) / n, width)]
            either = np.quantile(np.maximum(one, other), 0.4, axis=1)
            return np.quantile(one, 0.4, axis=1), either

        one, either = typical(BETWEEN)
        # Busbars lie symmetrically in a cell: half cells see them now on this side, now on that.
        mirrored = np.maximum(one, one[::-1])
        base[n] = depths[n] - (either - mirrored).max() - BUSBAR_WEIGHT * mirrored.max()
        for k, factor in enumerate(FINER):
            finer[n, k] = typical(np.arange(1, factor) / factor)[0].min()
    for k, factor in enumerate(FINER):
        # Lines that make no even grid of their own are busbars, however dark.
        even = np.zeros_like(base)
        even[: MAX_CELLS // factor + 1] = base[::factor][: MAX_CELLS // factor + 1]
        finer[:, k] = np.clip(np.minimum(finer[:, k], even), 0, None)
    deepest = float(depths.max())
    if deepest < MIN_DEPTH:
        return _Lines(np.zeros_like(base), np.zeros_like(finer))
    return _Lines(np.clip(base / deepest, 0, 1), finer / deepest)


def _along(profiles: NDArray[np.float32], reach: float) -> Array:
    """Depth of the line within `reach` of each column, which must hold along most of its length."""
    kernel = np.ones((1, 2 * round(reach) + 1), np.uint8)
    near = np.asarray(cv2.dilate(profiles, kernel), np.float64)
    return np.asarray(np.partition(near, SHALLOW_BANDS, axis=0)[SHALLOW_BANDS])


def _columns(place: Array, width: int) -> NDArray[np.int64]:
    return np.minimum((place * width).astype(np.int64), width - 1)


def ranked_layouts(views: list[View], known: dict[str, float]) -> list[tuple[ModuleLayout, float]]:
    """Likely layouts with their scores, best first."""
    across = np.mean([view.across.base for view in views], axis=0)
    down = np.mean([view.down.base for view in views], axis=0)
    finer_across = np.mean([view.across.finer for view in views], axis=0)
    finer_down = np.mean([view.down.finer for view in views], axis=0)
    ratio = float(np.median([view.ratio for view in views]))
    factors = np.array(FINER, np.float64)
    found = []
    for n_rows, n_cols in np.argwhere(down[:, None] * across[None, :] > MIN_SCORE).tolist():
        if n_rows != known.get("rows", n_rows) or n_cols != known.get("cols", n_cols):
            continue
        seen = ratio * n_rows / n_cols
        aspect, weight = _cell_aspect(seen, known.get("cell_aspect"))
        score = weight
        score *= down[n_rows] - (_usual(seen * factors) * finer_down[n_rows]).max()
        score *= max(across[n_cols] - (_usual(seen / factors) * finer_across[n_cols]).max(), 0.0)
        if score > MIN_SCORE:
            found.append((ModuleLayout(n_rows, n_cols, aspect), float(score)))
    return sorted(found, key=lambda pair: -pair[1])[:MAX_CANDIDATES]


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


def _sharpened(views: list[View], layout: ModuleLayout) -> list[View]:
    """Score some frames again with poses refined on the gaps of a layout.

    Returns an empty list unless the gaps are in place in most of these frames.
    """
    held = []
    tried = views[:CHECKED_FRAMES]
    for view in tried:
        start = view.pose.turned(UNIT.size, layout.size, 0)
        try:
            pose = detect_in_frame(view.image, layout, start, whole=True).pose
        except OutlineError:
            continue
        held.append(scored_view(view.image, pose.turned(layout.size, UNIT.size, 0)))
    return held if 2 * len(held) > len(tried) else []


def _words(layout: ModuleLayout) -> str:
    return f"{layout.rows} x {layout.cols} cells"
