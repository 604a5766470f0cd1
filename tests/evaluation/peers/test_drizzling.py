"""Drizzle with our geometry: brightness and place of what is dropped."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pv_inspect.common.work import result_of
from pv_inspect.evaluation.peers.drizzling import drizzled
from pv_inspect.geometry.grid import HrGrid
from pv_inspect.registration.registration import Registration
from tests.handmade import LAYOUT, made_registration

pytest.importorskip("drizzle", reason="drizzle is not installed: pip install 'pv-inspect[peers]'")


@dataclass(frozen=True)
class _Frame:
    image: NDArray[np.float32]
    valid: NDArray[np.bool_]


@dataclass(frozen=True)
class _Sequence:
    frames: tuple[_Frame, ...]
    shape: tuple[int, int] = (60, 80)

    def frame(self, index: int) -> _Frame:
        return self.frames[index]


@dataclass(frozen=True)
class _Case:
    sequence: _Sequence
    registration: Registration
    grid: HrGrid


def test_a_smooth_scene_comes_back_in_its_place() -> None:
    registration = made_registration()
    grid = HrGrid.covering(LAYOUT, registration.lr_px_per_unit, 2.0)
    y, x = np.mgrid[:60, :80].astype(np.float64)
    frames = []
    for i in range(3):
        at = registration.camera.unproject(registration.homographies[i], np.stack([x, y], axis=-1))
        scene = 0.5 + 0.1 * at[..., 0] - 0.05 * at[..., 1]
        image = registration.gain[i] * scene + registration.offset[i]
        frames.append(_Frame(image.astype(np.float32), np.ones((60, 80), bool)))
    case = _Case(_Sequence(tuple(frames)), registration, grid)
    image = result_of(drizzled(case))  # type: ignore[arg-type]
    row, col = np.mgrid[: grid.shape[0], : grid.shape[1]].astype(np.float64)
    module = grid.to_module(np.stack([col, row], axis=-1))
    expected = 0.5 + 0.1 * module[..., 0] - 0.05 * module[..., 1]
    inside = cv2.erode((image > 0).astype(np.uint8), np.ones((5, 5))) > 0
    assert inside.mean() > 0.5
    assert np.abs(image - expected)[inside].max() < 5e-3
