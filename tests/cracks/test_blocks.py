from __future__ import annotations

import cv2
import numpy as np
import pytest

from pv_inspect.cracks.blocks import cut_off_blocks, with_block_edges
from pv_inspect.cracks.completion import completed
from pv_inspect.cracks.features import CellFeatures, OperatingPoint, measure_cell

SIDE = 200


def cell(seed: int = 0, noise: float = 0.01) -> np.ndarray:
    """A cell with two busbars, a dark rim and grain."""
    rng = np.random.default_rng(seed)
    grain = cv2.GaussianBlur(rng.standard_normal((SIDE, SIDE)).astype(np.float32), (0, 0), 4)
    image = 0.6 + 0.4 * grain
    image[60:64] *= 0.2
    image[136:140] *= 0.2
    image[:3] *= 0.1
    image[:, -3:] *= 0.1
    return np.asarray(image + rng.normal(0, noise, image.shape), np.float32)


def with_part(image: np.ndarray, points: list[tuple[int, int]], level: float = 0.15) -> np.ndarray:
    mask = np.zeros(image.shape, np.uint8)
    cv2.fillPoly(mask, [np.array(points, np.int32)], 1)
    soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 1.0)
    return np.asarray(image * (1 - (1 - level) * soft), np.float32)


PARTS = {
    "corner": [(-9, -9), (80, -9), (-9, 60)],
    "strip along a busbar": [(-9, 140), (209, 140), (209, 209), (-9, 209)],
    "between two cracks": [(90, -9), (150, -9), (140, 60), (70, 60)],
    "not at the border": [(70, 66), (140, 66), (120, 134), (60, 134)],
}


@pytest.mark.parametrize("points", PARTS.values(), ids=PARTS)
@pytest.mark.parametrize("side", [60, SIDE])
def test_a_dark_part_with_a_straight_sharp_edge_is_cut_off(
    points: list[tuple[int, int]], side: int
) -> None:
    tile = cv2.resize(with_part(cell(), points), (side, side), interpolation=cv2.INTER_AREA)
    mask = np.zeros((SIDE, SIDE), np.uint8)
    cv2.fillPoly(mask, [np.array(points, np.int32)], 1)
    truth = cv2.resize(mask, (side, side), interpolation=cv2.INTER_NEAREST) > 0
    found = cut_off_blocks(tile)
    assert (found & truth).sum() > 0.7 * (found | truth).sum()


def _corners() -> np.ndarray:
    image = cell()
    for points in (
        [(-9, -9), (40, -9), (-9, 40)],
        [(209, -9), (160, -9), (209, 40)],
        [(-9, 209), (40, 209), (-9, 160)],
        [(209, 209), (160, 209), (209, 160)],
    ):
        image = with_part(image, points)
    return image


def _unequal_corners() -> np.ndarray:
    image = with_part(cell(), [(-9, -9), (46, -9), (-9, 46)])
    for points in ([(209, -9), (174, -9), (209, 26)], [(-9, 209), (26, 209), (-9, 174)]):
        image = with_part(image, points)
    return image


def _surround() -> np.ndarray:
    image = np.full((SIDE, SIDE), 0.05, np.float32)
    image[12:190, 16:186] = cv2.resize(cell(), (170, 178), interpolation=cv2.INTER_AREA)
    return image


def _fingers() -> np.ndarray:
    image = cell()
    image[64:136, 80:84] *= 0.2
    image[140:, 120:123] *= 0.2
    return image


def _gradient() -> np.ndarray:
    return np.asarray(cell() * (1 - 0.95 * np.exp(-np.arange(SIDE) / 40))[None], np.float32)


def _grain() -> np.ndarray:
    rng = np.random.default_rng(3)
    rough = cv2.GaussianBlur(rng.standard_normal((SIDE, SIDE)).astype(np.float32), (0, 0), 7)
    return np.asarray(cell() * np.where(rough / rough.std() > 1, 0.45, 1), np.float32)


OTHERS = {
    "a clean cell": cell(),
    "cut corners": _corners(),
    "unequal corners": _unequal_corners(),
    "two of them, half a cell": _corners()[: SIDE // 2],
    "a dark surround": _surround(),
    "interrupted fingers": _fingers(),
    "a soft gradient": _gradient(),
    "dark grain": _grain(),
    "a dark cell": cell() * np.float32(0.05),
    "noise without light": np.random.default_rng(0).random((SIDE, SIDE), np.float32) * 0.01,
    "nothing": np.zeros((SIDE, SIDE), np.float32),
    "a greyish part": with_part(cell(), PARTS["corner"], 0.6),
}


@pytest.mark.parametrize("tile", OTHERS.values(), ids=OTHERS)
def test_what_else_is_dark_is_not_cut_off(tile: np.ndarray) -> None:
    assert not cut_off_blocks(np.ascontiguousarray(tile)).any()


def test_a_corner_that_broke_off_more_than_the_others_were_cut_is_found() -> None:
    found = cut_off_blocks(with_part(_corners(), PARTS["corner"]))
    assert 0.04 < found.mean() < 0.09


def measured(tile: np.ndarray, probability: np.ndarray) -> CellFeatures:
    return measure_cell(
        tile,
        probability,
        0.3,
        row=0,
        col=0,
        cell_width_px=SIDE,
        usual_intensity=0.6,
        least_extent_cells=0.02,
        least_length_cells=0.03,
        least_score=0.6,
    )


def test_a_cut_off_part_is_class_c_though_the_detector_sees_no_crack() -> None:
    tile = with_part(cell(), PARTS["corner"])
    nothing = np.zeros(tile.shape, np.float32)
    marked = with_block_edges(nothing, cut_off_blocks(tile), 0.3, SIDE)
    features = measured(tile, marked)
    assert features.crack_class == "C"
    assert features.crack_suspected
    assert features.crack_length_cells == pytest.approx(np.hypot(71, 53) / SIDE, rel=0.25)
    assert features.cut_off_share == pytest.approx(0.055, abs=0.015)
    # The detector's answer itself stays what it was.
    assert features.crack_score <= 0.3 + 1e-6
    assert measured(cell(), nothing).crack_class == "none"


def test_the_edge_is_not_marked_in_a_cell_with_marks() -> None:
    tile = with_part(cell(), PARTS["corner"])
    marks = np.zeros((SIDE, SIDE), np.uint8)
    cv2.line(marks, (80, -2), (-5, 57), 1, 3)
    probability = 0.9 * marks.astype(np.float32)
    point = OperatingPoint(0.3, least_extent_cells=0.02)
    blocks = cut_off_blocks(tile)
    np.testing.assert_array_equal(completed(probability, tile, blocks, point, SIDE), probability)
    assert measured(tile, probability).crack_class == "C"
    # A speck that is no mark leaves the edge to be marked.
    speck = np.zeros_like(probability)
    speck[100, 100] = 0.9
    edge = with_block_edges(np.zeros_like(speck), blocks, 0.3, SIDE) >= 0.3
    assert edge.any()
    assert (completed(speck, tile, blocks, point, SIDE)[edge] >= 0.3).all()
