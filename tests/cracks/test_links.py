from __future__ import annotations

import cv2
import numpy as np
import pytest

from pv_inspect.cracks.centreline import skeleton_length
from pv_inspect.cracks.features import crack_marks
from pv_inspect.cracks.links import linked

SIDE = 200


def cell(ends: tuple[tuple[int, int], tuple[int, int]], faint: float) -> tuple[np.ndarray, ...]:
    """Cell with a crack whose middle half is faint, and what a detector says about it."""
    (x0, y0), (x1, y1) = ends
    at = [(round(x0 + t * (x1 - x0)), round(y0 + t * (y1 - y0))) for t in (0, 0.25, 0.75, 1)]
    depth, said = np.zeros((2, SIDE, SIDE), np.float32)
    for k, (strength, probability) in enumerate([(0.6, 0.9), (0.6 * faint, 0.08), (0.6, 0.9)]):
        line = cv2.line(np.zeros((SIDE, SIDE), np.uint8), at[k], at[k + 1], 1, 3) > 0
        depth[line] = np.maximum(depth[line], strength)
        said[line] = np.maximum(said[line], probability if faint or k != 1 else 0)
    noise = np.random.default_rng(0).normal(0, 0.01, depth.shape)
    tile = 0.6 * (1 - cv2.GaussianBlur(depth, (0, 0), 1)) + noise
    return tile.astype(np.float32), said


def length(probability: np.ndarray) -> float:
    return sum(map(skeleton_length, crack_marks(probability, 0.3, SIDE, 0.02)))


@pytest.mark.parametrize(
    "ends", [((10, 40), (190, 160)), ((100, 5), (95, 195)), ((5, 5), (195, 195))]
)
def test_a_crack_that_is_faint_in_the_middle_is_marked_from_end_to_end(
    ends: tuple[tuple[int, int], tuple[int, int]],
) -> None:
    tile, said = cell(ends, faint=0.3)
    whole = np.hypot(*np.subtract(*ends))
    assert length(said) < 0.6 * whole
    joined = linked(said, tile, 0.3, SIDE)
    assert len(crack_marks(joined, 0.3, SIDE, 0.02)) == 1
    assert length(joined) == pytest.approx(whole, rel=0.05)
    # A link says no more than that the threshold is reached.
    assert joined[joined != said].max() == pytest.approx(0.3)


def test_two_cracks_with_a_clean_gap_stay_two() -> None:
    tile, said = cell(((10, 40), (190, 160)), faint=0.0)
    assert np.array_equal(linked(said, tile, 0.3, SIDE), said)


def test_a_line_that_the_image_does_not_show_is_no_link() -> None:
    _, said = cell(((10, 40), (190, 160)), faint=0.3)
    tile, _ = cell(((10, 40), (190, 160)), faint=0.0)
    assert np.array_equal(linked(said, tile, 0.3, SIDE), said)


def test_pieces_that_do_not_point_at_one_another_are_not_joined() -> None:
    tile, said = cell(((20, 100), (180, 100)), faint=0.3)
    turned = said.copy()
    turned[:, 100:] = 0
    turned[20:90, 150:153] = 0.9
    assert np.array_equal(linked(turned, tile, 0.3, SIDE), turned)


@pytest.mark.parametrize("value", [0.0, 0.9])
def test_maps_without_pieces_are_left_alone(value: float) -> None:
    said = np.full((SIDE, SIDE), value, np.float32)
    assert linked(said, np.full_like(said, 0.5), 0.3, SIDE) is said
