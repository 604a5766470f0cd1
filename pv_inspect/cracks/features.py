"""What a person wants to know about the cracks of one cell, in numbers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage.morphology import thin

__all__ = ["CellFeatures", "crack_marks", "measure_cell", "skeleton_length"]

# A crack is long and slender, a cluster of dark grains is neither. Longer side of a mark's
# smallest rectangle in cell widths, and that side over the other one; a large mark may be a
# crack that branches and need not be slender.
MIN_EXTENT_CELLS = 0.15
MIN_SLENDERNESS = 2.0
_LARGE_EXTENT_CELLS = 0.25
# A cell that is dark in at least this share has no current through it: what looks like a crack in
# it is noise, or can't be told from noise.
_DARK_CELL_SHARE = 0.5
# The cell's edge belongs to the gap between cells, and thin dark lines are no dark area.
_BORDER_CELLS = 0.04
_DARK_MIN_WIDTH_CELLS = 0.05
_DARK_LEVEL = 0.5
# The score looks at as many pixels as a mark of this length and width has.
_SCORE_LENGTH_CELLS = 0.1
_SCORE_WIDTH_CELLS = 0.01

_ORTHOGONAL = ((0, 1), (1, 0), (0, -1), (-1, 0))
_DIAGONAL = ((1, 1), (1, -1), (-1, -1), (-1, 1))
_Pixel = tuple[int, int]


@dataclass(frozen=True)
class CellFeatures:
    """Crack features of one cell.

    Parameters
    ----------
    row, col : int
        Position in the module, from 0.
    crack_length_cells : float
        Length of all crack instances together along their centre lines, in cell widths.
    crack_instances : int
        Connected marks that are long and slender enough for a crack (`crack_marks`). 0 in a dark
        cell: nothing can be read from it.
    dark_area_share : float
        Share of the cell that emits less than half of what is usual in the module; thin lines
        (cracks, busbars) do not count.
    mean_intensity : float
        Mean of the tile, full scale = 1.
    crack_score : float
        In [0, 1]: mean probability of the most suspicious pixels, as many as a crack of a tenth
        of the cell's width has. It does not depend on the threshold.
    """

    row: int
    col: int
    crack_length_cells: float
    crack_instances: int
    dark_area_share: float
    mean_intensity: float
    crack_score: float

    @property
    def crack_suspected(self) -> bool:
        """Whether there is at least one mark that a crack could have made."""
        return self.crack_instances > 0

    @property
    def dark(self) -> bool:
        """Whether most of the cell is dark, so that its cracks are not judged."""
        return self.dark_area_share >= _DARK_CELL_SHARE


def crack_marks(
    probability: NDArray[np.float32], threshold: float, cell_width_px: float
) -> list[NDArray[np.bool_]]:
    """Find the marks of a cell that a crack could have made.

    Parameters
    ----------
    probability : (h, w) float32
        Crack probability of the pixels of one cell.
    threshold : float
        Pixels with at least this probability belong to marks.
    cell_width_px : float
        Pixels per cell width.

    Returns
    -------
    list of (h, w) bool
        8-connected; the smallest rectangle around each is at least 0.15 cell widths long, and
        twice as long as wide unless it is longer than 0.25.
    """
    mask = (probability >= max(threshold, 1e-6)).astype(np.uint8)
    n_labels, labels, boxes, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    marks = []
    for k in range(1, n_labels):
        x, y, width, height, _ = boxes[k]
        if np.hypot(width, height) < MIN_EXTENT_CELLS * cell_width_px:
            continue
        pixels = np.argwhere(labels[y : y + height, x : x + width] == k).astype(np.float32)
        # The rectangle goes through the centres of pixels, which reach half a pixel further.
        short, long = sorted(side + 1 for side in cv2.minAreaRect(pixels)[1])
        extent = long / cell_width_px
        slender = long >= MIN_SLENDERNESS * short or extent >= _LARGE_EXTENT_CELLS
        if extent >= MIN_EXTENT_CELLS and slender:
            marks.append(labels == k)
    return marks


def measure_cell(
    tile: NDArray[np.float32],
    probability: NDArray[np.float32],
    threshold: float,
    *,
    row: int,
    col: int,
    cell_width_px: float,
    usual_intensity: float,
) -> CellFeatures:
    """Measure the cracks of one cell.

    Parameters
    ----------
    tile, probability : (h, w) float32
        Image of the cell and crack probability of its pixels.
    threshold : float
        Pixels with at least this probability count as crack.
    row, col : int
        Position of the cell in the module.
    cell_width_px : float
        Pixels per cell width.
    usual_intensity : float
        Median intensity of the module, in the units of ``tile``.

    Returns
    -------
    CellFeatures
    """
    dark_share = _dark_share(tile, usual_intensity, cell_width_px)
    readable = dark_share < _DARK_CELL_SHARE
    marks = crack_marks(probability, threshold, cell_width_px) if readable else []
    n_score = round(_SCORE_LENGTH_CELLS * _SCORE_WIDTH_CELLS * cell_width_px**2)
    n_score = min(max(n_score, 1), probability.size)
    highest = np.partition(probability, probability.size - n_score, axis=None)[-n_score:]
    return CellFeatures(
        row=row,
        col=col,
        crack_length_cells=float(sum(skeleton_length(mark) for mark in marks) / cell_width_px),
        crack_instances=len(marks),
        dark_area_share=dark_share,
        mean_intensity=float(tile.mean(dtype=np.float64)),
        crack_score=float(highest.mean(dtype=np.float64)),
    )


def skeleton_length(mask: NDArray[np.bool_]) -> float:
    """Length of the centre lines of a mask.

    Parameters
    ----------
    mask : (h, w) bool

    Returns
    -------
    float
        Pixels. Branches are followed from end to end and smoothed before they are measured:
        counting pixels or steps would make the length depend on the direction of the line.
    """
    rows, cols = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if not rows.size:
        return 0.0
    box = mask[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    # Guo and Hall's thinning keeps the ends of diagonal lines, Zhang and Suen's eats them.
    skeleton = thin(np.pad(box, 1))  # type: ignore[no-untyped-call]
    points = {(int(y), int(x)) for y, x in np.argwhere(skeleton)}
    return sum(_smooth_length(path) for path in _paths(points))


def _smooth_length(path: list[_Pixel], window: int = 9) -> float:
    """Length of a chain of pixels after a moving average that leaves its ends where they are."""
    chain = np.array(path, np.float64)
    half = min(window // 2, (len(chain) - 1) // 2)
    if half > 0 and path[0] != path[-1]:
        padded = np.pad(chain, ((half, half), (0, 0)), mode="reflect", reflect_type="odd")
    elif half > 0:  # a ring
        padded = np.pad(chain[:-1], ((half, half + 1), (0, 0)), mode="wrap")
    else:
        padded = chain
    kernel = np.full(2 * half + 1, 1.0 / (2 * half + 1))
    smooth = np.stack([np.convolve(padded[:, k], kernel, mode="valid") for k in (0, 1)], axis=1)
    return float(np.hypot(*np.diff(smooth, axis=0).T).sum())


def _neighbours(points: set[_Pixel]) -> dict[_Pixel, list[_Pixel]]:
    """Graph of a skeleton; a diagonal step is left out where two orthogonal ones lead there."""
    graph: dict[_Pixel, list[_Pixel]] = {}
    for y, x in points:
        near = [(y + dy, x + dx) for dy, dx in _ORTHOGONAL if (y + dy, x + dx) in points]
        near += [
            (y + dy, x + dx)
            for dy, dx in _DIAGONAL
            if (y + dy, x + dx) in points
            and (y + dy, x) not in points
            and (y, x + dx) not in points
        ]
        graph[y, x] = near
    return graph


def _paths(points: set[_Pixel]) -> Iterator[list[_Pixel]]:
    """Chains of pixels between ends and junctions, then closed rings; every link occurs once."""
    graph = _neighbours(points)
    seen: set[frozenset[_Pixel]] = set()
    nodes = [p for p, near in graph.items() if len(near) != 2]
    for start in [*nodes, *(p for p, near in graph.items() if len(near) == 2)]:
        for step in graph[start]:
            if frozenset((start, step)) in seen:
                continue
            path = [start, step]
            seen.add(frozenset((start, step)))
            while path[-1] != start and len(graph[path[-1]]) == 2:
                here = path[-1]
                following = next(p for p in graph[here] if p != path[-2])
                seen.add(frozenset((here, following)))
                path.append(following)
            yield path


def _dark_share(tile: NDArray[np.float32], usual: float, cell_width_px: float) -> float:
    border = max(round(_BORDER_CELLS * cell_width_px), 1)
    inside = tile[border:-border, border:-border]
    if not inside.size:
        return 0.0
    dark = (inside < _DARK_LEVEL * usual).astype(np.uint8)
    size = 2 * (round(_DARK_MIN_WIDTH_CELLS * cell_width_px) // 2) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    return float(cv2.morphologyEx(dark, cv2.MORPH_OPEN, disc).mean())
