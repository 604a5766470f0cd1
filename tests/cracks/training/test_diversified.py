from __future__ import annotations

import cv2
import numpy as np
import pytest

from pv_inspect.cracks.classes import BUSBAR, CLASSES, CRACK
from pv_inspect.cracks.network import CELL_PX
from pv_inspect.cracks.training.augmentation import Augmentation
from pv_inspect.cracks.training.diversified import (
    Diversity,
    busbars_run_along_rows,
    with_fingers,
    with_other_metal,
)

NOTHING = Diversity(0, 0, 0, 0, 0, 0)


def cell() -> tuple[np.ndarray, np.ndarray]:
    image = np.full((CELL_PX, CELL_PX), 0.7, np.float32)
    label = np.zeros((CELL_PX, CELL_PX), np.uint8)
    for row in (64, 192):
        image[row - 2 : row + 3], label[row - 2 : row + 3] = 0.2, BUSBAR
    cv2.line(image, (40, 80), (200, 170), 0.2, 3)
    cv2.line(label, (40, 80), (200, 170), CRACK, 3)
    return image, label


def test_without_any_share_nothing_changes() -> None:
    image, label = with_other_metal(*cell(), np.random.default_rng(0), NOTHING)
    assert np.array_equal(image, cell()[0])
    assert np.array_equal(label, cell()[1])


def test_other_busbars_take_the_place_of_the_own_ones() -> None:
    counts = set()
    for seed in range(30):
        rng = np.random.default_rng(seed)
        image, label = with_other_metal(*cell(), rng, Diversity(1, 0, 0, 0, 0, 0))
        rows = (label == BUSBAR).mean(1) > 0.5
        counts.add(int((np.diff(rows.astype(int), prepend=0) == 1).sum()))
        assert (label == CRACK).sum() > 0.5 * (cell()[1] == CRACK).sum()
        if not rows.any():  # the own ones are gone from the image as well
            assert image[64, :30].mean() > 0.6
    assert min(counts) == 0
    assert max(counts) >= 14


def test_interrupted_fingers_are_dark_bars_across_the_busbars_and_no_cracks() -> None:
    rng = np.random.default_rng(1)
    image, label = with_other_metal(*cell(), rng, Diversity(0, 0, 1, 0, 0, 0))
    assert np.array_equal(label, cell()[1])
    darker = image < cell()[0] - 0.02
    assert darker.any()
    boxes = cv2.connectedComponentsWithStats(darker.astype(np.uint8))[2][1:]
    assert all(box[cv2.CC_STAT_HEIGHT] >= 2 for box in boxes)
    assert max(box[cv2.CC_STAT_WIDTH] for box in boxes) < 0.25 * CELL_PX


@pytest.mark.parametrize("turned", [False, True])
def test_fingers_lie_across_the_busbars_only(turned: bool) -> None:
    image, label = cell()
    if turned:
        image, label = image.T.copy(), label.T.copy()
    assert busbars_run_along_rows(label) is not turned
    flat = np.full_like(image, 0.7)
    drawn = with_fingers(flat, label, np.random.default_rng(3))
    drawn = drawn.T if turned else drawn
    across, along = (np.abs(np.diff(drawn, axis=axis)).mean() for axis in (1, 0))
    assert across > 3 * along
    assert (drawn <= 0.7 + 1e-6).all()


def test_chips_are_dark_area_and_surrounds_are_background() -> None:
    rng = np.random.default_rng(2)
    image, label = with_other_metal(*cell(), rng, Diversity(0, 0, 0, 1, 0, 0))
    chip = label == CLASSES.index("dark")
    assert chip.any()
    assert image[chip].mean() < 0.4
    image, label = with_other_metal(*cell(), rng, Diversity(0, 0, 0, 0, 1, 0))
    outside = image < 0.25
    assert outside[:, 0].all() or outside[0].all() or outside[-1].all() or outside[:, -1].all()


@pytest.mark.parametrize("shape", [(256, 256), (128, 256), (85, 256), (256, 85)])
def test_parts_of_cells_of_other_makers_are_valid_inputs(shape: tuple[int, int]) -> None:
    image, label = (part[: shape[0], : shape[1]] for part in cell())
    augment = Augmentation(True, Diversity(1, 1, 1, 1, 1, 1))
    for seed in range(4):
        grey = np.ascontiguousarray(image * 255).astype(np.uint8)
        seen, classes = augment(grey, np.ascontiguousarray(label), np.random.default_rng(seed))
        assert seen.shape == classes.shape
        assert seen.dtype == np.float32
        assert np.isfinite(seen).all()
        assert classes.max() < len(CLASSES)
