"""Pieces of one crack, joined where the image shows a dark line between them.

A crack that is faint in places leaves pieces in the map of a detector that lie on one line. The
band between the ends of two such pieces is straightened, and the path with the darkest line and
the highest probability is looked for in it [1]_. It is a link if it stands out from what the same
search finds beside it, and along its whole way: two cracks with a clean gap stay two.

References
----------
.. [1] A. Amini, T. Weymouth, R. Jain, "Using Dynamic Programming for Solving Variational Problems
       in Vision", IEEE Transactions on Pattern Analysis and Machine Intelligence 12, 1990.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from skimage.morphology import thin

__all__ = ["Link", "linked", "possible_links"]

Image = NDArray[np.float32]
Points = NDArray[np.float64]

# Steps of a cell width in which the band is sampled; lengths below are in these.
_STEPS = 256
# Pieces are longer; the direction of an end is that of its last part; gaps are shorter.
_LEAST_PIECE, _END, _LONGEST_GAP = 14, 20, 190
# Largest angle between the end of a piece and the line to the other one, cosine.
_ALONG = 0.87
_PIECES = 12
# A line is darker than both of its sides at this distance, along at least this length.
_SIDE, _SMOOTH = 3, 9
# Where else the search is done for comparison, steps to either side.
_BESIDE = (-27, -18, 18, 27)
# What the image must show, see `Link`; chosen by benchmarks/crack_links.py, docs/cracks.md.
_LEAST_EXCESS, _LEAST_DARK, _LEAST_LOG = 0.3, 0.8, -1.7
_WIDTH_CELLS = 0.01


@dataclass(frozen=True, eq=False)
class Link:
    """A way from the end of one piece to that of another one.

    Parameters
    ----------
    path : (n, 2) float64
        Row and column, pixels.
    pieces : tuple of int
        Labels of the two.
    gap : float
        Cell widths.
    dark : float
        How dark the line is, in deviations of what is found in the band; mean over its way.
    beside : float
        The same of the best path beside it.
    least : float
        The same as ``dark`` of the faintest quarter of the way.
    doubtful : float
        Decimal logarithm of the probability where it is lowest (its 15th percentile).
    """

    path: Points
    pieces: tuple[int, int]
    gap: float
    dark: float
    beside: float
    least: float
    doubtful: float

    @property
    def supported(self) -> bool:
        """Whether the image shows a line all the way, and the detector half sees it."""
        return (
            self.dark - self.beside >= _LEAST_EXCESS
            and self.least >= _LEAST_DARK
            and self.doubtful >= _LEAST_LOG
        )


def linked(probability: Image, tile: Image, threshold: float, cell_width_px: float) -> Image:
    """Join pieces of a crack where the image supports it.

    Parameters
    ----------
    probability : (h, w) float32
        Crack probability of the pixels of one cell.
    tile : (h, w) float32
        Its image, any brightness scale.
    threshold : float
        Pixels with at least this probability belong to pieces; links get this probability.
    cell_width_px : float

    Returns
    -------
    (h, w) float32
    """
    chosen = [
        link
        for link in possible_links(probability, tile, threshold, cell_width_px)
        if link.supported
    ]
    if not chosen:
        return probability
    group: dict[int, int] = {}

    def of(piece: int) -> int:
        while piece in group:
            piece = group[piece]
        return piece

    drawn = np.zeros(probability.shape, np.uint8)
    width = max(round(_WIDTH_CELLS * cell_width_px), 1)
    for link in sorted(chosen, key=lambda link: -link.least):
        a, b = (of(piece) for piece in link.pieces)
        if a != b:  # pieces that are joined already need no second way
            group[a] = b
            points = np.rint(link.path[:, ::-1]).astype(np.int32)
            cv2.polylines(drawn, [points], False, 1, width)
    value = np.maximum(probability, np.float32(max(threshold, 1e-6)))
    return np.where(drawn > 0, value, probability)


def possible_links(
    probability: Image, tile: Image, threshold: float, cell_width_px: float
) -> list[Link]:
    """Ways between pieces whose ends point at one another.

    Parameters
    ----------
    probability, tile : (h, w) float32
    threshold : float
    cell_width_px : float

    Returns
    -------
    list of Link
    """
    step = cell_width_px / _STEPS
    mask = (probability >= max(threshold, 1e-6)).astype(np.uint8)
    _, found, facts, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    labels = np.asarray(found, np.int32)
    extent = np.hypot(facts[:, cv2.CC_STAT_WIDTH], facts[:, cv2.CC_STAT_HEIGHT])
    extent[0] = 0
    long = [int(k) for k in np.argsort(-extent)[:_PIECES] if extent[k] >= _LEAST_PIECE * step]
    if len(long) < 2:
        return []
    pieces = np.isin(labels, long)
    ends = _ends(pieces, labels, _END * step)
    links = []
    for (a, way_a, k_a), (b, way_b, k_b) in combinations(ends, 2):
        gap = float(np.hypot(*(b - a))) / step
        if k_a == k_b or not 2 <= gap <= _LONGEST_GAP:
            continue
        along = (b - a) / (gap * step)
        turn = min(float(along @ way_a), float(-along @ way_b))
        if turn >= _ALONG:
            links.append(_link(probability, tile, (a, b), (k_a, k_b), step))
    return links


def _ends(
    pieces: NDArray[np.bool_], labels: NDArray[np.int32], reach: float
) -> list[tuple[Points, Points, int]]:
    """Ends of the centre lines of pieces: place (row, column), direction, label."""
    skeleton = np.asarray(thin(pieces), np.uint8)  # type: ignore[no-untyped-call]
    near = cv2.filter2D(skeleton, -1, np.ones((3, 3)), borderType=cv2.BORDER_CONSTANT)
    points = np.argwhere(skeleton)
    of = labels[tuple(points.T)]
    ends = []
    for end in np.argwhere((skeleton > 0) & (near == 2)):
        k = int(labels[tuple(end)])
        own = points[(of == k) & (np.hypot(*(points - end).T) <= reach)]
        way = end - own.mean(0)
        size = float(np.hypot(*way))
        if size > 0:
            ends.append((end.astype(np.float64), way / size, k))
    return ends


def _link(
    probability: Image,
    tile: Image,
    ends: tuple[Points, Points],
    pieces: tuple[int, int],
    step: float,
) -> Link:
    a, b = ends
    gap = float(np.hypot(*(b - a))) / step
    n = max(round(gap), 2) + 1
    along = (b - a) / (n - 1)
    across = np.array([-along[1], along[0]]) / np.hypot(*along) * step
    half = round(0.1 * gap) + 4
    reach = half + max(_BESIDE) + _SIDE
    offsets = np.arange(-reach, reach + 1)
    at = a + along * np.arange(n)[:, None, None] + across * offsets[None, :, None]
    image, said = _sampled(tile, at), _sampled(probability, at)
    ridge = np.minimum(image[:, : -2 * _SIDE], image[:, 2 * _SIDE :]) - image[:, _SIDE:-_SIDE]
    ridge = uniform_filter1d(ridge, min(_SMOOTH, n), axis=0, mode="nearest")
    middle = np.median(ridge)
    spread = 1.4826 * np.median(np.abs(ridge - middle)) + 1e-6 * max(float(image.max()), 1e-6)
    dark = np.clip((ridge - middle) / spread, -3, 6)
    logs = np.log10(np.clip(said[:, _SIDE:-_SIDE], 1e-4, 1))
    worth = dark + 2 * logs
    centre = worth.shape[1] // 2

    lows = [centre + shift - half for shift in (0, *_BESIDE)]
    paths = _best_paths(np.stack([worth[:, low : low + 2 * half + 1] for low in lows]))
    path, *others = paths + np.array(lows)[:, None]
    rows = np.arange(n)
    found = dark[rows, path]
    beside = max(float(dark[rows, other].mean()) for other in others)
    return Link(
        path=at[rows, path + _SIDE],
        pieces=pieces,
        gap=gap / _STEPS,
        dark=float(found.mean()),
        beside=beside,
        least=float(np.percentile(found, 25)),
        doubtful=float(np.percentile(uniform_filter1d(logs[rows, path], min(5, n)), 15)),
    )


def _best_paths(worth: Points) -> NDArray[np.intp]:
    """Columns of the path of most worth through the rows, from and to the middle column.

    ``worth`` is (n_paths, n_rows, n_columns), the result (n_paths, n_rows).
    """
    count, n, width = worth.shape
    # A column at either side that no path comes from.
    total = np.full((count, width + 2), -np.inf)
    total[:, 1 + width // 2] = worth[:, 0, width // 2]
    ways = np.empty((3, count, width))
    came = np.empty((n, count, width), np.intp)
    for k in range(1, n):
        # A step aside costs a little.
        np.subtract(total[:, :-2], 0.3, out=ways[0])
        ways[1] = total[:, 1:-1]
        np.subtract(total[:, 2:], 0.3, out=ways[2])
        came[k] = ways.argmax(0)
        np.add(ways.max(0), worth[:, k], out=total[:, 1:-1])
    every = np.arange(count)
    paths = np.empty((count, n), np.intp)
    paths[:, -1] = width // 2
    for k in range(n - 1, 0, -1):
        paths[:, k - 1] = paths[:, k] + came[k, every, paths[:, k]] - 1
    return paths


def _sampled(image: Image, at: Points) -> Points:
    points = np.asarray(at, np.float32)
    values = cv2.remap(
        np.asarray(image, np.float32),
        points[..., 1],
        points[..., 0],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.asarray(values, np.float64)
