"""Centre lines of crack masks: their branches and true lengths."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage.morphology import thin

__all__ = ["branches", "length_of", "skeleton_length"]

Mask = NDArray[np.bool_]
Chain = NDArray[np.float64]
_Pixel = tuple[int, int]

_ORTHOGONAL = ((0, 1), (1, 0), (0, -1), (-1, 0))
_DIAGONAL = ((1, 1), (1, -1), (-1, -1), (-1, 1))
# Moving averages over this many pixels, twice, take the steps out of a chain of pixels.
_WINDOW = 9
_PINHOLE_PX = 6
_MARCH_PX = 0.25


def skeleton_length(mask: Mask) -> float:
    """Length of the centre lines of a mask.

    Parameters
    ----------
    mask : (h, w) bool

    Returns
    -------
    float
        Pixels.
    """
    return sum(length_of(chain) for chain in branches(mask))


def branches(mask: Mask) -> list[Chain]:
    """Follow the centre lines of a mask from ends and junctions to the next.

    Parameters
    ----------
    mask : (h, w) bool

    Returns
    -------
    list of (n, 2) float64
        (row, column) of the points of each branch, smoothed: steps from pixel to pixel would make
        the length depend on the direction of the line. Twigs that are not longer than the line
        they grow from is wide are left out, as is the roughness of a mask.
    """
    rows, cols = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if not rows.size:
        return []
    # The radius of the line is its distance to the outside; what the edge of the image cuts
    # goes on beyond it.
    box = mask[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1].astype(np.uint8)
    pad = int(cv2.distanceTransform(np.pad(box, 1), cv2.DIST_L2, 5).max()) + 2
    ends = ((rows[0], mask.shape[0] - 1 - rows[-1]), (cols[0], mask.shape[1] - 1 - cols[-1]))
    near = np.array([[min(pad, int(n)) for n in side] for side in ends])
    wide = mask[
        rows[0] - near[0, 0] : rows[-1] + 1 + near[0, 1],
        cols[0] - near[1, 0] : cols[-1] + 1 + near[1, 1],
    ]
    lacking = pad - near
    wide = np.pad(wide, [tuple(side) for side in lacking], mode="edge")
    wide = _without_pinholes(wide)
    radius = np.asarray(cv2.distanceTransform(wide.astype(np.uint8), cv2.DIST_L2, 5), np.float32)
    # Guo and Hall's thinning keeps the ends of diagonal lines, Zhang and Suen's eats them.
    skeleton = thin(wide)  # type: ignore[no-untyped-call]
    inside = np.zeros(wide.shape, bool)
    h, w = wide.shape
    inside[lacking[0, 0] : h - lacking[0, 1], lacking[1, 0] : w - lacking[1, 1]] = True
    points = _without_twigs(skeleton & inside, radius)
    corner = np.array([rows[0], cols[0]], np.float64) - pad
    graph = _neighbours(points)
    chains = []
    paths = list(_paths(points))
    smooth = [_smooth(path) for path in paths]
    half_width = (wide & inside).sum() / (2 * max(sum(length_of(c) for c in smooth), 1.0))
    for path, chain in zip(paths, smooth, strict=True):
        if len(graph[path[-1]]) == 1:
            chain = _ended(chain, wide, inside, radius, half_width)
        if len(graph[path[0]]) == 1:
            chain = _ended(chain[::-1], wide, inside, radius, half_width)[::-1]
        chains.append(chain + corner)
    return chains


def length_of(chain: Chain) -> float:
    """Length of a chain of points (n, 2), pixels."""
    return float(np.hypot(*np.diff(chain, axis=0).T).sum())


def _without_pinholes(mask: Mask) -> Mask:
    """Mask with its smallest holes filled: each would become a ring."""
    _, labels, facts, _ = cv2.connectedComponentsWithStats((~mask).astype(np.uint8), connectivity=4)
    small = facts[labels, cv2.CC_STAT_AREA] <= _PINHOLE_PX
    return np.asarray(mask | (small & (labels > 0)))


def _without_twigs(skeleton: Mask, radius: NDArray[np.float32]) -> set[_Pixel]:
    """Pixels of a skeleton without branches that end within the width of what they grow from."""
    while True:
        points = {(int(y), int(x)) for y, x in np.argwhere(skeleton)}
        graph = _neighbours(points)
        twigs: set[_Pixel] = set()
        for path in _paths(points):
            first, last = len(graph[path[0]]), len(graph[path[-1]])
            if (first == 1) == (last == 1):  # a line by itself, or between junctions
                continue
            trunk = path[-1] if first == 1 else path[0]
            if len(path) <= 1.5 * float(radius[trunk]) + 1:
                twigs.update(p for p in path if len(graph[p]) <= 2)
        if not twigs:
            return points
        skeleton = skeleton.copy()
        skeleton[tuple(np.array(list(twigs)).T)] = False
        # Without its twig, a junction may be thicker than a line.
        skeleton = np.asarray(thin(skeleton))  # type: ignore[no-untyped-call]


def _ended(
    chain: Chain, mask: Mask, inside: Mask, radius: NDArray[np.float32], half_width: float
) -> Chain:
    """Chain whose last point lies half a line's width before the end of the mask.

    Thinning takes more or less away from the end of a line, which is as round as it is wide. What
    the edge of the image cuts has no end there.
    """
    reach = min(_WINDOW - 1, len(chain) - 1)
    way = chain[-1] - chain[-1 - reach]
    if reach < 3 or not way.any():
        return chain
    way = way / np.hypot(*way)
    ahead = chain[-1] + np.arange(0, 4 * radius.max() + 2, _MARCH_PX)[:, None] * way
    y, x = np.clip(np.rint(ahead).astype(int), 0, np.array(mask.shape) - 1).T
    n = int(np.argmin(mask[y, x] & inside[y, x]))
    if not inside[y[n], x[n]]:
        return np.vstack([chain, ahead[n : n + 1]])
    back = np.rint(chain[-1 - reach]).astype(int)
    # The distance transform makes thin lines thinner than they are, the area, which has the ends
    # and the rough edges in it, thicker: the mean of both.
    here = float(radius[back[0], back[1]])
    missing = n * _MARCH_PX - 0.5 * (min(max(half_width, here - 0.5), here) + here - 0.5)
    if missing > 0:
        return np.vstack([chain, chain[-1:] + missing * way])
    along = np.concatenate([[0.0], np.hypot(*np.diff(chain, axis=0).T).cumsum()])
    end = max(along[-1] + missing, 0.0)
    last = [np.interp(end, along, chain[:, k]) for k in (0, 1)]
    return np.vstack([chain[along < end], last])


def _smooth(path: list[_Pixel]) -> Chain:
    """Chain of pixels after moving averages that leave its ends where they are."""
    chain = np.array(path, np.float64)
    ring = len(path) > 2 and path[0] == path[-1]
    half = min(_WINDOW // 2, (len(chain) - 1) // 2)
    if half < 1:
        return chain
    kernel = np.full(2 * half + 1, 1.0 / (2 * half + 1))
    for _ in range(2):
        if ring:
            padded = np.pad(chain[:-1], ((half, half + 1), (0, 0)), mode="wrap")
        else:
            padded = np.pad(chain, ((half, half), (0, 0)), mode="reflect", reflect_type="odd")
        sums = [np.convolve(padded[:, k], kernel, mode="valid") for k in (0, 1)]
        chain = np.stack(sums, axis=1)
    return chain


def _neighbours(points: Iterable[_Pixel]) -> dict[_Pixel, list[_Pixel]]:
    """Graph of a skeleton; a diagonal step is left out where two orthogonal ones lead there."""
    graph: dict[_Pixel, list[_Pixel]] = {}
    points = set(points)
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
