"""Crossing points of the central module on field photographs, against their truth.

    python benchmarks/field.py FOLDER [--guess]

FOLDER holds photographs and a ``truth.json`` with rows, cols and crossings_px of every one. Each
photograph is detected on its own, as a sequence of one frame; with ``--guess`` without being told
the rows and columns.

The labels themselves are not good to the bar everywhere: their outer points were moved onto the
ends of the cells. What they are worth is printed as well: how far the labels' outer lines lie from
the grid of the labels' own inner points, and the found outer lines from that of the found inner
points. A grid is a plane seen through a lens with one, or two, radial coefficients, which are
common to all photographs. Neither is needed for the last table: there the outer line is where the
brightness of the outer cells falls to its half, and half a gap further. A profile across it is a
mean over the middle three fifths of a cell; the gap is as wide as the light that is missing
between the next cells would be if it were black. On the right of field_04, 06, 08 and 10, where
all differences of more than a pixel are, the labels lie 0.8 to 1.4 px outside of it, the found
lines 0.3 to 0.5 px inside. On the left both lie 0.1 to 0.3 px inside but for field_04 and 12,
which have dark cells there. So nothing of the detection was changed for these labels.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from time import process_time
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.optimize import least_squares

from pv_inspect.detection.detect import detect
from pv_inspect.detection.layout_guess import guess_layout
from pv_inspect.errors import InspectionError
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.progress.follow import follow
from pv_inspect.sequence.sequence import FrameSequence

MUST_PX = 1.5
RADIUS_PX = 600.0
"""Unit of radii in the lens model, that of the labels."""

Array = NDArray[np.float64]


class Points(NamedTuple):
    """Labelled and found crossing points of one photograph, (n, 2) px."""

    name: str
    layout: ModuleLayout
    true: Array
    found: Array
    measured: NDArray[np.bool_]


def main() -> None:
    """Print the error per photograph, and how many are good."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--guess", action="store_true", help="do not tell the rows and columns")
    arguments = parser.parse_args()
    truth = json.loads((arguments.folder / "truth.json").read_text(encoding="utf-8"))
    photos = truth["images"]
    pairs = [_report(arguments.folder, photo, arguments.guess) for photo in photos]
    read = [points for points in pairs if points is not None]
    good = sum(_errors(points).max() <= MUST_PX for points in read)
    print(f"all crossings within {MUST_PX:g} px: {good} of {len(photos)}")
    if read:
        _report_labels(read, tuple(truth["image_size"]))
        _report_edges(read, arguments.folder)


def _report(folder: Path, photo: dict[str, Any], guess: bool) -> Points | None:
    begun = process_time()
    try:
        sequence = FrameSequence.open([folder / photo["file"]])
        layout = ModuleLayout(photo["rows"], photo["cols"])
        if guess:
            layout = guess_layout(sequence).layout
        frame = follow(detect(sequence, layout), "detecting", quiet=True).frames[0]
    except InspectionError as error:
        print(f"{photo['file']}  not found: {error}")
        return None
    seconds = process_time() - begun
    true = np.array(photo["crossings_px"])
    name = f"{photo['file']}  {layout.rows} x {layout.cols}"
    if len(true) != len(frame.points_px):
        print(f"{name}  wrong rows and columns, {photo['rows']} x {photo['cols']} in truth")
        return None
    # The module looks the same turned by half a turn.
    points = min(
        (
            Points(photo["file"], layout, true, frame.points_px[::way], frame.measured[::way])
            for way in (1, -1)
        ),
        key=lambda one: float(_errors(one).max()),
    )
    error = _errors(points)
    print(
        f"{name}  median {np.median(error):.3f}  max {error.max():.3f} px"
        f"  measured {frame.measured.mean():.0%}  {seconds:.2f} s"
    )
    return points


def _errors(points: Points) -> Array:
    return np.asarray(np.linalg.norm(points.found - points.true, axis=1))


def _report_labels(photos: list[Points], size: tuple[int, int]) -> None:
    """Print how far outer points lie from the grid of the inner ones, labelled and found."""
    print("\nmedian distance of the outer lines from the grid of the inner points, px")
    print(
        "photograph     side    labels (1 coeff.)   found (1)   labels from found (2)   found (2)"
    )
    one = _grids(photos, size, 1, "found")
    own = _grids(photos, size, 1, "true")
    two = _grids(photos, size, 2, "found")
    for k, points in enumerate(photos):
        for side, line, axis in _sides(points.layout):
            values = [
                np.median((of - grid)[line, axis])
                for of, grid in (
                    (points.true, own[k]),
                    (points.found, one[k]),
                    (points.true, two[k]),
                    (points.found, two[k]),
                )
            ]
            print(
                f"{points.name:14s} {side:6s}"
                + "".join(f"{v:{w}.2f}" for v, w in zip(values, (15, 15, 18, 16), strict=True))
            )


