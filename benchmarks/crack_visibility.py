"""How wide and how dark the cracks of a scene are: what a frame could show of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.cracks.centreline import branches

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Reach of the profiles across a crack, and how far the darkest line may lie beside the drawn one,
# both relative to the width of a cell; pieces of this length share a profile.
_REACH, _BESIDE, _PIECE = 0.035, 0.012, 0.04
WIDTHS = (0.0, 0.6, 0.9, 1.3, np.inf)
CONTRASTS = (0.0, 0.1, 0.2, 0.4, np.inf)


@dataclass(frozen=True, eq=False)
class Pieces:
    """Pieces of the cracks of a scene.

    Parameters
    ----------
    length_px, width_px, contrast : (n,) float64
        Equivalent width: area of the dark profile over its depth. Contrast: the depth over the
        brightness beside the crack.
    at : tuple of n (k, 2) int
        (row, column) of the points of each piece.
    """

    length_px: NDArray[np.float64]
    width_px: NDArray[np.float64]
    contrast: NDArray[np.float64]
    at: tuple[NDArray[np.intp], ...]

    def found(self, probability: Image, threshold: float, tolerance_px: int) -> NDArray[np.float64]:
        """Share of the points of each piece that have a mark within a tolerance."""
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * tolerance_px + 1,) * 2)
        near = cv2.dilate((probability >= threshold).astype(np.uint8), disc) > 0
        return np.array([near[points[:, 0], points[:, 1]].mean() for points in self.at])


def pieces(image: Image, mask: Mask, cell_px: float) -> Pieces:
    """Cut the cracks of a sharp image into short pieces and measure each.

    Parameters
    ----------
    image : (h, w) float32
    mask : (h, w) bool
        Labelled cracks.
    cell_px : float
        Width of a cell.
    """
    found = [
        (length, *seen, at)
        for chain in branches(mask)
        for length, at, seen in _measured(image, chain, cell_px)
    ]
    columns = zip(*found, strict=True) if found else ((), (), (), ())
    length, width, contrast, at = columns
    return Pieces(np.array(length), np.array(width), np.array(contrast), tuple(at))


def _measured(
    image: Image, chain: NDArray[np.float64], cell_px: float
) -> Iterator[tuple[float, NDArray[np.intp], tuple[float, float]]]:
    steps = np.hypot(*np.diff(chain, axis=0).T)
    along = np.concatenate([[0.0], steps.cumsum()])
    total = along[-1]
    if total < 4:
        return
    s = np.arange(0, total, 1.0)
    points = np.stack([np.interp(s, along, chain[:, k]) for k in (0, 1)], axis=1)
    way = np.gradient(points, axis=0)
    way /= np.maximum(np.hypot(*way.T), 1e-9)[:, None]
    across = np.arange(-round(_REACH * cell_px), round(_REACH * cell_px) + 0.25, 0.5)
    y = points[:, :1] - across * way[:, 1:]
    x = points[:, 1:] + across * way[:, :1]
    profiles = cv2.remap(
        image,
        x.astype(np.float32),
        y.astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    smooth = cv2.blur(profiles, (3, 5))
    near = np.abs(across) <= _BESIDE * cell_px
    first = int(np.flatnonzero(near)[0])
    shift = first + smooth[:, near].argmin(1) - len(across) // 2
    n_piece = max(round(_PIECE * cell_px), 4)
    for part in np.array_split(np.arange(len(s)), max(round(len(s) / n_piece), 1)):
        profile = np.mean([np.roll(profiles[k], -shift[k]) for k in part], axis=0)
        beside = np.abs(across) > 0.5 * _REACH * cell_px
        bright = float(np.median(profile[beside]))
        dark = np.maximum(1 - profile[~beside] / max(bright, 1e-9), 0)
        depth = float(dark[len(dark) // 2 - 1 : len(dark) // 2 + 2].mean())
        width = float(dark.sum() * 0.5 / max(depth, 0.01))
        at = np.clip(np.rint(points[part]).astype(int), 0, np.array(image.shape) - 1)
        yield total * len(part) / len(s), at, (width, depth)


def lines_of(
    name: str, scene: Pieces, found: dict[str, NDArray[np.float64]], lr_px: float
) -> Iterator[str]:
    """Yield lines: share of the crack length by width and contrast, and how much of it is found.

    Parameters
    ----------
    name : str
    scene : Pieces
    found : dict of str to (n,) float64
        Share of each piece that was found in each image.
    lr_px : float
        Pixels of the scene per LR pixel.
    """
    total = scene.length_px.sum()
    for what, values, edges, unit in (
        ("width", scene.width_px / lr_px, WIDTHS, "LR px"),
        ("contrast", scene.contrast, CONTRASTS, ""),
    ):
        for low, high in pairwise(edges):
            inside = (values >= low) & (values < high)
            weight = scene.length_px * inside
            span = f"{low:g} to {high:g} {unit}" if np.isfinite(high) else f"over {low:g} {unit}"
            line = f"{name:<8}{what:<10}{span:<18}{weight.sum() / total:7.2f}"
            if weight.sum() < 0.005 * total:
                yield line
                continue
            shares = (float((share * weight).sum() / weight.sum()) for share in found.values())
            yield line + "".join(f"{share:9.2f}" for share in shares)
