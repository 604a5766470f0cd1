"""Where the module image lies beside the frames: to their right, at the same scale."""

from __future__ import annotations

from dataclasses import dataclass

from napari_pv_inspect.coordinates import to_world
from pv_inspect.geometry.grid import HrGrid

__all__ = ["Placement", "cell_box", "module_placement"]

# Gap between frame and module image, in parts of the frame's width.
GAP = 0.06


@dataclass(frozen=True)
class Placement:
    """Affine place of a 2D image in the world of the frames (LR pixels), (row, col)."""

    scale: tuple[float, float]
    translate: tuple[float, float]

    def box(self, shape: tuple[int, int]) -> tuple[float, float, float, float]:
        """Return (top, left, height, width) in the world of an image of this shape, pixels."""
        height, width = shape[0] * self.scale[0], shape[1] * self.scale[1]
        return (*self.translate, height, width)

    def to_world(self, rows_cols: tuple[float, float]) -> tuple[float, float]:
        """Image coordinates (row, col) to world coordinates."""
        row, col = (
            t + s * v for t, s, v in zip(self.translate, self.scale, rows_cols, strict=True)
        )
        return row, col


def module_placement(
    grid: HrGrid, shape: tuple[int, int], frame_shape: tuple[int, int] | None
) -> Placement:
    """Place a module image of ``shape`` px, which covers ``grid``, right of the frames.

    An early preview may be coarser than the grid: it is stretched to the same place.
    Without frames the image lies at the origin.
    """
    pitch = 1.0 / grid.magnification
    scale = (pitch * grid.shape[0] / shape[0], pitch * grid.shape[1] / shape[1])
    if frame_shape is None:
        return Placement(scale, (0.0, 0.0))
    height, width = frame_shape
    top = (height - grid.shape[0] * pitch) / 2
    return Placement(scale, (top, width * (1 + GAP)))


def cell_box(grid: HrGrid, placement: Placement, row: int, col: int) -> tuple[float, ...]:
    """Centre (row, col) and size (height, width) of one cell in world coordinates."""
    corners = grid.to_pixels(grid.layout.cell_corners(row, col))
    px, py = corners[2] - corners[0]
    top, left = to_world(corners[:1])[0]
    centre = placement.to_world((top + py / 2, left + px / 2))
    return (*centre, py * placement.scale[0], px * placement.scale[1])
