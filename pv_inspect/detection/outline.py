"""Where the module is in one frame: its bright area and the pose that explains the outline.

The outline gives the pose to about one pixel, lens distortion included;
`pv_inspect.detection.detect` refines it on the gaps between the cells.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pv_inspect.common.robust import MAD_TO_SIGMA
from pv_inspect.geometry.camera import Camera
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose

__all__ = [
    "FILLED",
    "MAX_KAPPA",
    "Outline",
    "OutlineError",
    "conventional_camera",
    "find_outline",
    "find_outlines",
    "fit_pose",
    "solver_errors_as_reasons",
]

Array = NDArray[np.float64]
MIN_AREA_SHARE = 0.02
MIN_LENGTH_SHARE = 0.5
"""What is smaller but as long as this share of the frame is a module of one row."""
LARGE_SHARE = 0.3
MAX_COMPONENTS = 3
MAX_MISSING_CORNER = 1.25
"""Area of a module over that of the convex hull of what is bright of it."""
BOW = 0.04
"""How far distortion bends a side off the straight line, in square roots of the area."""
CLOSINGS_PX = (9, 7, 5, 3)
"""Widths of gaps that are closed when the generous first one does not show the module."""
WIDER = (2, 4)
"""At the end gaps are closed that are so many times wider: those of mini-modules."""
MAX_KAPPA = 1.0
"""For a focal length of the longer side of the frame; lenses have -0.4 to 0.2. The few lines of
four cells can be fitted by 207 and too wide a pitch, their notched outline by 143
(benchmarks/gapped_modules.py, seeds 112 and 67)."""

FILLED = "no module outline: the bright area fills the frame"


class OutlineError(Exception):
    """The frame shows no module; the text says why, as part of a sentence."""


@contextmanager
def solver_errors_as_reasons() -> Iterator[None]:
    """Turn the errors of solvers into an `OutlineError`; also a decorator.

    A few dead or foreign cells can leave an outline, or gaps, that determine no pose.
    """
    try:
        yield
    except (np.linalg.LinAlgError, cv2.error):
        raise OutlineError("what is bright in it determines no pose of a flat module") from None


@dataclass(frozen=True)
class Outline:
    """Contour of the bright area of the module.

    Parameters
    ----------
    points_px : (n, 2) float64
        Contour points that are not on the border of the image.
    corners_px : (4, 2) float64
        Corners of the enclosing quadrilateral, clockwise as seen on the screen.
    cut : bool
        Whether the border of the image cuts the module.
    """

    points_px: Array
    corners_px: Array
    cut: bool

    @property
    def area(self) -> float:
        """Area of the enclosing quadrilateral, square pixels."""
        return _area(self.corners_px)

    def completed(self) -> Iterator[Outline]:
        """Yield the outline with a corner put back that dead cells took away.

        The convex hull then has five sides; without the one across the missing corner its
        neighbours meet where the corner of the module is. The contour of the dead cells is dropped.
        """
        hull = cv2.convexHull(self.points_px.astype(np.float32))
        five = np.asarray(cv2.approxPolyN(hull, 5, ensure_convex=True), np.float64).reshape(-1, 2)
        area = cv2.contourArea(hull)
        for k in range(len(five)):
            before, first, second, after = (five[(k + i) % len(five)] for i in (-1, 0, 1, 2))
            sides = np.column_stack([first - before, after - second])
            if abs(np.linalg.det(sides)) < 1e-6:
                continue
            ahead = np.linalg.solve(sides, second - first)
            corner = first + ahead[0] * (first - before)
            others = [five[(k + i) % len(five)] for i in (2, 3, 4)]
            whole = np.array([corner, *others])
            if (ahead > 0).all() and _area(whole) < MAX_MISSING_CORNER * area:
                contour = whole[:, None].astype(np.float32)
                reach = BOW * np.sqrt(area)
                near = [
                    abs(cv2.pointPolygonTest(contour, (float(x), float(y)), True)) < reach
                    for x, y in self.points_px
                ]
                yield Outline(self.points_px[near], _clockwise(whole), self.cut)


def conventional_camera(shape: tuple[int, int], kappa: float = 0.0) -> Camera:
    """Return a camera with its principal point in the centre and f = the longer image side.

    Not `conventional_focal_length` of the calibration, which is 1.2 times it: poses of the outline
    are starts only, but the stiffness of kappa in `fit_pose` belongs to this f.
    """
    return Camera.centred(float(max(shape)), shape, kappa)


def find_outline(image: NDArray[np.float32]) -> Outline:
    """Return the first of `find_outlines`: what most likely is the module.

    Raises
    ------
    OutlineError
        If the frame is black, saturated, or shows nothing that is bright and large enough.
    """
    return next(find_outlines(image))


def find_outlines(
    image: NDArray[np.float32], inside: tuple[float, float] | None = None
) -> Iterator[Outline]:
    """Segment what may be the module from the dark background and take its contour.

    How wide a gap between cells is compared with one between modules is not known beforehand:
    first all gaps are closed generously, then less and less, so that modules of one string come
    apart. Whoever knows the rows and columns takes the first outline that holds them.

    Parameters
    ----------
    image : (height, width) float32
        Frame, full scale = 1.
    inside : tuple of float, optional
        (x, y) of a point in the wanted module, LR pixels. By default the wanted module is the
        one nearest to the centre of the frame that the frame shows completely.

    Yields
    ------
    Outline
        Complete ones first for every way of closing the gaps; cut ones only at the end.

    Raises
    ------
    OutlineError
        If the frame is black, saturated, or shows nothing that is bright and large enough.
    """
    height, width = image.shape
    smooth = cv2.GaussianBlur(image, (0, 0), 1.5)
    low, high = (float(v) for v in np.percentile(smooth, [1, 99]))
    if low > 0.9:
        raise OutlineError("saturated")
    noise = _noise(image) / 3.0
    if high - low < max(8 * noise, 1e-3):
        raise OutlineError("black: nothing in it is brighter than the background")
    scaled = (np.clip((smooth - low) / (high - low), 0, 1) * 255).astype(np.uint8)
    threshold, _ = cv2.threshold(scaled, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    # Otsu splits at the middle of the classes; dark cells are nearer to the background.
    mask = (scaled > 0.8 * threshold).astype(np.uint8)
    wanted = np.array(inside if inside is not None else (width / 2, height / 2), np.float64)
    widest = max(3, min(height, width) // 40) | 1
    cut: list[Outline] = []
    largest, filling = 0.0, False
    narrower = (size for size in CLOSINGS_PX if size < widest)
    for size in (widest, *narrower, *(widest * factor | 1 for factor in WIDER)):
        components = _components(_closed(mask, size, widest), wanted, inside is not None)
        for component in components:
            share = float(component.mean())
            largest = max(largest, share)
            if share < MIN_AREA_SHARE and _length(component) < MIN_LENGTH_SHARE * max(
                width, height
            ):
                continue
            outline = _contour(component)
            if outline is None:
                filling = True
            elif outline.cut:
                cut.append(outline)
            else:
                yield outline
    if filling:
        raise OutlineError(FILLED)
    yield from cut[:1]
    if largest < MIN_AREA_SHARE:
        raise OutlineError(
            f"no module: the largest bright area at least {widest} px wide covers "
            f"{100 * largest:.1f} % of the frame"
        )


@solver_errors_as_reasons()
def fit_pose(
    outline: Outline,
    layout: ModuleLayout,
    shape: tuple[int, int],
    quarter_turns: int,
    *,
    distorted: bool = True,
) -> tuple[Pose, float]:
    """Fit homography and kappa so that the contour lies on the outline of the module.

    Parameters
    ----------
    outline : Outline
    layout : ModuleLayout
    shape : tuple of int
        (height, width) of the frame.
    quarter_turns : int
        Which corner of the quadrilateral is the module's top left one, 0 to 3.
    distorted : bool
        Whether kappa is fitted. Rounded corners of the outline, or dead cells in them, look like
        distortion: then a fit without it comes closer. It is taken at once where only a lens that
        can't be explains the outline.

    Returns
    -------
    Pose
    float
        Median distance of the contour from the outline, LR pixels.
    """
    target = layout.outline
    width, height = target[2] - target[0]
    camera = conventional_camera(shape)
    corners = np.roll(outline.corners_px, -quarter_turns, axis=0)
    normalised = (corners - camera.K[:2, 2]) / camera.K[0, 0]
    start = cv2.getPerspectiveTransform(target.astype(np.float32), normalised.astype(np.float32))
    points = outline.points_px[:: max(1, len(outline.points_px) // 600)]
    side_px = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    scale = float(side_px.sum() / (2 * (width + height)))
    centre = target.mean(axis=0)
    half = np.array([width, height]) / 2

    stiffness = 5.0 if distorted else 1e6
    # The plane is centred and scaled so that all parameters are of one order.
    inner = np.array([[width / 2, 0, centre[0]], [0, width / 2, centre[1]], [0, 0, 1.0]])
    first = start @ inner
    first = first / first[2, 2]

    def pose(parameters: Array) -> Pose:
        matrix = np.append(parameters[:8], 1.0).reshape(3, 3) @ np.linalg.inv(inner)
        return Pose(Camera(camera.K, float(parameters[8])), matrix)

    def residuals(parameters: Array) -> Array:
        found = pose(parameters).unproject(points)
        excess = np.abs(found - centre) - half
        outside = np.maximum(excess, 0)
        # Signed distance of a point from the rectangle, in pixels at the mean scale.
        distance = np.hypot(outside[:, 0], outside[:, 1]) + np.minimum(excess.max(axis=1), 0)
        return np.append(np.nan_to_num(distance * scale, nan=50.0), stiffness * parameters[8])

    # Without distortion the quadrilateral is near, and what is missing of the outline can be
    # ignored; with it, the middles of the sides may be far from the start.
    loss, width_px = ("soft_l1", 1.0) if distorted else ("cauchy", 2.0)
    fit = least_squares(
        residuals, np.append(first.ravel()[:8], 0.0), loss=loss, f_scale=width_px, max_nfev=60
    )
    if distorted and not abs(float(fit.x[8])) <= MAX_KAPPA:
        return fit_pose(outline, layout, shape, quarter_turns, distorted=False)
    return pose(fit.x), float(np.median(np.abs(residuals(fit.x)[:-1])))


def _noise(image: NDArray[np.float32]) -> float:
    difference = np.diff(image, axis=1)
    return float(MAD_TO_SIGMA * np.median(np.abs(difference - np.median(difference))) / np.sqrt(2))


def _closed(mask: NDArray[np.uint8], size: int, opening: int) -> NDArray[np.uint8]:
    """Close gaps up to `size` pixels, then remove what is thinner than `opening`."""
    pad = max(size, opening)
    padded = cv2.copyMakeBorder(mask, pad, pad, pad, pad, cv2.BORDER_REPLICATE)
    close, open_ = (cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (n, n)) for n in (size, opening))
    closed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, close)
    closed = cv2.morphologyEx(closed, cv2.MORPH_OPEN, open_)
    return np.asarray(closed[pad:-pad, pad:-pad], np.uint8)


def _components(
    mask: NDArray[np.uint8], wanted: Array, strict: bool
) -> Iterator[NDArray[np.uint8]]:
    """Yield the large components, the one nearest to the wanted point first."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
    if count < 2:
        return
    areas = stats[1:, cv2.CC_STAT_AREA].astype(np.float64)
    distances = {}
    for label in (np.flatnonzero(areas > LARGE_SHARE * areas.max()) + 1).tolist():
        pixels = np.argwhere(labels == label)[:, ::-1]
        distances[label] = float(np.linalg.norm(pixels - wanted, axis=1).min())
    order = sorted(distances, key=lambda label: distances[label])
    for label in order[: 1 if strict else MAX_COMPONENTS]:
        yield np.asarray(labels == label, np.uint8)


