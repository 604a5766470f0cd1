"""Which way up the module lies in the frames: all are turned alike, a quarter turn is told."""

from __future__ import annotations

from collections.abc import Collection

import cv2
import numpy as np
from numpy.typing import NDArray

from pv_inspect.detection.single_frame import Found
from pv_inspect.geometry.layout import ModuleLayout
from pv_inspect.geometry.pose import Pose
from pv_inspect.sequence.sequence import FrameSequence

__all__ = ["runs_down", "same_way_up"]

CONTINUITY = 0.1
"""Correlation of the cells' brightness that counts as much as half the turn between two frames."""
SAMPLES_PER_CELL = 4


def same_way_up(sequence: FrameSequence, layout: ModuleLayout, found: dict[int, Found]) -> None:
    """Turn the frames so that all show the same cells at the same places of the module.

    The outline looks the same turned by half a turn; the brightness of the cells does not. Where
    all cells look alike, the turn that continues the frame before decides.
    """
    turns = layout.turns
    known: NDArray[np.float32] | None = None
    direction = 0.0
    for index in sorted(found):
        pose, frame, share = found[index]
        picture = _coarse_picture(sequence.frame(index).image, layout, pose)
        if known is None:
            known, direction = picture, _direction(pose, layout)
            continue
        turned = {turn: pose.turned(layout.size, layout.size, turn) for turn in turns}
        scale = float(np.linalg.norm(known) * np.linalg.norm(picture)) + 1e-12
        score = {
            turn: float((known * np.rot90(picture, turn)).sum()) / scale
            + CONTINUITY * float(np.cos(_direction(turned[turn], layout) - direction))
            for turn in turns
        }
        turn = max(score, key=lambda key: score[key])
        known = known + np.rot90(picture, turn)
        direction = _direction(turned[turn], layout)
        if turn:
            found[index] = Found(turned[turn], frame.turned(layout, turn), share)


def runs_down(layout: ModuleLayout, poses: Collection[Pose]) -> bool:
    """Whether the rows of the module run down the frames in most poses.

    Parameters
    ----------
    layout : ModuleLayout
    poses : Pose
        At least one.
    """
    across = np.median([abs(np.cos(_direction(pose, layout))) for pose in poses])
    return bool(across < np.sqrt(0.5))


def _direction(pose: Pose, layout: ModuleLayout) -> float:
    """Angle of the module's x axis in the image."""
    height = layout.size[1] / 2
    ends = pose.project(np.array([[0.0, height], [layout.size[0], height]]))
    return float(np.arctan2(*(ends[1] - ends[0])[::-1]))


def _coarse_picture(
    image: NDArray[np.float32], layout: ModuleLayout, pose: Pose
) -> NDArray[np.float32]:
    """Brightness of parts of the cells against their surroundings, standard deviation 1."""
    shape = (SAMPLES_PER_CELL * layout.rows, SAMPLES_PER_CELL * layout.cols)
    inside = (np.arange(SAMPLES_PER_CELL) + 0.5) / SAMPLES_PER_CELL
    x, y = np.meshgrid(*layout.places_in_cells(inside, inside))
    points = np.column_stack([x.ravel(), y.ravel()])
    pixels = np.nan_to_num(pose.project(points), nan=-1e4).astype(np.float32).reshape(*shape, 2)
    smooth = cv2.GaussianBlur(image, (0, 0), 1.5)
    values = cv2.remap(
        smooth, pixels[..., 0], pixels[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    around = 3 * SAMPLES_PER_CELL
    values = values - cv2.blur(values, (around, around), borderType=cv2.BORDER_REPLICATE)
    return np.asarray(values / (values.std() + 1e-12), np.float32)