def _report_edges(photos: list[Points], folder: Path) -> None:
    """Print how far labels and found outer lines lie outside of the edges of the cells."""
    print("\nleft and right lines outside of where the cells and half a gap end, median, px")
    print("photograph     side    half a gap   labels    found")
    for points in photos:
        image = np.asarray(cv2.imread(str(folder / points.name), cv2.IMREAD_GRAYSCALE), float)
        shape = (points.layout.rows + 1, points.layout.cols + 1, 2)
        for side, way in (("left", -1), ("right", 1)):
            true, found = (p.reshape(shape)[:, ::way] for p in (points.true, points.found))
            half = np.median([_missing(image, found, k) for k in range(-5, -1)]) / 2
            outside = [_outside(image, found, of) - half for of in (true, found)]
            labels, ours = (float(np.median(of)) for of in outside)
            print(f"{points.name:14s} {side:6s}{half:12.2f}{labels:9.2f}{ours:9.2f}")


def _profiles(image: Array, grid: Array, line: int, along_px: Array) -> Array:
    """Brightness across a line of the grid, a mean over each cell's middle: (n cells, n px)."""
    middle = (grid[1:] + grid[:-1]) / 2
    way = middle[:, line] - middle[:, line - 1]
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    side = grid[1:, line] - grid[:-1, line]
    beside = np.linspace(-0.3, 0.3, 31)[:, None] * side[:, None, None]
    at = middle[:, line, None, None] + along_px[:, None, None] * way[:, None, None] + beside
    values = map_coordinates(image, np.moveaxis(at[..., ::-1], -1, 0), order=3, mode="nearest")
    return np.asarray(values.mean(-1))


def _missing(image: Array, grid: Array, line: int) -> float:
    """Width of the gap at an inner line if it were black: what the profile lacks of its sides."""
    along = np.arange(-8, 8.01, 0.1)
    near = np.abs(along) < 3.5
    widths = []
    for profile in _profiles(image, grid, line, along):
        left, right = np.median(profile[along < -3.5]), np.median(profile[along > 3.5])
        beside = left + (right - left) * (along + 8) / 16
        widths.append(float((1 - profile / beside)[near].sum() * 0.1))
    return float(np.median(widths))


def _outside(image: Array, grid: Array, line: Array) -> Array:
    """How far the outer line of a grid lies outside of the half brightness of its cells, px."""
    along = np.arange(-12, 4.01, 0.1)
    middle = (grid[1:] + grid[:-1]) / 2
    way = middle[:, -1] - middle[:, -2]
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    shift = (((line[1:, -1] + line[:-1, -1]) / 2 - middle[:, -1]) * way).sum(1)
    edges = []
    for profile in _profiles(image, grid, -1, along):
        inside = np.median(profile[along < -3.5])
        edges.append(float(along[np.flatnonzero(profile > inside / 2)[-1]]))
    return np.asarray(shift - np.array(edges))


def _sides(layout: ModuleLayout) -> list[tuple[str, NDArray[np.bool_], int]]:
    row, col = np.divmod(np.arange(layout.n_crossings), layout.cols + 1)
    return [
        ("left", col == 0, 0),
        ("right", col == layout.cols, 0),
        ("top", row == 0, 1),
        ("bottom", row == layout.rows, 1),
    ]


def _grids(
    photos: list[Points], size: tuple[int, int], coefficients: int, which: str
) -> list[Array]:
    """Fit poses and one common lens to the inner points; return all points of each grid."""
    centre = (np.array(size) - 1) / 2
    inner = [
        ~np.any([line for _, line, _ in _sides(p.layout)], axis=0)
        & (p.measured if which == "found" else True)
        for p in photos
    ]
    planes = [p.layout.crossings() / p.layout.cols - 0.5 for p in photos]
    points = [getattr(p, which) for p in photos]
    starts = [
        cv2.findHomography(plane[use], (seen[use] - centre) / RADIUS_PX)[0].ravel()[:8]
        for plane, seen, use in zip(planes, points, inner, strict=True)
    ]

    def grid(pose: Array, lens: Array, plane: Array) -> Array:
        rays = np.column_stack([plane, np.ones(len(plane))]) @ np.append(pose, 1).reshape(3, 3).T
        rays = rays[:, :2] / rays[:, 2:]
        radius = np.square(rays).sum(axis=1)
        bend = 1 + sum(c * radius ** (k + 1) for k, c in enumerate(lens))
        return np.asarray(centre + RADIUS_PX * rays * bend[:, None])

    def grids(parameters: Array) -> list[Array]:
        poses = parameters[coefficients:].reshape(-1, 8)
        return [
            grid(pose, parameters[:coefficients], plane)
            for pose, plane in zip(poses, planes, strict=True)
        ]

    def residuals(parameters: Array) -> Array:
        triples = zip(grids(parameters), points, inner, strict=True)
        return np.concatenate([(there - seen)[use].ravel() for there, seen, use in triples])

    start = np.concatenate([np.zeros(coefficients), *starts])
    fit = least_squares(residuals, start, loss="soft_l1", f_scale=0.3, x_scale="jac")
    return grids(fit.x)


if __name__ == "__main__":
    main()