def _length(component: NDArray[np.uint8]) -> float:
    """Diagonal of the upright rectangle around a component, pixels."""
    _, _, width, height = cv2.boundingRect(component)
    return float(np.hypot(width, height))


def _contour(component: NDArray[np.uint8]) -> Outline | None:
    """Contour of a component; None if hardly any of it lies inside of the frame."""
    height, width = component.shape
    contours, _ = cv2.findContours(component, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    contour = max(contours, key=cv2.contourArea)[:, 0].astype(np.float64)
    inside = np.all((contour > 1) & (contour < [width - 2, height - 2]), axis=1)
    if inside.sum() < 40:
        return None
    hull = cv2.convexHull(contour.astype(np.float32))
    corners = np.asarray(cv2.approxPolyN(hull, 4, ensure_convex=True), np.float64).reshape(-1, 2)
    return Outline(contour[inside], _clockwise(corners), bool((~inside).sum() > 10))


def _area(polygon: Array) -> float:
    return float(cv2.contourArea(polygon.astype(np.float32)))


def _clockwise(corners: Array) -> Array:
    """Order corners clockwise on the screen, beginning with the one nearest to the top left."""
    angle = np.arctan2(*(corners - corners.mean(axis=0)).T[::-1])
    ordered = corners[np.argsort(angle)]
    return np.roll(ordered, -int(np.argmin(ordered.sum(axis=1))), axis=0)
