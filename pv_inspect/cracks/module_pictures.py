"""Pictures of whole modules where pictures of cells are expected."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.detection.layout_guess import layouts_in
from pv_inspect.geometry.layout import ModuleLayout

__all__ = ["module_in"]

Image = NDArray[np.float32]

# Chosen on 44 cells of PV-Vision (train), 132 of ELPV, and 24 simulated modules of 1 x 6 to 12 x 20
# cells, 320 to 1024 px wide: all modules score 0.17 or more, all cells but one under 0.02 (that one
# shows 2 x 2). Checked afterwards on 86 cells of PV-Vision (val): none is taken for a module.
_LEAST_SCORE = 0.1
# One line across may be a crack or the only busbar: smaller modules are not told from cells.
_LEAST_CELLS = 3
# Whole and halved cells; busbars and fingers make rectangles that are longer.
_CELL_ASPECTS = (0.4, 2.5)
_SIDE_PX, _LINES_PX = 480, 320
_MARGIN = 0.06
# A line is this much darker than what lies beside it, at these distances, and this share of the
# picture long. Of the cells four in five have no two such lines both ways, and are done with; so
# is one module of twelve, with cells of 12 px.
_LINE_DEPTH, _BESIDE_PX, _LINE_SHARE, _LEAST_LINES = 0.06, (2, 4), 0.2, 2


def module_in(image: Image) -> ModuleLayout | None:
    """Layout of the module that a picture seems to show; None if it may well be a cell.

    Busbars and fingers are lines as well, but their crossings make no even grid of cells that are
    about as wide as high. Modules of one or two rows or columns are not recognised.

    Parameters
    ----------
    image : (h, w) float32
    """
    image = image / max(float(np.percentile(image, 99)), 1e-6)
    if not _has_lines(_shrunk(image, _LINES_PX)):
        return None
    small = _shrunk(image, _SIDE_PX)
    return _clear_layout(small) or _clear_layout(_framed(small))


def _framed(image: Image) -> Image:
    """Give what was cut at the edges of a module a dark surrounding to stand out from."""
    sides = (max(round(_MARGIN * max(image.shape)), 4),) * 4
    dark = 0.3 * max(float(np.percentile(image, 1)), 0.0)
    framed = cv2.copyMakeBorder(image, *sides, cv2.BORDER_CONSTANT, value=dark)
    return np.asarray(framed, np.float32)


def _clear_layout(image: Image) -> ModuleLayout | None:
    low, high = _CELL_ASPECTS
    for layout, score in layouts_in(image):
        few = min(layout.rows, layout.cols) < _LEAST_CELLS
        if score >= _LEAST_SCORE and low <= layout.cell_aspect <= high and not few:
            return layout
    return None


def _shrunk(image: Image, side_px: int) -> Image:
    scale = side_px / max(image.shape)
    if scale >= 1:
        return np.asarray(image, np.float32)
    size = max(round(scale * image.shape[1]), 1), max(round(scale * image.shape[0]), 1)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)


def _has_lines(image: Image) -> bool:
    """Whether there are long dark lines both ways."""
    return all(_n_upright_lines(view) >= _LEAST_LINES for view in (image, image.T))


def _n_upright_lines(image: Image) -> int:
    smooth = cv2.blur(np.ascontiguousarray(image), (1, 3))
    depth = np.zeros_like(smooth)
    for step in _BESIDE_PX:
        padded = cv2.copyMakeBorder(smooth, 0, 0, step, step, cv2.BORDER_REPLICATE)
        beside = np.minimum(padded[:, : -2 * step], padded[:, 2 * step :])
        depth = np.maximum(depth, 1 - smooth / np.maximum(beside, 1e-3))
    lines = (depth > _LINE_DEPTH).astype(np.uint8)
    boxes = cv2.connectedComponentsWithStats(lines, connectivity=8)[2][1:]
    return int((boxes[:, cv2.CC_STAT_HEIGHT] >= _LINE_SHARE * image.shape[0]).sum())
